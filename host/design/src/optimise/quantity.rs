//! What may be free in a search, and a candidate as the text of a scene.

use std::fmt;
use std::str::FromStr;

use glam::{DQuat, DVec3};
use slitpose_head::scene_file::SceneFile;
use slitpose_model::Cell;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, value};

use crate::DesignError;

/// A dimension of a head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Distance of the emitters from the tool's z axis.
    EmitterRadius,
    /// From each emitter to its detector.
    EmitterDistance,
    /// From each detector to its slit.
    SlitDistance,
    /// Width of the slits.
    SlitWidth,
    /// Length of the slits.
    SlitLength,
    /// Of each detector about its normal, against the tool's equator; its sign alternates from cell to cell.
    Roll,
    /// Of each emitter's axis towards the tool's z; its sign alternates.
    EmitterTilt,
    /// Of each cell along the tool's z; its sign alternates.
    Lift,
    /// Electrode current at the top code of the converters.
    FullScale,
    /// Number of cells, evenly on the ring of the first.
    Cells,
}

/// Name on the command line, unit there, bounds unless others are given (what can be milled and bought, for a head that a
/// hand holds), and steps per unit that a drawing gives it in.
type Entry = (Quantity, &'static str, &'static str, [f64; 2], f64);

/// All, in the order in which they act.
const ENTRIES: [Entry; 10] = [
    (Quantity::Cells, "cells", "", [6.0, 10.0], 1.0),
    (Quantity::EmitterRadius, "emitter_radius", "mm", [6.0, 15.0], 100.0),
    (Quantity::EmitterDistance, "emitter_distance", "mm", [9.0, 25.0], 100.0),
    (Quantity::Lift, "lift", "mm", [-8.0, 8.0], 100.0),
    (Quantity::Roll, "roll", "°", [0.0, 90.0], 10.0),
    (Quantity::EmitterTilt, "emitter_tilt", "°", [-30.0, 30.0], 10.0),
    (Quantity::SlitDistance, "slit_distance", "mm", [2.0, 10.0], 100.0),
    (Quantity::SlitWidth, "slit_width", "mm", [0.1, 2.0], 100.0),
    (Quantity::SlitLength, "slit_length", "mm", [2.0, 20.0], 100.0),
    (Quantity::FullScale, "full_scale", "µA", [1.0, 100.0], 10.0),
];

impl Quantity {
    /// All, in the order in which they act.
    pub fn all() -> impl Iterator<Item = Self> {
        ENTRIES.into_iter().map(|(quantity, ..)| quantity)
    }

    pub(crate) fn names() -> String {
        Self::all().map(Self::name).collect::<Vec<_>>().join(", ")
    }

    fn entry(self) -> Entry {
        // Each has one.
        ENTRIES.into_iter().find(|(quantity, ..)| *quantity == self).unwrap_or(ENTRIES[0])
    }

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        self.entry().1
    }

    /// Its unit on the command line.
    pub fn unit(self) -> &'static str {
        self.entry().2
    }

    fn usual_bounds(self) -> [f64; 2] {
        self.entry().3
    }

    pub(super) fn rounded(self, value: f64) -> f64 {
        let steps = self.entry().4;
        (value * steps).round() / steps
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A quantity that is free within bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Free {
    /// Which.
    pub quantity: Quantity,
    /// Least and most, in its unit.
    pub bounds: [f64; 2],
    /// Whether the bounds were asked for; else they are the usual ones.
    pub is_given: bool,
}

impl Free {
    /// Usual bounds that leave out the scene's own value are widened to from half to twice of it: it is a head of another
    /// size. Given ones stay.
    #[must_use]
    pub fn around(self, file: &SceneFile) -> Self {
        let value = current(file, self.quantity);
        let [from, to] = self.bounds;
        if self.is_given || !value.is_finite() || (from..=to).contains(&value) {
            return self;
        }
        let (low, high) = (value.min(0.5 * value).min(2.0 * value), value.max(2.0 * value));
        Self { bounds: [from.min(low), to.max(high)], ..self }
    }

    /// Whether the scene's own value is within the bounds, to rounding.
    pub fn has(&self, file: &SceneFile) -> bool {
        let value = current(file, self.quantity);
        let slack = 1e-9 * (self.bounds[1] - self.bounds[0]);
        (self.bounds[0] - slack..=self.bounds[1] + slack).contains(&value)
    }
}

impl FromStr for Free {
    type Err = String;

    /// `slit_width`, or `slit_width=0.3..1.2`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (name, bounds) = text.split_once('=').map_or((text, None), |(name, bounds)| (name, Some(bounds)));
        let quantity = Quantity::all()
            .find(|quantity| quantity.name() == name)
            .ok_or_else(|| format!("there is no `{name}` to be free; there are {}", Quantity::names()))?;
        let Some(bounds) = bounds else {
            return Ok(Self { quantity, bounds: quantity.usual_bounds(), is_given: false });
        };
        let ends = bounds.split_once("..").and_then(|(from, to)| Some([from.parse().ok()?, to.parse().ok()?]));
        let unit = quantity.unit();
        let example = quantity.usual_bounds();
        match ends {
            Some([from, to]) if from < to && f64::is_finite(from) && f64::is_finite(to) => {
                Ok(Self { quantity, bounds: [from, to], is_given: true })
            }
            _ => Err(format!(
                "`{bounds}` are no bounds; give the least and the most {unit}, e.g. {name}={}..{}",
                example[0], example[1]
            )),
        }
    }
}

/// The text of `file` with `values` set, in their units.
pub(super) fn with_values(file: &SceneFile, values: &[(Quantity, f64)]) -> Result<String, DesignError> {
    let error = |message: &str| DesignError::Text(file.origin.clone(), format!(": {message}"));
    let no_tables = || error("its cells are no [[cell]] tables");
    let mut document: DocumentMut =
        file.source.parse().map_err(|found: toml_edit::TomlError| error(found.message()))?;
    let mut cells: Vec<Cell> = file.scene.cells.iter().cloned().collect();
    let mut is_moved = false;
    let is_round = |cell: &Cell| cell.opening().is_hole();
    let is_hole = cells.iter().any(is_round);
    let is_size = |value: &(Quantity, f64)| matches!(value.0, Quantity::SlitWidth | Quantity::SlitLength);
    if is_hole && !cells.iter().all(is_round) && values.iter().any(is_size) {
        return Err(error("slit_width and slit_length cannot be free where some cells have slits and some holes"));
    }
    // Both axes of a detector are where its first one is.
    let is_second = |(number, cell): &(usize, &mut Cell)| cell.is_second_axis(*number);
    for &(quantity, number) in values {
        match quantity {
            Quantity::SlitDistance => set(&mut document, "slit", "distance_mm", number),
            Quantity::SlitWidth if is_hole => set(&mut document, "slit", "diameter_mm", number),
            Quantity::SlitWidth => set(&mut document, "slit", "width_mm", number),
            Quantity::SlitLength if is_hole => {
                return Err(error("slit_length cannot be free, its holes are round; free slit_width, their diameter"));
            }
            Quantity::SlitLength => set(&mut document, "slit", "length_mm", number),
            Quantity::FullScale => {
                if file.front_end.is_none() {
                    let text = " has no [front_end], so there is no full scale to choose; leave full_scale out, or add the section";
                    return Err(DesignError::Text(file.origin.clone(), text.to_owned()));
                }
                // Digits of microamperes, not of their product with 1e-6.
                set(
                    &mut document,
                    "front_end",
                    "full_scale_a",
                    format!("{number}e-6").parse().unwrap_or(number * 1e-6),
                );
            }
            Quantity::Cells => {
                let count = number.round().max(1.0) as usize;
                if count != cells.len() && cells.iter().any(|cell| cell.other_axis().is_some()) {
                    return Err(error(
                        "cells cannot be free where a detector has two axes; leave their number as it is",
                    ));
                }
                if count != cells.len() {
                    is_moved = true;
                    cells = ring(&cells[0], count);
                    document.remove("lighting");
                    like_the_first(cell_tables(&mut document).ok_or_else(no_tables)?, count);
                }
            }
            _ => {
                is_moved = true;
                let firsts = cells.iter_mut().enumerate().filter(|cell| !is_second(cell));
                for (index, (_, cell)) in firsts.enumerate() {
                    let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
                    place(cell, quantity, number, sign);
                }
            }
        }
    }
    if is_moved {
        let tables = cell_tables(&mut document).ok_or_else(no_tables)?;
        let firsts = cells.iter_mut().enumerate().zip(tables.iter_mut()).filter(|(cell, _)| !is_second(cell));
        for ((_, cell), table) in firsts {
            let (detector, emitter) = (&cell.detector, &cell.emitter);
            for (key, vector) in [
                ("detector_mm", detector.centre_base_m * 1e3),
                ("x_axis", detector.x_axis_base),
                ("normal", detector.normal_base),
                ("emitter_mm", emitter.position_tool_m * 1e3),
                ("emitter_axis", emitter.axis_tool),
            ] {
                table[key] = value(array(vector));
            }
        }
    }
    rename(&mut document, file);
    Ok(document.to_string())
}

/// The value of `quantity` in `file`, in its unit; that of the first cell stands for all.
pub(super) fn current(file: &SceneFile, quantity: Quantity) -> f64 {
    let cell = &file.scene.cells[0];
    let (detector, emitter) = (&cell.detector, &cell.emitter);
    match quantity {
        Quantity::EmitterRadius => emitter.position_tool_m.truncate().length() * 1e3,
        Quantity::EmitterDistance => emitter.position_tool_m.distance(detector.centre_base_m) * 1e3,
        Quantity::SlitDistance => cell.slit.distance_m * 1e3,
        Quantity::SlitWidth => cell.slit.width_m * 1e3,
        Quantity::SlitLength => cell.slit.length_m * 1e3,
        Quantity::Roll => {
            let level = level(detector.normal_base);
            let up = detector.normal_base.cross(level);
            let roll = detector.x_axis_base.dot(up).atan2(detector.x_axis_base.dot(level)).to_degrees().abs();
            roll.min(180.0 - roll)
        }
        Quantity::EmitterTilt => {
            let radial = emitter.position_tool_m.with_z(0.0).normalize_or(emitter.axis_tool);
            emitter.axis_tool.z.atan2(emitter.axis_tool.dot(radial)).to_degrees()
        }
        Quantity::Lift => emitter.position_tool_m.z * 1e3,
        Quantity::FullScale => file.front_end.map_or(f64::NAN, |front_end| front_end.full_scale_a * 1e6),
        Quantity::Cells => file.scene.cells.len() as f64,
    }
}

/// A direction across `normal` in the plane of the ring.
fn level(normal: DVec3) -> DVec3 {
    DVec3::Z.cross(normal).normalize_or(normal.any_orthonormal_vector())
}

fn place(cell: &mut Cell, quantity: Quantity, number: f64, sign: f64) {
    let (detector, emitter) = (&mut cell.detector, &mut cell.emitter);
    let between = detector.centre_base_m - emitter.position_tool_m;
    match quantity {
        Quantity::EmitterRadius => {
            let outward = emitter.position_tool_m.with_z(0.0).normalize_or(emitter.axis_tool.with_z(0.0));
            emitter.position_tool_m = (outward * number * 1e-3).with_z(emitter.position_tool_m.z);
            detector.centre_base_m = emitter.position_tool_m + between;
        }
        Quantity::EmitterDistance => {
            let towards = between.normalize_or(-detector.normal_base);
            detector.centre_base_m = emitter.position_tool_m + towards * number * 1e-3;
        }
        Quantity::Lift => {
            emitter.position_tool_m.z = sign * number * 1e-3;
            detector.centre_base_m = emitter.position_tool_m + between;
        }
        Quantity::Roll => {
            let level = level(detector.normal_base);
            let (sin, cos) = (sign * number).to_radians().sin_cos();
            detector.x_axis_base = (level * cos + detector.normal_base.cross(level) * sin).normalize();
        }
        Quantity::EmitterTilt => {
            let outward = between.with_z(0.0).normalize_or(between);
            let (sin, cos) = (sign * number).to_radians().sin_cos();
            emitter.axis_tool = (outward * cos + DVec3::Z * sin).normalize();
        }
        Quantity::SlitDistance | Quantity::SlitWidth | Quantity::SlitLength | Quantity::FullScale | Quantity::Cells => {
        }
    }
}

/// So many cells like `first`, evenly around z; rolls alternate.
fn ring(first: &Cell, count: usize) -> Vec<Cell> {
    let turned = |k: usize| {
        let turn = DQuat::from_rotation_z(std::f64::consts::TAU * k as f64 / count as f64);
        let mut cell = first.clone();
        let (detector, emitter) = (&mut cell.detector, &mut cell.emitter);
        if k % 2 == 1 {
            // Mirrored at the plane of the ring.
            let mirrored = |v: DVec3| v.with_z(-v.z);
            detector.centre_base_m = mirrored(detector.centre_base_m);
            detector.x_axis_base = mirrored(detector.x_axis_base);
            detector.normal_base = mirrored(detector.normal_base);
            emitter.position_tool_m = mirrored(emitter.position_tool_m);
            emitter.axis_tool = mirrored(emitter.axis_tool);
        }
        detector.centre_base_m = turn * detector.centre_base_m;
        detector.x_axis_base = (turn * detector.x_axis_base).normalize();
        detector.normal_base = (turn * detector.normal_base).normalize();
        emitter.position_tool_m = turn * emitter.position_tool_m;
        emitter.axis_tool = (turn * emitter.axis_tool).normalize();
        cell
    };
    (0..count).map(turned).collect()
}

fn cell_tables(document: &mut DocumentMut) -> Option<&mut ArrayOfTables> {
    document.get_mut("cell").and_then(Item::as_array_of_tables_mut)
}

/// Makes `count` tables of `tables`, all like the first.
fn like_the_first(tables: &mut ArrayOfTables, count: usize) {
    let first: Table = tables.get(0).cloned().unwrap_or_default();
    let mut other = first.clone();
    // After the others, and without the remarks before the first.
    other.set_position(None);
    other.decor_mut().set_prefix("\n");
    tables.clear();
    tables.push(first);
    tables.extend(std::iter::repeat_n(other, count - 1));
}

/// Sets a key for all cells, also where a cell has its own.
fn set(document: &mut DocumentMut, section: &str, key: &str, number: f64) {
    for table in cell_tables(document).into_iter().flat_map(ArrayOfTables::iter_mut) {
        if let Some(own) = table.get_mut(section).and_then(Item::as_table_like_mut) {
            own.remove(key);
        }
    }
    // Without the remark on the value before.
    document[section][key] = value(number);
}

/// Replaces what the text says of the head that the search began with: name, heading, and remarks on its currents and cells.
fn rename(document: &mut DocumentMut, file: &SceneFile) {
    const FROM: &str = "optimised from: ";
    let name = file.name.strip_prefix(FROM).unwrap_or(&file.name);
    document["name"] = value(format!("{FROM}{name}"));
    let heading =
        format!("# Found by `slitpose scene optimise`; it began with the scene \"{}\".\n", name.escape_default());
    let mut is_first = true;
    for (mut key, item) in document.iter_mut() {
        let decor = match item {
            Item::Table(table) => Some(table.decor_mut()),
            Item::Value(_) => Some(key.leaf_decor_mut()),
            _ => None,
        };
        if let Some(decor) = decor.filter(|_| std::mem::take(&mut is_first)) {
            decor.set_prefix(heading.as_str());
        }
    }
    if let Some(full_scale) = document.get_mut("front_end").and_then(|item| item.get_mut("full_scale_a")) {
        full_scale.as_value_mut().into_iter().for_each(|value| value.decor_mut().set_suffix(""));
    }
    if let Some(first) = cell_tables(document).and_then(|cells| cells.get_mut(0)) {
        first.decor_mut().set_prefix("\n");
    }
}

/// To the picometre; zero without sign.
fn array(vector: DVec3) -> Array {
    vector.to_array().map(|number| (number * 1e12).round() / 1e12 + 0.0).into_iter().collect()
}
