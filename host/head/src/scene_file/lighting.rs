//! `[lighting]`: which emitters are lit together, and in which order.

use slitpose_model::{Cell, Scene};

use super::document::Document;
use super::error::{ContentFault, KeyPath, LightingFault, SceneFileError};

/// The slots of one frame, in the order they are lit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lighting {
    /// Emitter numbers of each slot; the dark slot is empty.
    pub slots: Vec<Vec<usize>>,
}

impl Lighting {
    /// Every emitter in a slot of its own, then the dark slot. Both axes of a detector share a slot.
    pub fn one_by_one(scene: &Scene) -> Self {
        let lit = scene.cells.iter().enumerate().filter(|(number, cell)| !cell.is_second_axis(*number));
        let slots = lit.map(|(number, cell)| [number].into_iter().chain(cell.other_axis()).collect());
        Self { slots: slots.chain([Vec::new()]).collect() }
    }

    /// The slot that lights an emitter.
    pub(crate) fn slot_of(&self, emitter: usize) -> Option<usize> {
        self.slots.iter().position(|slot| slot.contains(&emitter))
    }

    /// The slot in which nothing is lit.
    pub fn dark_slot(&self) -> Option<usize> {
        self.slots.iter().position(Vec::is_empty)
    }
}

/// The lighting of the file, or [`Lighting::one_by_one`].
pub(super) fn read(document: &Document<'_>, scene: &Scene) -> Result<Lighting, SceneFileError> {
    let path = KeyPath::section("lighting", "slots");
    let expected = "slots of emitter numbers, e.g. [[0, 3], [1, 4], [2, 5], []]";
    let Some(entry) = document.find(path) else {
        return Ok(Lighting::one_by_one(scene));
    };
    let cells = scene.cells.len();
    let mut lighting = Lighting { slots: Vec::new() };
    for (number, slot) in document.as_array(path, entry, expected)?.iter().enumerate() {
        let emitters = document.as_array(path, slot, expected)?;
        let refuse = |span, fault| Err(document.error_at(span, ContentFault::Lighting(fault)));
        if let (true, Some(first)) = (emitters.is_empty(), lighting.dark_slot()) {
            let second = number;
            return refuse(slot.span(), LightingFault::TwoDark { first, second });
        }
        lighting.slots.push(Vec::new());
        for entry in emitters.iter() {
            let given = document.as_integer(path, entry)?;
            let Some(emitter) = usize::try_from(given).ok().filter(|emitter| *emitter < cells) else {
                let last = cells - 1;
                return refuse(entry.span(), LightingFault::Unknown { emitter: given, last });
            };
            if let Some(first) = lighting.slot_of(emitter) {
                let second = number;
                return refuse(entry.span(), LightingFault::Twice { emitter, first, second });
            }
            lighting.slots[number].push(emitter);
        }
    }
    let refuse = |fault| Err(document.error(path, ContentFault::Lighting(fault)));
    if let Some(emitter) = (0..cells).find(|emitter| lighting.slot_of(*emitter).is_none()) {
        return refuse(LightingFault::Never { emitter });
    }
    let others = scene.cells.iter().map(Cell::other_axis).enumerate();
    let mut pairs = others.filter_map(|(cell, other)| Some((cell, other?)));
    match pairs.find(|&(cell, other)| lighting.slot_of(cell) != lighting.slot_of(other)) {
        None => Ok(lighting),
        Some((first, second)) => refuse(LightingFault::Apart { first, second }),
    }
}
