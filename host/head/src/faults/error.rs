//! Why a fault cannot be injected.

use thiserror::Error;

/// Why a fault cannot be injected.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FaultError {
    /// No fault has this name.
    #[error("no fault is called `{name}`{}; `slitpose faults` lists them all", meant(*nearest))]
    UnknownKind {
        /// The name given.
        name: String,
        /// A name that it may be meant for.
        nearest: Option<&'static str>,
    },
    /// A part that is not KEY=VALUE.
    #[error("`{part}` of `{kind}` has no value; write {kind}:KEY=VALUE,KEY=VALUE, such as `{example}`")]
    NoValue {
        /// The fault.
        kind: &'static str,
        /// The part.
        part: String,
        /// A fault of this kind.
        example: &'static str,
    },
    /// A key that the fault does not have.
    #[error("`{kind}` has no `{key}`{}; it takes {known}", meant(*nearest))]
    UnknownKey {
        /// The fault.
        kind: &'static str,
        /// The key given.
        key: String,
        /// A key that it may be meant for.
        nearest: Option<&'static str>,
        /// Its keys.
        known: String,
    },
    /// A key that is given twice.
    #[error("`{key}` of `{kind}` is given twice; give it once, or the whole fault twice")]
    Twice {
        /// The fault.
        kind: &'static str,
        /// The key.
        key: String,
    },
    /// A key without which the fault says nothing.
    #[error("`{kind}` needs `{key}`, such as `{example}`")]
    Missing {
        /// The fault.
        kind: &'static str,
        /// The key.
        key: &'static str,
        /// A fault of this kind.
        example: &'static str,
    },
    /// A value that the key does not take.
    #[error("`{key}={value}` of `{kind}` is out of place; give {expected}")]
    Value {
        /// The fault.
        kind: &'static str,
        /// The key.
        key: &'static str,
        /// The value given.
        value: String,
        /// What the key takes.
        expected: &'static str,
    },
    /// Spans that run into each other.
    #[error(
        "`{kind}` lasts as long as the time to its next begin, or longer; give a smaller `for` or a larger `every`"
    )]
    Overlap {
        /// The fault.
        kind: &'static str,
    },
    /// A cell or an emitter that the head does not have.
    #[error("`{fault}` is for cell {cell}, and the head has the cells 0 to {last}")]
    NoSuchCell {
        /// The fault as given.
        fault: String,
        /// The cell.
        cell: usize,
        /// The last cell of the head.
        last: usize,
    },
    /// A fault that cannot happen there.
    #[error("`{fault}` cannot be injected into {place}: {reason}")]
    NotHere {
        /// The fault as given.
        fault: String,
        /// Where.
        place: &'static str,
        /// Why not, and what to do instead.
        reason: &'static str,
    },
}

fn meant(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| format!(", `{nearest}` is"))
}
