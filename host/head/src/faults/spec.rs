//! The text of a fault: `KIND:KEY=VALUE,KEY=VALUE`.

use std::fmt;
use std::str::FromStr;

use super::error::FaultError;
use super::kinds::{KINDS, Kind, Lasts};
use super::quantity::Unit;
use super::schedule::Window;
use crate::scene_file::nearest;

/// Keys of the schedule.
const FROM: &str = "from";
const FOR: &str = "for";
const EVERY: &str = "every";
const SEED: &str = "seed";

/// A fault: what happens, and when.
///
/// ```
/// use slitpose_head::faults::Fault;
///
/// let fault: Fault = "occlude:cell=2,from=1s,for=500ms".parse()?;
/// assert!(fault.window.is_open(1.2) && !fault.window.is_open(1.6));
/// let error = "oclude:cell=2".parse::<Fault>().unwrap_err();
/// assert!(error.to_string().contains("`occlude` is"));
/// # Ok::<(), slitpose_head::faults::FaultError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What happens.
    pub(super) effect: Effect,
    /// When.
    pub window: Window,
    /// Its kind, with the layer it acts on.
    pub kind: &'static Kind,
    /// Seed of its random numbers.
    pub(super) seed: u64,
    text: String,
}

/// What happens while a fault acts, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Effect {
    /// Each bit is inverted with this probability.
    Flip { rate: f64 },
    /// Each packet is lost with this probability.
    Drop { rate: f64 },
    /// Each packet is delivered twice with this probability.
    Duplicate { rate: f64 },
    /// Each packet is delivered behind the next with this probability.
    Reorder { rate: f64 },
    /// Each packet loses its end with this probability.
    Truncate { rate: f64 },
    /// From each packet on, so many bytes are noise with this probability.
    Burst { rate: f64, bytes: usize },
    /// Bytes are held back.
    Stall,
    /// The link breaks.
    HangUp,
    /// The board's clock gains.
    Drift { ppm: f64 },
    /// The board's clock is set.
    Step { by_s: f64 },
    /// The light of a cell is this share of what it was.
    Dim { cell: usize, to: f64 },
    /// A converter is at the end of its range.
    Saturate { cell: usize },
    /// Light on electrode 1 while the cell is lit.
    Glint { cell: usize, current_a: f64 },
    /// Light on both electrodes in all slots.
    Stray { cell: usize, current_a: f64 },
    /// Noise on each word.
    Noisy { cell: usize, rms_a: f64 },
    /// Words stay as they are.
    Stuck { cell: usize },
    /// Electrodes are exchanged.
    SwapElectrodes { cell: usize },
    /// Cells are exchanged.
    SwapCells { cell: usize, with: usize },
    /// An emitter is dark.
    Dead { emitter: usize },
    /// A slit is elsewhere along its detector's x.
    Move { cell: usize, by_m: f64 },
    /// Head and board are warmer by this much, from this time after the begin on.
    Warm { by_k: f64, over_s: f64 },
    /// So many scans are overwritten.
    Overrun { scans: u64 },
    /// The board starts again and needs this long for it.
    Reset { boot_s: f64 },
    /// The board loses its supply.
    Restart,
    /// The board collects its scans less often.
    Slow { poll_s: f64 },
    /// The converters fail.
    Stop,
}

/// The parts of a text, by key.
struct Parts<'t> {
    kind: &'static Kind,
    given: Vec<(&'t str, &'t str)>,
}

impl<'t> Parts<'t> {
    fn split(kind: &'static Kind, text: &'t str) -> Result<Self, FaultError> {
        let mut given: Vec<(&str, &str)> = Vec::new();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let (key, value) = part
                .split_once('=')
                .map(|(key, value)| (key.trim(), value.trim()))
                .ok_or_else(|| FaultError::NoValue { kind: kind.name, part: part.to_owned(), example: kind.example })?;
            let known: Vec<&str> = kind.key_names().collect();
            if !known.contains(&key) {
                let nearest = nearest(key, &known);
                let (key, known) = (key.to_owned(), known.join(", "));
                return Err(FaultError::UnknownKey { kind: kind.name, key, nearest, known });
            }
            if given.iter().any(|(before, _)| *before == key) {
                return Err(FaultError::Twice { kind: kind.name, key: key.to_owned() });
            }
            given.push((key, value));
        }
        Ok(Self { kind, given })
    }

    fn text(&self, key: &str) -> Option<&'t str> {
        self.given.iter().find_map(|(name, value)| (*name == key).then_some(*value))
    }

    fn read(&self, key: &'static str, unit: Unit, default: Option<&str>) -> Result<Option<f64>, FaultError> {
        let Some(text) = self.text(key).or(default) else { return Ok(None) };
        unit.parse(text).map(Some).ok_or_else(|| self.refuse(key, text, unit.example()))
    }

    fn refuse(&self, key: &'static str, value: &str, expected: &'static str) -> FaultError {
        FaultError::Value { kind: self.kind.name, key, value: value.to_owned(), expected }
    }

    /// The values of the keys of the kind, in the order of its table.
    fn values(&self) -> Result<[f64; 2], FaultError> {
        let mut values = [0.0; 2];
        for (value, key) in values.iter_mut().zip(self.kind.keys) {
            let missing = FaultError::Missing { kind: self.kind.name, key: key.name, example: self.kind.example };
            *value = self.read(key.name, key.unit, key.default)?.ok_or(missing)?;
        }
        Ok(values)
    }

    fn window(&self) -> Result<Window, FaultError> {
        let lasts = match self.kind.lasts {
            Lasts::Instant | Lasts::ToTheEnd => None,
            Lasts::For(text) => Some(text),
        };
        let from_s = self.read(FROM, Unit::Time, Some("0s"))?.unwrap_or(0.0);
        let for_s = self.read(FOR, Unit::Time, lasts)?.unwrap_or(f64::INFINITY);
        let every_s = self.read(EVERY, Unit::Time, None)?;
        if every_s == Some(0.0) {
            return Err(self.refuse(EVERY, self.text(EVERY).unwrap_or_default(), "more than nothing, such as 1s"));
        }
        if every_s.is_some_and(|every_s| for_s.is_finite() && for_s >= every_s) {
            return Err(FaultError::Overlap { kind: self.kind.name });
        }
        Ok(Window { from_s, for_s, every_s })
    }
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, rest) = text.split_once(':').unwrap_or((text, ""));
        let kind = Kind::named(name.trim()).ok_or_else(|| {
            let known = KINDS.map(|kind| kind.name);
            FaultError::UnknownKind { name: name.to_owned(), nearest: nearest(name, &known) }
        })?;
        let parts = Parts::split(kind, rest)?;
        let [first, second] = parts.values()?;
        let seed = match parts.text(SEED) {
            None => 1,
            Some(text) => text.parse().map_err(|_| parts.refuse(SEED, text, "a whole number from 0"))?,
        };
        let cell = first as usize;
        let effect = match kind.name {
            "flip" => Effect::Flip { rate: first },
            "drop" => Effect::Drop { rate: first },
            "duplicate" => Effect::Duplicate { rate: first },
            "reorder" => Effect::Reorder { rate: first },
            "truncate" => Effect::Truncate { rate: first },
            "burst" => Effect::Burst { rate: first, bytes: second as usize },
            "stall" => Effect::Stall,
            "hangup" => Effect::HangUp,
            "drift" => Effect::Drift { ppm: first },
            "step" => Effect::Step { by_s: first },
            "occlude" => Effect::Dim { cell, to: 0.0 },
            "dim" => Effect::Dim { cell, to: second },
            "saturate" => Effect::Saturate { cell },
            "glint" => Effect::Glint { cell, current_a: second },
            "stray" => Effect::Stray { cell, current_a: second },
            "noisy" => Effect::Noisy { cell, rms_a: second },
            "stuck" => Effect::Stuck { cell },
            "swap-electrodes" => Effect::SwapElectrodes { cell },
            "swap-cells" => Effect::SwapCells { cell, with: second as usize },
            "dead" => Effect::Dead { emitter: cell },
            "move" => Effect::Move { cell, by_m: second },
            "warm" => Effect::Warm { by_k: first, over_s: second },
            "overrun" => Effect::Overrun { scans: first as u64 },
            "reset" => Effect::Reset { boot_s: first },
            "restart" => Effect::Restart,
            "slow" => Effect::Slow { poll_s: first },
            _ => Effect::Stop,
        };
        if let Effect::SwapCells { cell, with } = effect
            && cell == with
        {
            return Err(parts.refuse("with", &with.to_string(), "another cell than `cell`"));
        }
        Ok(Self { effect, window: parts.window()?, kind, seed, text: text.to_owned() })
    }
}

/// As it was given.
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Effect {
    /// The cells that it is for.
    pub(super) fn cells(&self) -> impl Iterator<Item = usize> {
        let cells = match *self {
            Self::Dim { cell, .. }
            | Self::Saturate { cell }
            | Self::Glint { cell, .. }
            | Self::Stray { cell, .. }
            | Self::Noisy { cell, .. }
            | Self::Stuck { cell }
            | Self::SwapElectrodes { cell }
            | Self::Move { cell, .. }
            | Self::Dead { emitter: cell } => [Some(cell), None],
            Self::SwapCells { cell, with } => [Some(cell), Some(with)],
            _ => [None, None],
        };
        cells.into_iter().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        text.parse::<Fault>().expect_err(text).to_string()
    }

    #[test]
    fn each_kind_has_an_effect_of_its_own_and_an_example_that_is_one() {
        let mut effects = Vec::new();
        for kind in &KINDS {
            let fault: Fault = kind.example.parse().unwrap_or_else(|error| panic!("{}: {error}", kind.example));
            assert_eq!((fault.kind.name, fault.to_string().as_str()), (kind.name, kind.example));
            assert_eq!(matches!(fault.effect, Effect::Stop), kind.name == "stop");
            assert!(!effects.contains(&fault.effect), "{}", kind.name);
            effects.push(fault.effect);
            assert!([0, 3].contains(&kind.exit), "{}", kind.name);
        }
    }

    #[test]
    fn defaults_are_those_of_the_table() {
        let fault: Fault = "flip".parse().unwrap();
        assert_eq!(fault.effect, Effect::Flip { rate: 1e-5 });
        assert_eq!(fault.window, Window { from_s: 0.0, for_s: f64::INFINITY, every_s: None });
        let fault: Fault = "stall:every=1s,seed=7".parse().unwrap();
        assert_eq!(fault.window, Window { from_s: 0.0, for_s: 0.2, every_s: Some(1.0) });
        assert_eq!(fault.seed, 7);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place_and_the_next_step() {
        for (text, parts) in [
            ("", &["called ``", "`slitpose faults`"][..]),
            ("oclude:cell=2", &["`oclude`", "`occlude` is"]),
            ("xyzzy", &["`xyzzy`; `slitpose faults`"]),
            ("occlude", &["needs `cell`", "occlude:cell=2"]),
            ("occlude:2", &["`2` of `occlude`", "KEY=VALUE"]),
            ("occlude:cel=2", &["no `cel`", "`cell` is", "from, for, every, seed"]),
            ("occlude:cell=two", &["`cell=two` of `occlude`", "a number from 0"]),
            ("occlude:cell=2,from=1", &["`from=1`", "0.5s"]),
            ("flip:rate=2", &["`rate=2` of `flip`", "a probability"]),
            ("flip:seed=-1", &["`seed=-1`"]),
            ("hangup:every=0s", &["`every=0s`"]),
            ("hangup:every=100ms", &["smaller `for`"]),
            ("step:for=1s", &["no `for`"]),
            ("drop:rate=0.1,rate=0.2", &["`rate` of `drop` is given twice"]),
            ("swap-cells:cell=1,with=1", &["`with=1`"]),
        ] {
            let error = error(text);
            assert!(parts.iter().all(|part| error.contains(part)), "{text}: {error}");
        }
    }
}
