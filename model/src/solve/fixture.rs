//! A head for unit tests: two cells along each axis, whose planes fix all six coordinates.

use glam::{DVec2, DVec3};

use crate::effects::{Converters, ProfileShape, Stray, Window};
use crate::plan::{CompiledScene, Tier};
use crate::pose::Pose;
use crate::scene::{Cell, DEFAULT_FAINT_A, Detector, Emitter, Noise, Profile, Scene, Slit, Uncertainty};

use super::compiled::Compiled;
use super::readings::Photocurrents;

/// Detectors at ±22 mm on each axis, emitters at ±8 mm, slits 5 mm above the detectors.
pub fn head() -> Scene {
    let mut scene = Scene {
        noise: Some(Noise { shot_bandwidth_hz: 10e3, johnson_bandwidth_hz: 10e3, temperature_k: 300.0, adc_a: 0.6e-9 }),
        uncertainty: Uncertainty::default(),
        ..Scene::default()
    };
    for (direction, x_axis) in [(DVec3::X, DVec3::Y), (DVec3::Y, DVec3::Z), (DVec3::Z, DVec3::X)] {
        for side in [1.0, -1.0] {
            let direction = direction * side;
            let cell = Cell {
                detector: Detector {
                    centre_base_m: direction * 22e-3,
                    x_axis_base: x_axis,
                    normal_base: -direction,
                    length_m: 12e-3,
                    width_m: 1e-3,
                    responsivity_a_per_w: 0.54,
                    dark_current_a: 0.0,
                    interelectrode_ohm: None,
                    saturation_a: None,
                    faint_a: DEFAULT_FAINT_A,
                },
                slit: Slit {
                    distance_m: 5e-3,
                    width_m: 0.6e-3,
                    length_m: 10e-3,
                    offset_m: DVec2::ZERO,
                    tilt_rad: DVec3::ZERO,
                    thickness_m: 0.0,
                },
                emitter: Emitter {
                    position_tool_m: direction * 8e-3,
                    axis_tool: direction,
                    radiant_intensity_w_per_sr: 3e-3,
                    profile: Profile::Cosine { exponent: 1.2 },
                },
                effects: crate::Effects::default(),
            };
            scene.cells.push(cell).expect("six of sixteen");
        }
    }
    scene
}

/// What a calibration finds of a cell, each by itself; `size`: of some of its numbers, for cells to differ.
pub type Effect = (&'static str, fn(cell: &mut Cell, size: f64));

pub const EFFECTS: [Effect; 9] = [
    ("a thick mask", |cell, size| cell.slit.thickness_m = 0.15e-3 * size),
    // With an effect: of such cells alone a host computes a turned slit as a board does.
    ("a turned slit", |cell, size| {
        cell.slit.tilt_rad = DVec3::new(0.01, -0.012 * size, 0.015);
        cell.effects.electrode_gain = [1.001, 1.0];
    }),
    ("a shifted slit", |cell, size| cell.slit.offset_m.x = 8e-5 * size),
    ("a cover", |cell, size| {
        cell.effects.window = Some(Window { thickness_m: 0.7e-3 * size, refractive_index: 1.52 });
    }),
    ("a profile's shape", |cell, size| {
        let (radial, azimuthal) = ([-0.06, 0.17 * size, -0.03, 0.2], [2e-3, -1e-3, 0.03 * size, -0.01]);
        cell.effects.profile = ProfileShape { radial, azimuthal };
    }),
    ("a detector that is not linear", |cell, size| {
        cell.effects.nonlinearity_m = [5e-5, -3e-5 * size, 2e-5, 6e-5, -4e-5].into_iter().collect();
    }),
    ("stray light", |cell, size| {
        let shift = [[2e-6, -3e-6 * size, 1e-6], [1e-6, 2e-6, -2e-6]];
        let bend = [[3e-4, -2e-4, 1e-4 * size, 2e-4, -1e-4, 4e-4]; 2];
        cell.effects.stray =
            Some(Stray { linear_a_per_m: shift, quadratic_a_per_m2: bend, ..Stray::at(5e-8, 1e-3, 12e-3) });
    }),
    ("gains of electrodes", |cell, size| cell.effects.electrode_gain = [1.0 + 4e-3 * size, 0.997]),
    ("converters that are not linear", |cell, size| {
        let curve = |sign: f64| [1e-9, sign * 2e-9 * size, -2e-9, sign * 1e-9].into_iter().collect();
        cell.effects.converters = Some(Converters { full_scale_a: 1e-5, curves_a: [curve(1.0), curve(-1.0)] });
    }),
];

pub fn compiled() -> Compiled<f64> {
    let plan = CompiledScene::compile(&head(), Tier::Paper).expect("a valid scene");
    Compiled::of(&head(), Tier::Paper, plan)
}

/// A pose with something in each coordinate.
pub fn pose() -> Pose {
    Pose::HOME.perturbed(DVec3::new(0.8e-3, -0.5e-3, 0.3e-3), DVec3::new(0.05, 0.03, -0.04))
}

pub fn currents(plan: &CompiledScene<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)))
}
