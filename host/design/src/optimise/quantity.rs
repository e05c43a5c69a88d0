//! What may be free in a search.

use std::fmt;
use std::str::FromStr;

use slitpose_head::scene_file::SceneFile;

use super::text::current;

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

impl Quantity {
    /// All, in the order in which they act.
    pub const ALL: [Self; 10] = [
        Self::Cells,
        Self::EmitterRadius,
        Self::EmitterDistance,
        Self::Lift,
        Self::Roll,
        Self::EmitterTilt,
        Self::SlitDistance,
        Self::SlitWidth,
        Self::SlitLength,
        Self::FullScale,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::EmitterRadius => "emitter_radius",
            Self::EmitterDistance => "emitter_distance",
            Self::SlitDistance => "slit_distance",
            Self::SlitWidth => "slit_width",
            Self::SlitLength => "slit_length",
            Self::Roll => "roll",
            Self::EmitterTilt => "emitter_tilt",
            Self::Lift => "lift",
            Self::FullScale => "full_scale",
            Self::Cells => "cells",
        }
    }

    /// Its unit on the command line.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Roll | Self::EmitterTilt => "°",
            Self::FullScale => "µA",
            Self::Cells => "",
            _ => "mm",
        }
    }

    /// Bounds unless others are given: what can be milled and bought, for a head that a hand holds.
    fn usual_bounds(self) -> [f64; 2] {
        match self {
            Self::EmitterRadius => [6.0, 15.0],
            Self::EmitterDistance => [9.0, 25.0],
            Self::SlitDistance => [2.0, 10.0],
            Self::SlitWidth => [0.1, 2.0],
            Self::SlitLength => [2.0, 20.0],
            Self::Roll => [0.0, 90.0],
            Self::EmitterTilt => [-30.0, 30.0],
            Self::Lift => [-8.0, 8.0],
            Self::FullScale => [1.0, 100.0],
            Self::Cells => [6.0, 10.0],
        }
    }

    /// The step that a drawing gives it in.
    fn step(self) -> f64 {
        match self {
            Self::Roll | Self::EmitterTilt => 0.1,
            Self::FullScale => 0.1,
            Self::Cells => 1.0,
            _ => 0.01,
        }
    }

    /// Rounded to what a drawing states.
    pub(super) fn rounded(self, value: f64) -> f64 {
        // 1/step is a whole number: divided last, so that no digits of rounding follow.
        let steps = self.step().recip().round();
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
        let quantity = Quantity::ALL.into_iter().find(|quantity| quantity.name() == name).ok_or_else(|| {
            let names = Quantity::ALL.map(Quantity::name).join(", ");
            format!("there is no `{name}` to be free; there are {names}")
        })?;
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
