//! The table of faults: what each does, what its text may say, and what a user sees of it.

use std::sync::LazyLock;

use super::text::Unit;

/// Where a fault acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// On the bytes between the board and the decoder.
    Wire,
    /// On the words that the board's converters deliver.
    Words,
    /// On the light that falls on the detectors.
    Light,
    /// In the board.
    Board,
}

impl Layer {
    /// The heading above its faults.
    pub fn title(self) -> &'static str {
        match self {
            Self::Wire => "on the wire, between the board and the decoder",
            Self::Words => "in the head, seen in the words of the converters",
            Self::Light => "in the head, seen in the light",
            Self::Board => "in the board",
        }
    }
}

/// A key of a fault besides those of its schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Its name.
    pub name: &'static str,
    /// What it takes.
    pub unit: Unit,
    /// Its value if it is not given; `None`: it must be.
    pub default: Option<&'static str>,
}

/// How long a fault lasts unless `for` says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasts {
    /// An instant; it takes no `for`.
    Instant,
    /// To the end.
    ToTheEnd,
    /// This long.
    For(&'static str),
}

/// One kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// Its name.
    pub name: &'static str,
    /// Where it acts.
    pub layer: Layer,
    /// Its keys.
    pub keys: &'static [Key],
    /// How long it lasts.
    pub lasts: Lasts,
    /// What it does, in a phrase.
    pub what: &'static str,
    /// What the user sees of it: status of poses, health, event.
    pub sees: &'static str,
    /// The exit code of a run that it befell, if nothing else did.
    pub exit: u8,
    /// A fault of this kind.
    pub example: &'static str,
}

/// The kinds as a table of text, one a row.
const TABLE: &str = include_str!("kinds.txt");

/// All kinds, by layer.
pub static KINDS: LazyLock<[Kind; 27]> = LazyLock::new(|| {
    let mut rows = TABLE.lines().filter(|row| !row.starts_with('#')).map(Kind::of_row);
    std::array::from_fn(|_| rows.next().flatten().expect("a row of kinds.txt"))
});

impl Kind {
    /// The kind of a row of [`TABLE`].
    fn of_row(row: &'static str) -> Option<Self> {
        let columns: Vec<&str> = row.split('|').map(str::trim).collect();
        let [name, layer, keys, lasts, exit, example, what, sees] = columns[..] else { return None };
        let layer = match layer {
            "wire" => Layer::Wire,
            "words" => Layer::Words,
            "light" => Layer::Light,
            _ => Layer::Board,
        };
        let lasts = match lasts {
            "instant" => Lasts::Instant,
            "on" => Lasts::ToTheEnd,
            time => Lasts::For(time),
        };
        let key = |text: &'static str| {
            let (name, value) = text.split_once(':')?;
            let (unit, default) = value.split_once('=').map_or((value, None), |(unit, value)| (unit, Some(value)));
            Some(Key { name, unit: Unit::named(unit)?, default })
        };
        let keys = keys.split_whitespace().map(key).collect::<Option<Vec<Key>>>()?.leak();
        Some(Self { name, layer, keys, lasts, what, sees, exit: exit.parse().ok()?, example })
    }

    /// The kind with this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name)
    }

    /// Its keys, those of the schedule included.
    pub fn key_names(&self) -> impl Iterator<Item = &'static str> {
        let schedule: &[_] = match self.lasts {
            Lasts::Instant => &["from", "every", "seed"],
            Lasts::ToTheEnd | Lasts::For(_) => &["from", "for", "every", "seed"],
        };
        self.keys.iter().map(|key| key.name).chain(schedule.iter().copied())
    }

    /// Why it cannot be injected into a recording; `None` if it can.
    pub fn not_in_recordings(&self) -> Option<&'static str> {
        match (self.layer, self.name) {
            (Layer::Light, _) => {
                Some("recorded words do not say how the light was mixed; use `run --device sim` or `simulate`")
            }
            (Layer::Board, _) => Some("its board has run already; use `run --device sim`"),
            (Layer::Wire, "hangup") => Some("nobody can open the link to its board again; use `run --device sim`"),
            (Layer::Wire | Layer::Words, _) => None,
        }
    }

    /// Why it cannot be injected into a board that `simulate` records; `None` if it can.
    pub fn not_in_simulate(&self) -> Option<&'static str> {
        matches!(self.name, "hangup" | "reset" | "restart" | "stop").then_some(
            "`simulate` starts its board once; use `run --device sim --speed max --patience 5s --record FILE`",
        )
    }
}
