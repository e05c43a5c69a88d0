//! Automatic exposure: levels that keep photocurrents between faint and saturated.
//!
//! For each cell the larger of its two currents is watched as a share of the range from
//! zero current to saturation. As soon as a share is above [`BRIGHT`] the levels change at
//! once; otherwise every [`DECIDE_MS`], by the largest share since the last decision:
//!
//! | largest share | level |
//! |---|---|
//! | saturated | halved |
//! | above [`BRIGHT`] | so that the share becomes [`TARGET`] |
//! | between [`FAINT`] and [`BRIGHT`] | as it is |
//! | below [`FAINT`] | so that the share becomes [`TARGET`] |
//! | below [`BLIND`] | nominal: the light does not reach the detector, so more of it does not help |
//!
//! Levels end at [`LOWEST`] and at the limits of the hardware. A change of levels starts a
//! new frame, so it costs the frame it interrupts.

use slitpose_protocol::{AdcScaling, Configuration, Level, Levels, MAX_CELLS, RawScan, Schedule};

/// Milliseconds between decisions that can wait.
const DECIDE_MS: u64 = 20;

const BRIGHT: f32 = 0.85;
const TARGET: f32 = 0.6;
const FAINT: f32 = 0.3;
const BLIND: f32 = 0.01;

/// No emitter is driven at a lower level: an eighth of nominal.
const LOWEST: Level = Level(Level::NOMINAL.0 / 8);

#[derive(Debug)]
pub(crate) struct AutomaticExposure {
    scaling: AdcScaling,
    /// Words at zero current, and words from there to saturation.
    zero: i32,
    range: i32,
    /// Largest excursion of each cell since the last decision, in words.
    largest: [i32; MAX_CELLS],
    decide_at: u64,
    /// A cell is near the end of its range.
    is_urgent: bool,
}

impl AutomaticExposure {
    pub fn new(scaling: AdcScaling) -> Self {
        Self { scaling, zero: 0, range: 1, largest: [0; MAX_CELLS], decide_at: 0, is_urgent: false }
    }

    /// Begins anew: scans of `schedule` follow, from the device tick `now` on.
    pub fn begin(&mut self, now: u64, schedule: &Schedule) {
        let oversampling = f32::from(schedule.oversampling);
        let zero = self.scaling.zero_code as f32;
        self.zero = (zero * oversampling) as i32;
        self.range = ((zero - f32::from(self.scaling.saturation_code)) * oversampling) as i32;
        self.restart(now, schedule.tick_hz);
    }

    /// Takes the currents of a scan into account.
    pub fn watch(&mut self, scan: &RawScan) {
        // Divided first: the range may have either sign.
        let near_the_end = (self.range.abs() as f32 * BRIGHT) as i32;
        let sign = self.range.signum();
        for (largest, pair) in self.largest.iter_mut().zip(scan.lit()) {
            let excursion = pair.map(|word| (self.zero - i32::from(word)) * sign);
            *largest = (*largest).max(excursion[0]).max(excursion[1]);
            self.is_urgent |= *largest >= near_the_end;
        }
    }

    /// The levels to go on with from the device tick `now` on, if they are to change.
    /// `limit` lowers levels to the nearest ones that the hardware can drive by a schedule.
    pub fn levels(
        &mut self,
        now: u64,
        configuration: &Configuration,
        limit: impl FnOnce(&Schedule, &mut [Level]),
    ) -> Option<Levels> {
        if now < self.decide_at && !self.is_urgent {
            return None;
        }
        let Configuration { schedule, levels: old, .. } = configuration;
        let mut new = old.clone();
        for (level, &largest) in new.iter_mut().zip(&self.largest) {
            let share = largest as f32 / self.range.abs() as f32;
            *level = decide(*level, share).max(LOWEST);
        }
        limit(schedule, &mut new);
        self.restart(now, schedule.tick_hz);
        (new != *old).then_some(new)
    }

    fn restart(&mut self, now: u64, tick_hz: u32) {
        self.largest = [0; MAX_CELLS];
        self.is_urgent = false;
        self.decide_at = now.saturating_add(u64::from(tick_hz) / 1_000 * DECIDE_MS);
    }
}

fn decide(level: Level, share: f32) -> Level {
    if share < BLIND {
        Level::NOMINAL
    } else if share >= 1.0 {
        Level(level.0 / 2)
    } else if !(FAINT..BRIGHT).contains(&share) {
        // Saturates at the ends of u16.
        Level((f32::from(level.0) * (TARGET / share)) as u16)
    } else {
        level
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pcb::{TICK_HZ, default_configuration as configuration};

    const TICKS_PER_MS: u64 = TICK_HZ as u64 / 1_000;

    /// The highest level of the tests' hardware: 1.875 times nominal.
    const HIGHEST: Level = Level(0xf000);

    fn limit(_: &Schedule, levels: &mut [Level]) {
        levels.iter_mut().for_each(|level| *level = (*level).min(HIGHEST));
    }

    const FALLING: AdcScaling =
        AdcScaling { zero_code: 4031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 31 };
    const RISING: AdcScaling =
        AdcScaling { zero_code: 64.0, amperes_per_code: 2.5e-9, bits: 12, saturation_code: 4064 };

    /// The levels after `scans` scans, and the share of the range that cell 2 then shows.
    /// At nominal level cell 2 shows `share` and the others half of the range; the
    /// photocurrents follow the levels.
    fn settle(scaling: AdcScaling, share: f32, scans: u64) -> (Levels, f32) {
        let mut configuration = configuration();
        let mut exposure = AutomaticExposure::new(scaling);
        exposure.begin(0, &configuration.schedule);
        let (zero, end) = (scaling.zero_code as f32, f32::from(scaling.saturation_code));
        let mut seen = share;
        for n in 0..scans {
            let mut scan = RawScan::new(6, true);
            for cell in 0..6 {
                let at_nominal = if cell == 2 { share } else { 0.5 };
                let level = f32::from(configuration.levels[cell].0) / f32::from(Level::NOMINAL.0);
                let shown = (at_nominal * level).min(1.05);
                let word = (zero + shown * (end - zero)) * 4.0;
                scan.lit_mut()[cell] = [(4.0 * zero) as u16, word as u16];
                if cell == 2 {
                    seen = shown;
                }
            }
            exposure.watch(&scan);
            if let Some(levels) = exposure.levels(n * TICKS_PER_MS / 4, &configuration, limit) {
                configuration.levels = levels;
            }
        }
        (configuration.levels, seen)
    }

    #[test]
    fn a_cell_out_of_range_comes_into_range_and_the_others_keep_their_levels() {
        for scaling in [FALLING, RISING] {
            for (share, expected) in [(0.16, 0.30), (0.4, 0.4), (0.86, 0.6), (0.95, 0.6), (3.0, 0.75)] {
                let (levels, seen) = settle(scaling, share, 400);
                assert!((seen - expected).abs() < 0.02, "{share}: {seen}, {levels:?}");
                assert_eq!(levels[0], Level::NOMINAL);
                assert_eq!(levels[5], Level::NOMINAL);
            }
        }
    }

    #[test]
    fn very_faint_and_very_bright_cells_end_at_the_limits_of_the_levels() {
        let (levels, _) = settle(FALLING, 0.02, 400);
        assert_eq!(levels[2], HIGHEST);
        let (levels, _) = settle(FALLING, 100.0, 400);
        assert_eq!(levels[2], LOWEST);
    }

    /// The table of this module, at the words where one row ends and the next begins. Of FALLING, with
    /// four conversions a word, zero is 4031 · 4 = 16 124 and the range (4031 − 31) · 4 = 16 000.
    #[test]
    fn shares_at_the_ends_of_the_tables_rows_are_decided_by_their_rows() {
        let configuration = configuration();
        let decided = |excursion: u16, now: u64| {
            let mut exposure = AutomaticExposure::new(FALLING);
            exposure.begin(0, &configuration.schedule);
            let mut scan = RawScan::new(6, true);
            scan.lit_mut().fill([16_124; 2]);
            scan.lit_mut()[2][1] = 16_124 - excursion;
            exposure.watch(&scan);
            exposure.levels(now, &configuration, limit).map(|levels| levels[2].0)
        };
        let scaled = |excursion: u16| Some((32_768.0 * (0.6 * 16_000.0 / f32::from(excursion))) as u16);
        let highest = Some(HIGHEST.0);
        let due = 20 * TICKS_PER_MS;
        for (excursion, now, level) in [
            (16_001, 0, Some(16_384)),
            (16_000, 0, Some(16_384)),
            (15_999, 0, scaled(15_999)),
            (13_600, 0, scaled(13_600)),
            (13_599, 0, None),
            (13_599, due, None),
            (4_801, due, None),
            (4_799, due, highest),
            (4_799, due - 1, None),
            (160, due, highest),
            // Nominal, as it is.
            (159, due, None),
        ] {
            assert_eq!(decided(excursion, now), level, "{excursion} words at {now}");
        }
    }
}
