//! ceres' `TinySolver` by way of `cpp/tiny_solver.cpp`.

use core::ffi::c_int;

use glam::{DQuat, DVec3};
use slitpose_model::{Pose, Profile, Scene};

use crate::chart::ARM_M;
use crate::contender::{Answer, Contender};
use crate::problems::Problem;
use crate::weights::{CELLS, CellNoise, Weighted};

/// Laid out as in `cpp/cell.h`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
struct Cell {
    axes: [[f64; 3]; 3],
    centre_m: [f64; 3],
    slit_height_m: f64,
    slit_low_m: [f64; 2],
    slit_high_m: [f64; 2],
    detector_half_m: [f64; 2],
    emitter_m: [f64; 3],
    emitter_axis: [f64; 3],
    gain_a_per_sr: f64,
    exponent: f64,
}

impl Cell {
    /// # Panics
    /// If the cell is more than the peers' equations cover: they know neither tilted nor thick
    /// slits, nor dark currents, nor tabulated profiles.
    fn of(cell: &slitpose_model::Cell) -> Self {
        let (detector, slit, emitter) = (&cell.detector, &cell.slit, &cell.emitter);
        let Profile::Cosine { exponent } = emitter.profile else {
            panic!("a profile that is no power of the cosine");
        };
        assert!(slit.tilt_rad == DVec3::ZERO && slit.thickness_m == 0.0, "a tilted or thick slit");
        assert!(detector.dark_current_a == 0.0, "a dark current");
        let (x, z) = (detector.x_axis_base, detector.normal_base);
        let half = [0.5 * slit.width_m, 0.5 * slit.length_m];
        Self {
            axes: [x, z.cross(x), z].map(|axis| axis.to_array()),
            centre_m: detector.centre_base_m.to_array(),
            slit_height_m: slit.distance_m,
            slit_low_m: [slit.offset_m.x - half[0], slit.offset_m.y - half[1]],
            slit_high_m: [slit.offset_m.x + half[0], slit.offset_m.y + half[1]],
            detector_half_m: [0.5 * detector.length_m, 0.5 * detector.width_m],
            emitter_m: emitter.position_tool_m.to_array(),
            emitter_axis: emitter.axis_tool.to_array(),
            gain_a_per_sr: detector.responsivity_a_per_w * emitter.radiant_intensity_w_per_sr,
            exponent,
        }
    }
}

/// Laid out as in `cpp/tiny_solver.cpp`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
struct Options {
    arm_m: f64,
    function_tolerance: f64,
    parameter_tolerance: f64,
    cost_threshold: f64,
    trust_region_radius: f64,
}

/// Laid out as in `cpp/tiny_solver.cpp`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
struct RawPose {
    rotation: [f64; 4],
    translation_m: [f64; 3],
}

/// Laid out as in `cpp/tiny_solver.cpp`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
struct RawAnswer {
    pose: RawPose,
    covariance: [[f64; 6]; 6],
    iterations: c_int,
}

unsafe extern "C" {
    fn tiny_solver(
        cells: *const Cell,
        readings: *const Weighted,
        start: *const RawPose,
        options: *const Options,
        answer: *mut RawAnswer,
    );
}

pub struct TinySolver {
    cells: [Cell; CELLS],
    noise: [CellNoise; CELLS],
    options: Options,
}

impl TinySolver {
    pub fn new(scene: &Scene) -> Self {
        Self {
            cells: core::array::from_fn(|cell| Cell::of(&scene.cells[cell])),
            noise: CellNoise::of(scene),
            options: Options {
                arm_m: ARM_M,
                // Of χ², absolute, whatever ceres' comment says: slitpose, too, stops there.
                function_tolerance: 1e-4,
                parameter_tolerance: 1e-8,
                cost_threshold: f64::EPSILON,
                // Nearly Gauss–Newton, as slitpose starts; the default, 1e4, takes more steps when warm.
                trust_region_radius: 1e6,
            },
        }
    }
}

impl Contender for TinySolver {
    fn name(&self) -> &'static str {
        "TinySolver"
    }

    fn solve(&self, problem: &Problem) -> Answer {
        let start = RawPose {
            rotation: problem.start.rotation.to_array(),
            translation_m: problem.start.translation_m.to_array(),
        };
        let mut answer = RawAnswer { pose: start, covariance: [[0.0; 6]; 6], iterations: 0 };
        let readings: [Weighted; CELLS] = core::array::from_fn(|cell| self.noise[cell].weigh(&problem.pairs[cell]));
        // SAFETY: six cells and six readings, as C++ lays them out, alive until it returns.
        unsafe { tiny_solver(self.cells.as_ptr(), readings.as_ptr(), &start, &self.options, &mut answer) };
        Answer {
            pose: Pose {
                rotation: DQuat::from_array(answer.pose.rotation),
                translation_m: DVec3::from_array(answer.pose.translation_m),
            },
            covariance: answer.covariance,
            steps: usize::try_from(answer.iterations).unwrap_or_default(),
        }
    }
}
