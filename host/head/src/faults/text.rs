//! The text of a fault: `KIND:KEY=VALUE,KEY=VALUE`, the numbers with units in it, and when it acts: device time, counted from
//! the first scan.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use thiserror::Error;

use super::kinds::{KINDS, Kind, Lasts};
use crate::scene_file::nearest;

/// Why a fault cannot be injected, and what to do instead.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct FaultError(pub(super) String);

fn meant(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| format!(", `{nearest}` is"))
}

// Keys of the schedule.
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
    /// When.
    pub window: Window,
    /// Its kind, with the layer it acts on.
    pub kind: &'static Kind,
    /// Of the keys of its kind, in SI units.
    pub(super) values: [f64; 2],
    pub(super) seed: u64,
    text: String,
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
            let Kind { name, example, .. } = kind;
            let (key, value) =
                part.split_once('=').map(|(key, value)| (key.trim(), value.trim())).ok_or_else(|| {
                    let form = "KEY=VALUE,KEY=VALUE";
                    FaultError(format!("`{part}` of `{name}` has no value; write {name}:{form}, such as `{example}`"))
                })?;
            let known: Vec<&str> = kind.key_names().collect();
            if !known.contains(&key) {
                let (meant, known) = (meant(nearest(key, &known)), known.join(", "));
                return Err(FaultError(format!("`{name}` has no `{key}`{meant}; it takes {known}")));
            }
            if given.iter().any(|(before, _)| *before == key) {
                let next_step = "give it once, or the whole fault twice";
                return Err(FaultError(format!("`{key}` of `{name}` is given twice; {next_step}")));
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

    fn refuse(&self, key: &str, value: &str, expected: &str) -> FaultError {
        FaultError(format!("`{key}={value}` of `{}` is out of place; give {expected}", self.kind.name))
    }

    /// The values of the keys of the kind, in the order of its table.
    fn values(&self) -> Result<[f64; 2], FaultError> {
        let mut values = [0.0; 2];
        for (value, key) in values.iter_mut().zip(self.kind.keys) {
            let Kind { name, example, .. } = self.kind;
            let missing = || FaultError(format!("`{name}` needs `{}`, such as `{example}`", key.name));
            *value = self.read(key.name, key.unit, key.default)?.ok_or_else(missing)?;
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
            let next_step = "give a smaller `for` or a larger `every`";
            return Err(FaultError(format!(
                "`{}` lasts as long as the time to its next begin, or longer; {next_step}",
                self.kind.name
            )));
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
            let meant = meant(nearest(name, &known));
            FaultError(format!("no fault is called `{name}`{meant}; `slitpose faults` lists them all"))
        })?;
        let parts = Parts::split(kind, rest)?;
        let values = parts.values()?;
        let seed = match parts.text(SEED) {
            None => 1,
            Some(text) => text.parse().map_err(|_| parts.refuse(SEED, text, "a whole number from 0"))?,
        };
        if kind.name == "swap-cells" && values[0] == values[1] {
            return Err(parts.refuse("with", &values[1].to_string(), "another cell than `cell`"));
        }
        Ok(Self { kind, values, window: parts.window()?, seed, text: text.to_owned() })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Fault {
    /// The cells and emitters that it is for.
    pub(super) fn cells(&self) -> impl Iterator<Item = usize> {
        let values = self.kind.keys.iter().zip(self.values);
        values.filter(|(key, _)| key.unit == Unit::Number).map(|(_, number)| number as usize)
    }
}

/// What kind of number a key takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The number of a cell or of an emitter, from 0.
    Number,
    /// A count, at least 1.
    Count,
    /// A probability, above 0 and at most 1.
    Rate,
    /// A ratio, 0 to 10.
    Ratio,
    /// A duration, at least 0.
    Time,
    /// A difference of times, of either sign.
    TimeStep,
    /// Parts per million, of either sign.
    Ppm,
    /// A current, at least 0.
    Current,
    /// A length, of either sign.
    Length,
    /// A difference of temperatures, of either sign.
    Kelvin,
}

/// Longest time that the text of a fault may give: a day.
const MAX_S: f64 = 86_400.0;

/// Endings of a text with the factor to SI, the longest first.
type Endings = &'static [(&'static str, f64)];

const PLAIN: Endings = &[("", 1.0)];
const TIMES: Endings = &[("min", 60.0), ("ms", 1e-3), ("us", 1e-6), ("s", 1.0)];
const CURRENTS: Endings = &[("nA", 1e-9), ("uA", 1e-6), ("mA", 1e-3)];
const LENGTHS: Endings = &[("nm", 1e-9), ("um", 1e-6), ("mm", 1e-3)];

impl Unit {
    /// Endings, the least and the greatest value, and what such a value looks like.
    fn entry(self) -> (Endings, RangeInclusive<f64>, &'static str) {
        match self {
            Self::Number => (PLAIN, 0.0..=255.0, "a number from 0, such as 2"),
            Self::Count => (PLAIN, 1.0..=1e6, "a whole number from 1, such as 8"),
            Self::Rate => (PLAIN, f64::MIN_POSITIVE..=1.0, "a probability above 0 and up to 1, such as 1e-5"),
            Self::Ratio => (PLAIN, 0.0..=10.0, "a ratio from 0 to 10, such as 0.5"),
            Self::Time => (TIMES, 0.0..=MAX_S, "a time from 0 to 1440min, such as 0.5s, 20ms or 250us"),
            Self::TimeStep => (TIMES, -MAX_S..=MAX_S, "a time of either sign, such as 10ms or -2s"),
            Self::Ppm => (&[("ppm", 1.0)], -1e5..=1e5, "parts per million up to 1e5, such as 50ppm"),
            Self::Current => (CURRENTS, 0.0..=1e-3, "a current up to 1mA, such as 200nA or 1.5uA"),
            Self::Length => (LENGTHS, -0.1..=0.1, "a length up to 100mm, such as 50um or -0.1mm"),
            Self::Kelvin => (&[("K", 1.0)], -200.0..=200.0, "a difference up to 200K, such as 20K"),
        }
    }

    /// What such a value looks like, for messages.
    pub fn example(self) -> &'static str {
        self.entry().2
    }

    /// The value of `text` in SI units; `None` if it is none, or out of range.
    pub fn parse(self, text: &str) -> Option<f64> {
        let (endings, range, _) = self.entry();
        let (number, factor) =
            endings.iter().find_map(|&(ending, factor)| Some((text.strip_suffix(ending)?, factor)))?;
        // Neither `inf` nor `nan` begins or ends with a digit.
        let is_plain = number.ends_with(|last: char| last.is_ascii_digit() || last == '.');
        let value = number.parse::<f64>().ok().filter(|_| is_plain)? * factor;
        let is_whole = !matches!(self, Self::Number | Self::Count) || value.fract() == 0.0;
        (is_whole && range.contains(&value)).then_some(value)
    }
}

/// The spans in which a fault acts, seconds of device time since the first scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Begin of the first span.
    pub from_s: f64,
    /// Duration of a span; infinite: to the end, or to the next span.
    pub for_s: f64,
    /// Time from the begin of a span to that of the next; `None`: there is one span.
    pub every_s: Option<f64>,
}

/// Rounding of times does not move a begin or an end: less than a tick of any board.
const ROUNDING_S: f64 = 1e-9;

impl Window {
    /// How many spans have begun by `time_s`.
    pub fn begun(&self, time_s: f64) -> u64 {
        let since_s = time_s - self.from_s + ROUNDING_S;
        match self.every_s {
            _ if since_s < 0.0 => 0,
            Some(every_s) => 1 + (since_s / every_s) as u64,
            None => 1,
        }
    }

    /// Time since the span under way began; `None` outside of all spans.
    pub fn since_s(&self, time_s: f64) -> Option<f64> {
        let begun = self.begun(time_s).checked_sub(1)?;
        let since_s = (time_s - self.from_s - begun as f64 * self.every_s.unwrap_or(0.0)).max(0.0);
        (since_s + ROUNDING_S < self.for_s).then_some(since_s)
    }

    /// Whether `time_s` lies in a span.
    pub fn is_open(&self, time_s: f64) -> bool {
        self.since_s(time_s).is_some()
    }
}

/// Device time since the first scan, from the ticks of scans. It goes on where a board restarts its counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultClock {
    /// Tick of zero, and the latest tick; `None` before the first scan.
    ticks: Option<(u64, u64)>,
    /// Ticks before the board last began anew.
    earlier_ticks: u64,
}

impl FaultClock {
    /// The device time of a scan that began at `tick`, seconds.
    pub fn take(&mut self, tick: u64, tick_hz: u32) -> f64 {
        let (first, last) = self.ticks.unwrap_or((tick, tick));
        let first = if tick < last {
            self.earlier_ticks += last - first;
            tick
        } else {
            first
        };
        self.ticks = Some((first, tick));
        (self.earlier_ticks + (tick - first)) as f64 / f64::from(tick_hz)
    }

    /// The device time at `tick`, at least that of the latest scan; `None` before the first scan.
    pub fn at(&self, tick: u64, tick_hz: u32) -> Option<f64> {
        let (first, last) = self.ticks?;
        Some((self.earlier_ticks + (tick.max(last) - first)) as f64 / f64::from(tick_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        text.parse::<Fault>().expect_err(text).to_string()
    }

    #[test]
    fn each_kind_has_a_name_of_its_own_and_an_example_that_is_one() {
        for kind in KINDS.iter() {
            let fault: Fault = kind.example.parse().unwrap_or_else(|error| panic!("{}: {error}", kind.example));
            assert_eq!((fault.kind.name, fault.to_string().as_str()), (kind.name, kind.example));
            assert_eq!(KINDS.iter().filter(|other| other.name == kind.name).count(), 1, "{}", kind.name);
            assert!([0, 3].contains(&kind.exit), "{}", kind.name);
        }
    }

    #[test]
    fn defaults_are_those_of_the_table() {
        let fault: Fault = "flip".parse().unwrap();
        assert_eq!(fault.values[0], 1e-5);
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

    #[test]
    fn quantities_are_read_with_their_units_and_refused_without() {
        for (unit, text, value) in [
            (Unit::Time, "500ms", 0.5),
            (Unit::Time, "0.5s", 0.5),
            (Unit::Time, "2min", 120.0),
            (Unit::Time, "250us", 250e-6),
            (Unit::TimeStep, "-10ms", -0.01),
            (Unit::Rate, "1e-5", 1e-5),
            (Unit::Ppm, "-50ppm", -50.0),
            (Unit::Current, "200nA", 200e-9),
            (Unit::Length, "-0.1mm", -1e-4),
            (Unit::Kelvin, "20K", 20.0),
            (Unit::Number, "0", 0.0),
        ] {
            let parsed = unit.parse(text).unwrap_or_else(|| panic!("{text} is refused"));
            assert!((parsed - value).abs() <= 1e-12 * value.abs(), "{text}: {parsed}");
            // The example of each unit is one.
            let example = unit.example().split("such as ").nth(1).and_then(|some| some.split([',', ' ']).next());
            assert!(example.is_some_and(|example| unit.parse(example).is_some()), "{unit:?}");
        }
        for (unit, text) in [
            (Unit::Time, "500"),
            (Unit::Time, "-1s"),
            (Unit::Time, "infs"),
            (Unit::Time, "s"),
            (Unit::Rate, "0"),
            (Unit::Rate, "1.5"),
            (Unit::Rate, "nan"),
            (Unit::Number, "1.5"),
            (Unit::Number, "-1"),
            (Unit::Count, "0"),
            (Unit::Current, "2A"),
            (Unit::Length, "1e300mm"),
        ] {
            assert_eq!(unit.parse(text), None, "{text} as {unit:?}");
        }
    }

    #[test]
    fn spans_repeat_and_end() {
        let once = Window { from_s: 1.0, for_s: 0.5, every_s: None };
        assert_eq!([0.0, 0.999, 1.0, 1.4, 1.5, 9.0].map(|t| once.is_open(t)), [false, false, true, true, false, false]);
        let often = Window { from_s: 1.0, for_s: 0.1, every_s: Some(0.3) };
        let opened: Vec<u32> = (0..20).filter(|tenth| often.is_open(f64::from(*tenth) / 10.0)).collect();
        assert_eq!(opened, [10, 13, 16, 19]);
        assert_eq!([0.0, 1.0, 1.29, 1.3, 2.2].map(|t| often.begun(t)), [0, 1, 1, 2, 5]);
        assert!(Window { for_s: f64::INFINITY, ..once }.is_open(1e9));
    }

    #[test]
    fn the_clock_goes_on_where_ticks_begin_anew() {
        let mut clock = FaultClock::default();
        assert_eq!(clock.at(1000, 100), None);
        let times = [1000, 1100, 1250, 40, 90].map(|tick| clock.take(tick, 100));
        assert_eq!(times, [0.0, 1.0, 2.5, 2.5, 3.0]);
        assert_eq!([140, 3].map(|tick| clock.at(tick, 100)), [Some(3.5), Some(3.0)]);
    }
}
