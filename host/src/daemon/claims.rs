//! Which reader follows which board. Two streams of boards with one number could not be told apart.

use std::sync::{Arc, Mutex};

use super::error::BoardError;
use crate::link::DeviceId;
use slitpose_head::threads::lock;

/// The boards followed now.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims(Arc<Mutex<Vec<(DeviceId, String)>>>);

impl Claims {
    /// Claims a board for the reader of `name`.
    ///
    /// # Errors
    /// If another reader has claimed it.
    pub(super) fn claim(&self, device: DeviceId, name: &str) -> Result<(), BoardError> {
        let mut claims = lock(&self.0);
        match claims.iter().find(|(claimed, owner)| *claimed == device && owner != name) {
            Some((_, owner)) => Err(BoardError::Twice { device, name: name.to_owned(), other: owner.clone() }),
            None => {
                claims.push((device, name.to_owned()));
                Ok(())
            }
        }
    }

    /// Releases the claims of `name`.
    pub(super) fn release(&self, name: &str) {
        lock(&self.0).retain(|(_, owner)| owner != name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_claimed_by_one_reader_until_it_is_released() {
        let claims = Claims::default();
        let [one, other] = [DeviceId(*b"one board   "), DeviceId(*b"another one ")];
        claims.claim(one, "A").unwrap();
        claims.claim(one, "A").unwrap();
        claims.claim(other, "B").unwrap();
        let twice = claims.claim(one, "B").unwrap_err().to_string();
        assert!(twice.contains("B and A") && twice.contains(&one.to_string()), "{twice}");
        claims.release("A");
        claims.claim(one, "B").unwrap();
        assert!(claims.claim(other, "A").is_err());
    }
}
