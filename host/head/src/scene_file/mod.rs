//! The scene file: one TOML text that describes a sensor head.
//!
//! Read in this order: `keys` has every key, `document` parses the text and knows the place of each, `optics` builds the
//! model's [`Scene`], `settings` has the rest. [`SHIPPED`] are the scenes compiled into the program.
//! The file speaks millimetres and degrees; everything that leaves this module is SI.

mod document;
mod keys;
mod optics;
mod settings;

use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::path::Path;

use document::Document;
pub use keys::{FilePlace, Key, KeyPath, Kind, OWN, PER_CELL, SECTIONS, SceneFileError, Section, nearest};
pub use settings::{FrontEnd, Lighting, Tolerance, Workspace};
use slitpose_model::{CompiledScene, Profile, Scene, Tier};

use crate::finding::Finding;
use crate::foreign::printable;
use crate::text_file;

/// What a relative profile may begin with: measured ones, and ones with their greatest intensity beside the axis.
const ON_AXIS: RangeInclusive<f64> = 0.2..=2.0;

/// A right angle in radians, as coarse as tables round it.
const RIGHT_ANGLE_RAD: f64 = 1.6;

/// A scene file, read and checked.
///
/// ```
/// use slitpose_head::scene_file::SceneFile;
/// use slitpose_model::{CompiledScene, MotionPrior, Photocurrents, Pose, Solver, Start, Tier};
///
/// let (file, tier) = (SceneFile::open("wide")?, Tier::Exact { tolerance: 1e-6 });
/// let plan = CompiledScene::<f64>::compile(&file.scene, tier)?;
/// let currents = Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, &Pose::HOME)));
/// let solution = Solver::<f64>::new(&file.scene, tier)?.solve(&currents, Start::Cold, &MotionPrior::AT_REST);
/// assert!(solution.estimate.expect("a pose").pose.translation_m.length() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct SceneFile {
    /// The scene's name, as it is shown; the file's stem if the file gives none.
    pub name: String,
    /// The path or the shipped scene's name, for messages.
    pub origin: String,
    /// The text of the file, to be stored with results made from it.
    pub source: String,
    /// FNV-1a, 64 bits, of the file's bytes: tells scenes apart in captures and on boards.
    pub hash: u64,
    /// The optics.
    pub scene: Scene,
    /// The electronics; `None`: ideal.
    pub front_end: Option<FrontEnd>,
    /// How well parts are known before calibration; `None`: the file does not say.
    pub tolerance: Option<Tolerance>,
    /// Whether the file says how well the common light level is known; else the scene has a usual value.
    pub gives_light_level: bool,
    /// Whether it says how far single emitters may drift from that; else the scene has a usual value, for a calibrated head.
    pub gives_emitter_drift: bool,
    /// Which emitters are lit together, and in which order.
    pub lighting: Lighting,
    /// The box of poses the head is meant for.
    pub workspace: Workspace,
}

impl SceneFile {
    /// Reads the file at `argument`; if there is none, the shipped scene of that name.
    pub fn open(argument: &str) -> Result<Self, SceneFileError> {
        let path = Path::new(argument);
        match Shipped::named(argument) {
            Some(shipped) if !path.exists() || path.is_dir() => shipped.read(),
            _ => match text_file::read(path) {
                Ok(bytes) => Self::from_bytes(argument, &bytes),
                Err(source) => Err(SceneFileError::Read(argument.to_owned(), source)),
            },
        }
    }

    /// Reads a scene from the bytes of a file; `origin` names it in messages.
    pub fn from_bytes(origin: &str, bytes: &[u8]) -> Result<Self, SceneFileError> {
        match std::str::from_utf8(bytes) {
            Ok(text) => Self::parse(origin, text),
            Err(error) => {
                let valid = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
                let place = FilePlace::of(origin, &valid, valid.len());
                let byte = bytes[error.valid_up_to()];
                Err(SceneFileError::Content(
                    place,
                    format!("byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8"),
                ))
            }
        }
    }

    /// Reads a scene from the text of a file; `origin` names it in messages.
    pub fn parse(origin: &str, text: &str) -> Result<Self, SceneFileError> {
        let document = Document::parse(origin, text)?;
        let mut scene = optics::read(&document)?;
        let lighting = settings::read_lighting(&document, &scene)?;
        let workspace = settings::read_workspace(&document)?;
        optics::light_together(&mut scene, &lighting, &workspace);
        // Every rule about optical values stands in the model; compiling applies them all.
        CompiledScene::<f64>::compile(&scene, Tier::Paper).map_err(|error| document.optics_error(error))?;
        let stem = Path::new(origin).file_stem().map(|stem| stem.to_string_lossy());
        let name = document.text(KeyPath::top("name")).map_or_else(|| stem.unwrap_or_default(), Cow::Borrowed);
        Ok(Self {
            // For people only: pages, pictures and terminals show it.
            name: printable(&name).to_string(),
            origin: origin.to_owned(),
            source: text.to_owned(),
            hash: fnv1a_64(text.as_bytes()),
            front_end: settings::read_front_end(&document)?,
            tolerance: settings::read_tolerance(&document)?,
            gives_light_level: optics::read_light_level(&document).is_some(),
            gives_emitter_drift: optics::read_emitter_drift(&document).is_some(),
            lighting,
            workspace,
            scene,
        })
    }

    /// What makes other units likely in tables of emission profiles: of cells with the same one of the first.
    pub fn findings(&self) -> Vec<Finding> {
        let cells = &self.scene.cells;
        let mut findings = Vec::new();
        for (number, cell) in cells.iter().enumerate() {
            let Profile::Table(knots) = &cell.emitter.profile else { continue };
            if cells[..number].iter().any(|earlier| earlier.emitter.profile == cell.emitter.profile) {
                continue;
            }
            let place = format!("{}, cell {number}, emitter.profile", self.origin);
            let (on_axis, last_deg) = (knots[0].1, knots[knots.len() - 1].0.to_degrees());
            if !ON_AXIS.contains(&on_axis) {
                let text = format!(
                    "it begins with {on_axis}, so the emitter has {on_axis} times its radiant_intensity_w_per_sr on the axis"
                );
                let next_step = "profiles are relative, 1 on the axis: are these per cent, or an intensity? Divide them all \
                                 by the first";
                findings.push(Finding::warning(place.clone(), text, next_step));
            }
            if last_deg <= RIGHT_ANGLE_RAD {
                let text = format!("it ends at {last_deg:.4} degrees, and beyond there is no light");
                findings.push(Finding::warning(place, text, "are these radians? Angles are degrees, from 0 to 90"));
            }
        }
        findings
    }

    /// The same head, its emitters lit in other slots. Each emitter has to have one.
    #[must_use]
    pub fn with_lighting(&self, lighting: Lighting) -> Self {
        let mut file = Self { lighting, ..self.clone() };
        optics::light_together(&mut file.scene, &file.lighting, &file.workspace);
        file
    }

    /// Refuses a schedule that takes longer than the frame period of the front end.
    ///
    /// The model and the solver can use such a scene; a board cannot.
    pub(crate) fn require_slots_fit(&self) -> Result<(), SceneFileError> {
        let Some(front_end) = &self.front_end else {
            return Ok(());
        };
        let slot_s = front_end.slot_duration_s(self.scene.cells.len());
        let period_s = front_end.frame_period_s();
        if self.lighting.slots.len() as f64 * slot_s <= period_s {
            return Ok(());
        }
        let document = Document::parse(&self.origin, &self.source)?;
        let slots = self.lighting.slots.len();
        let text = format!(
            "lighting.slots: {slots} slots of {:.1} µs take {:.1} µs, the frame period is {:.1} µs; light more emitters \
             together, or lower front_end.frame_rate_hz, oversampling or settling_s",
            slot_s * 1e6,
            slots as f64 * (slot_s * 1e6),
            period_s * 1e6
        );
        Err(document.error(KeyPath::section("lighting", "slots"), text))
    }
}

/// FNV-1a with 64 bits (Fowler, Noll, Vo; offset basis and prime of the reference text).
pub fn fnv1a_64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

/// A scene that comes with the program.
#[derive(Clone, Copy, Debug)]
pub struct Shipped {
    /// The name that stands for it wherever a scene file is asked for.
    pub name: &'static str,
    /// What it is, in one line.
    pub about: &'static str,
    /// Its scene file.
    pub text: &'static str,
}

/// The default scene.
pub const WIDE: Shipped = Shipped {
    name: "wide",
    about: "six cells rolled ±45°, wide slits: the default, lit nearly all over ±4 mm / ±15°",
    text: include_str!("../../scenes/wide.toml"),
};

/// The optimum within 32 mm.
pub const FINE: Shipped = Shipped {
    name: "fine",
    about: "six cells within 32 mm, the optimum that a search found: 1.8 times as accurate as wide",
    text: include_str!("../../scenes/fine.toml"),
};

/// Nine cells, any one of which may be dark.
pub const REDUNDANT: Shipped = Shipped {
    name: "redundant",
    about: "nine cells with the dimensions of fine: any one of them may go dark",
    text: include_str!("../../scenes/redundant.toml"),
};

/// `wide` with parts that have data sheets.
pub const ORDERABLE: Shipped = Shipped {
    name: "orderable",
    about: "the geometry of wide with parts that have data sheets, and tolerances of its housing",
    text: include_str!("../../scenes/orderable.toml"),
};

/// Slits on the tool.
pub const SPACEMOUSE: Shipped = Shipped {
    name: "spacemouse",
    about: "six emitters that carry their slits, detectors around: the principle of the Space Mouse",
    text: include_str!("../../scenes/spacemouse.toml"),
};

/// Detectors with two axes behind lenses.
pub const MAGLEV: Shipped = Shipped {
    name: "maglev",
    about: "three emitters, three lenses, detectors with two axes: the principle of levitated haptic devices",
    text: include_str!("../../scenes/maglev.toml"),
};

/// Six cells with the dimensions of the bench.
pub const BASE: Shipped = Shipped {
    name: "base",
    about: "six cells rolled 0° and 90° in turn, each with the dimensions of the bench",
    text: include_str!("../../scenes/base.toml"),
};

/// The source paper's test bench.
pub const BENCH: Shipped = Shipped {
    name: "bench",
    about: "the single cell that De La Cruz et al. 2018 measured",
    text: include_str!("../../scenes/bench.toml"),
};

/// Every shipped scene.
pub const SHIPPED: [Shipped; 8] = [WIDE, FINE, REDUNDANT, ORDERABLE, SPACEMOUSE, MAGLEV, BASE, BENCH];

impl Shipped {
    /// The shipped scene of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        SHIPPED.iter().find(|shipped| shipped.name == name)
    }

    /// The shipped scene with this hash, read.
    pub fn with_hash(hash: u64) -> Option<SceneFile> {
        SHIPPED.iter().filter_map(|shipped| shipped.read().ok()).find(|file| file.hash == hash)
    }

    /// Reads it.
    pub fn read(&self) -> Result<SceneFile, SceneFileError> {
        SceneFile::parse(self.name, self.text)
    }
}

#[cfg(test)]
mod tests;
