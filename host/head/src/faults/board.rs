//! Faults of a board: what its processor and its converters do wrong, and when.

use super::Faults;
use super::kinds::Layer;
use super::spec::{Effect, Fault};

/// The faults of one simulated board.
#[derive(Clone, Debug)]
pub struct BoardFaults {
    /// With the number of spans that have been acted on.
    faults: Vec<(Fault, u64)>,
}

/// What befalls a board now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// So many scans are overwritten.
    Overrun(u64),
    /// The watchdog resets the board, which then needs this long to start, seconds.
    Reset(f64),
    /// The board is without supply for this long, seconds.
    Restart(f64),
    /// The converters fail.
    Stop,
}

impl BoardFaults {
    /// Those of `faults` that act in a board; `None` if none does.
    pub fn of(faults: &Faults) -> Option<Self> {
        let faults: Vec<_> = faults.of(Layer::Board).into_iter().map(|(fault, _)| (fault, 0)).collect();
        (!faults.is_empty()).then_some(Self { faults })
    }

    /// What begins by `time_s`, once for each begin.
    pub fn begin(&mut self, time_s: f64) -> Option<Trouble> {
        self.faults.iter_mut().find_map(|(fault, acted)| {
            let begun = fault.window.begun(time_s);
            if begun <= *acted {
                return None;
            }
            *acted = begun;
            match fault.effect {
                Effect::Overrun { scans } => Some(Trouble::Overrun(scans)),
                Effect::Reset { boot_s } => Some(Trouble::Reset(boot_s)),
                Effect::Restart => Some(Trouble::Restart(fault.window.for_s)),
                Effect::Stop => Some(Trouble::Stop),
                _ => None,
            }
        })
    }

    /// The time between two looks of a board at its scans, while it is slow, seconds.
    pub fn poll_s(&self, time_s: f64) -> Option<f64> {
        self.faults.iter().find_map(|(fault, _)| match fault.effect {
            Effect::Slow { poll_s } if fault.window.is_open(time_s) => Some(poll_s),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_begin_makes_trouble_once() {
        let texts = ["overrun:scans=3,from=1s,every=1s", "restart:from=2s", "slow:poll=5ms,for=500ms"];
        let faults = Faults::new(texts.iter().map(|text| text.parse().unwrap()).collect(), 6).unwrap();
        let mut board = BoardFaults::of(&faults).unwrap();
        let times = [0.0, 0.9, 1.0, 1.5, 2.0, 2.0, 2.0, 3.1];
        let troubles = times.map(|time_s| board.begin(time_s));
        let overrun = Some(Trouble::Overrun(3));
        assert_eq!(troubles, [None, None, overrun, None, overrun, Some(Trouble::Restart(0.3)), None, overrun]);
        assert_eq!([0.0, 0.4, 0.5].map(|time_s| board.poll_s(time_s)), [Some(0.005), Some(0.005), None]);
    }
}
