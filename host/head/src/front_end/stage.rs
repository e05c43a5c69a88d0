//! Conversion of scans to photocurrents.

use slitpose_model::{Pair, Photocurrents, Reading, Scene};
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

use super::noise;
use super::settling::Settling;
use crate::scene_file::SceneFile;

/// Least settling gain of a front end that measures.
const MIN_GAIN: f64 = 1e-9;

/// Converts the scans of one configuration of one board.
#[derive(Clone, Debug)]
pub struct Stage {
    scaling: AdcScaling,
    oversampling: u16,
    cells: Vec<CellStage>,
}

#[derive(Clone, Copy, Debug)]
struct CellStage {
    /// Photocurrent at nominal drive per step of a word, amperes.
    amperes_per_word: f64,
    exposure_s: f64,
    /// I_D/2, for schedules without a dark slot.
    half_dark_a: f64,
    /// Whether the front end has at least the gain [`MIN_GAIN`].
    measures: bool,
}

impl Stage {
    /// The stage for a board that runs `schedule` with `scaling` on the head of `file`. A scene without
    /// front end is taken as ideal, without settling time.
    ///
    /// The schedule and the scaling must be valid and have a slot for each of the scene's cells.
    pub fn new(file: &SceneFile, schedule: &Schedule, scaling: &AdcScaling) -> Self {
        let time_constant_s = file.front_end.map_or(0.0, |front_end| front_end.time_constant_s);
        let tick_s = f64::from(schedule.tick_hz).recip();
        let reference = schedule.reference_ticks();
        let cells = (0..file.scene.cells.len())
            .map(|cell| {
                let settling =
                    Settling::of_cell(schedule, cell, time_constant_s).unwrap_or(Settling { gain: 1.0, delay_s: 0.0 });
                let sampled = schedule.lit_sample_ticks(cell).unwrap_or(reference);
                CellStage {
                    amperes_per_word: scaling.amperes_per_code / f64::from(schedule.oversampling) / settling.gain,
                    exposure_s: (sampled - reference) * tick_s - settling.delay_s,
                    measures: settling.gain.abs() >= MIN_GAIN,
                    half_dark_a: 0.5 * file.scene.cells[cell].detector.dark_current_a,
                }
            })
            .collect();
        Self { scaling: *scaling, oversampling: schedule.oversampling, cells }
    }

    /// The scene of `file` with the noise of its front end, for the solver's weights.
    pub fn weighted_scene(file: &SceneFile, schedule: &Schedule, scaling: &AdcScaling) -> Scene {
        let mut scene = file.scene.clone();
        if let Some(front_end) = &file.front_end {
            let gain = (0..scene.cells.len())
                .filter_map(|cell| Settling::of_cell(schedule, cell, front_end.time_constant_s))
                .map(|settling| settling.gain.abs())
                .fold(1.0, f64::min)
                .max(MIN_GAIN);
            scene.noise = Some(noise::of_lit_minus_dark(&scene, front_end, schedule, scaling, gain));
        }
        scene
    }

    /// Time at which the light of each cell left its emitter, relative to the reference instant, seconds.
    pub fn exposures_s(&self) -> Vec<f64> {
        self.cells.iter().map(|cell| cell.exposure_s).collect()
    }

    /// Photocurrent of cell `cell` at nominal drive per step of a word, amperes, zero if it does not measure; and the
    /// word of no light, for schedules without a dark slot.
    pub(crate) fn line(&self, cell: usize) -> (f64, f64) {
        let stage = &self.cells[cell];
        let zero = self.scaling.zero_code * f64::from(self.oversampling);
        if stage.measures {
            (stage.amperes_per_word, zero + stage.half_dark_a / stage.amperes_per_word)
        } else {
            (0.0, zero)
        }
    }

    /// The photocurrents of a scan, without dark current, at nominal drive.
    ///
    /// Without a dark slot, the code at zero current replaces the dark words, and the scene's I_D the
    /// dark current. A cell whose emitter was off has no photocurrents.
    pub fn photocurrents(&self, scan: &RawScan) -> Photocurrents {
        let zero = self.scaling.zero_code * f64::from(self.oversampling);
        let dark_words = scan.dark();
        let readings =
            self.cells.iter().zip(scan.lit()).zip(scan.levels()).enumerate().map(|(cell, ((stage, &lit), level))| {
                let level = level.relative();
                if level == 0.0 || !stage.measures {
                    return Reading::Missing;
                }
                if lit.iter().any(|&word| self.scaling.is_saturated(word, self.oversampling)) {
                    return Reading::Saturated;
                }
                let current = |electrode: usize| match dark_words {
                    Some(dark) => {
                        (f64::from(lit[electrode]) - f64::from(dark[cell][electrode])) * stage.amperes_per_word / level
                    }
                    None => ((f64::from(lit[electrode]) - zero) * stage.amperes_per_word - stage.half_dark_a) / level,
                };
                Reading::Light(Pair { i_x1_a: current(0), i_x2_a: current(1) })
            });
        Photocurrents { cells: readings.collect() }
    }
}
