//! Faults that are injected on purpose: on the wire, in the head, in the board.
//!
//! A [`Fault`] is read from a text such as `occlude:cell=2,from=1s,for=500ms`: a kind of the table [`KINDS`], what it
//! does, and when. Its time is device time since the first scan; its random numbers come from its seed. So the same
//! faults on the same data give the same bytes.
//!
//! | stage | faults | acts |
//! |---|---|---|
//! | [`LightFaults`] | a part that fails, moves or warms | in the simulated board, on light |
//! | [`WordFaults`] | a cell that measures something else | in the simulated board on its scans, or on recorded ones |
//! | [`BoardFaults`] | overruns, restarts, a slow processor | in the simulated board |
//! | [`Injector`] | bytes that are damaged, lost, late | between the board and the decoder |
//!
//! The injector announces each fault by an event of the board when it begins, in the stream itself: captures, tables and
//! pages have it. True poses of simulated boards pass untouched. No text of a fault changes what comes before its begin.

mod board;
mod injector;
mod kinds;
mod text;

pub(crate) use board::WordScale;
pub use board::{BoardFaults, EMITTER_PER_K, LightFaults, Trouble, WordFaults};
pub use injector::{ANNOUNCED, Injector, Link};
pub use kinds::{KINDS, Key, Kind, Lasts, Layer};
pub use text::{Fault, FaultClock, FaultError, Unit, Window};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::scene_file::fnv1a_64;

/// All faults of one board, in the order in which they were given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults(Vec<Fault>);

impl Faults {
    /// These faults, for a head with so many cells.
    pub fn new(faults: Vec<Fault>, cells: usize) -> Result<Self, FaultError> {
        for fault in &faults {
            if let Some(cell) = fault.cells().find(|&cell| cell >= cells) {
                let last = cells.saturating_sub(1);
                return Err(FaultError(format!(
                    "`{fault}` is for cell {cell}, and the head has the cells 0 to {last}"
                )));
            }
        }
        Ok(Self(faults))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &Fault> {
        self.0.iter()
    }

    /// Those of `layer`, each with its random numbers.
    fn of(&self, layer: Layer) -> Vec<(Fault, ChaCha8Rng)> {
        let of_layer = self.0.iter().enumerate().filter(|(_, fault)| fault.kind.layer == layer);
        of_layer.map(|(place, fault)| (fault.clone(), random(fault, place))).collect()
    }

    /// Checks that each can be injected into a recording.
    pub fn check_recording(faults: &[Fault]) -> Result<(), FaultError> {
        check(faults, "a recording", Kind::not_in_recordings)
    }

    /// Checks that each can be injected into a board that `simulate` records.
    pub fn check_simulate(faults: &[Fault]) -> Result<(), FaultError> {
        check(faults, "the board of `simulate`", Kind::not_in_simulate)
    }
}

fn check(
    faults: &[Fault],
    place: &'static str,
    refused: impl Fn(&Kind) -> Option<&'static str>,
) -> Result<(), FaultError> {
    faults.iter().try_for_each(|fault| match refused(fault.kind) {
        Some(reason) => Err(FaultError(format!("`{fault}` cannot be injected into {place}: {reason}"))),
        None => Ok(()),
    })
}

/// The random numbers of the fault at `place` of a list: two of the same text differ.
fn random(fault: &Fault, place: usize) -> ChaCha8Rng {
    let kind = fnv1a_64(fault.kind.name.as_bytes());
    ChaCha8Rng::seed_from_u64(fault.seed ^ kind.rotate_left(place as u32))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(texts: &[&str]) -> Vec<Fault> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    #[test]
    fn cells_that_the_head_lacks_are_refused() {
        for text in ["occlude:cell=6", "swap-cells:cell=0,with=6", "dead:emitter=6", "move:cell=6"] {
            let error = Faults::new(faults(&[text]), 6).unwrap_err().to_string();
            assert!(error.contains(text) && error.contains("0 to 5"), "{error}");
            assert!(Faults::new(faults(&[text]), 7).is_ok(), "{text}");
        }
    }

    #[test]
    fn what_cannot_happen_to_a_recording_is_known() {
        let refused: Vec<&str> =
            KINDS.iter().filter(|kind| kind.not_in_recordings().is_some()).map(|k| k.name).collect();
        let expected = ["hangup", "dead", "move", "warm", "overrun", "reset", "restart", "slow", "stop"];
        assert_eq!(refused, expected);
    }
}
