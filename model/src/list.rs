//! Lists of up to `N` items: in place on the board, which has no heap; on the heap with the feature `batch`, because
//! a compiled scene of 120 kB would otherwise be moved over the stacks of a host's threads.

#[cfg(not(feature = "batch"))]
pub(crate) type List<T, const N: usize> = heapless::Vec<T, N>;
#[cfg(feature = "batch")]
pub(crate) use heaped::List;

#[cfg(feature = "batch")]
mod heaped {
    extern crate alloc;

    use core::ops::{Deref, DerefMut};

    /// What of [`heapless::Vec`] a plan uses.
    #[derive(Clone, Debug)]
    pub(crate) struct List<T, const N: usize>(alloc::vec::Vec<T>);

    impl<T, const N: usize> List<T, N> {
        pub(crate) const fn new() -> Self {
            Self(alloc::vec::Vec::new())
        }

        /// # Errors
        /// The item, if there is no place for it.
        pub(crate) fn push(&mut self, item: T) -> Result<(), T> {
            if self.len() == N {
                return Err(item);
            }
            self.0.push(item);
            Ok(())
        }

        pub(crate) fn clear(&mut self) {
            self.0.clear();
        }
    }

    impl<T, const N: usize> Deref for List<T, N> {
        type Target = [T];

        #[inline(always)]
        fn deref(&self) -> &[T] {
            &self.0
        }
    }

    impl<T, const N: usize> DerefMut for List<T, N> {
        #[inline(always)]
        fn deref_mut(&mut self) -> &mut [T] {
            &mut self.0
        }
    }
}
