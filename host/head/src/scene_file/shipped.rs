//! The scenes that are compiled into the program.

use super::{SceneFile, SceneFileError};

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
pub const SHIPPED: [Shipped; 7] = [WIDE, FINE, REDUNDANT, SPACEMOUSE, MAGLEV, BASE, BENCH];

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
