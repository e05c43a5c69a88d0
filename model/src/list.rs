//! Lists of up to `N` items: in place on the board, which has no heap. With the feature `lanes` they are on the heap and
//! copies share them: a compiled scene of 120 kB would otherwise be moved over the stacks of a host's threads, and copied
//! with each tracker.

#[cfg(not(feature = "lanes"))]
pub type List<T, const N: usize> = heapless::Vec<T, N>;
#[cfg(feature = "lanes")]
pub use shared::List;

#[cfg(feature = "lanes")]
mod shared {
    extern crate alloc;

    use alloc::sync::Arc;
    use alloc::vec::Vec;
    use core::ops::{Deref, DerefMut};

    /// What of [`heapless::Vec`] a plan uses. A list that is changed is copied first if it is shared.
    #[derive(Clone, Debug)]
    pub struct List<T, const N: usize>(Arc<Vec<T>>);

    impl<T: Clone, const N: usize> List<T, N> {
        pub fn new() -> Self {
            Self(Arc::default())
        }

        /// # Errors
        /// The item, if there is no place for it.
        pub fn push(&mut self, item: T) -> Result<(), T> {
            if self.len() == N {
                return Err(item);
            }
            Arc::make_mut(&mut self.0).push(item);
            Ok(())
        }

        pub fn clear(&mut self) {
            *self = Self::new();
        }
    }

    impl<T, const N: usize> Deref for List<T, N> {
        type Target = [T];

        #[inline(always)]
        fn deref(&self) -> &[T] {
            &self.0
        }
    }

    impl<T: Clone, const N: usize> DerefMut for List<T, N> {
        fn deref_mut(&mut self) -> &mut [T] {
            let items: &mut Vec<T> = Arc::make_mut(&mut self.0);
            items
        }
    }
}
