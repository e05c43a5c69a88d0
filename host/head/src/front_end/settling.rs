//! Response of a first-order front end to light that is switched on and off.
//!
//! Light of one cell is on in its slot and off for the rest of the frame, frame after frame. The
//! output then follows, with a = exp(−T_on/τ) and b = exp(−T_off/τ),
//!
//! * lit, x after switching on: I·(1 − A·exp(−x/τ)), A = (1 − b)/(1 − ab);
//! * dark, x after switching off: I·A'·exp(−x/τ), A' = (1 − a)/(1 − ab),
//!
//! for any τ from far below to far above the frame. So the gain of a lit-minus-dark sample and the mean
//! age of its light are known.

use slitpose_protocol::Schedule;

/// Gain and delay of one cell's lit-minus-dark sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// Sample over photocurrent: 1 for an ideal front end, near zero for one slower than the frame, and
    /// negative if the output is higher at the dark sample than at the lit one.
    pub gain: f64,
    /// Mean age of the light in a lit sample, seconds.
    pub delay_s: f64,
}

impl Settling {
    /// Gain and delay of `cell` in `schedule`, for a front end of `time_constant_s`.
    ///
    /// `None` if the schedule does not light the cell.
    pub fn of_cell(schedule: &Schedule, cell: usize, time_constant_s: f64) -> Option<Self> {
        let slot = schedule.lit_slot(cell)?;
        if time_constant_s <= 0.0 {
            return Some(Self { gain: 1.0, delay_s: 0.0 });
        }
        let tick_s = f64::from(schedule.tick_hz).recip();
        // In units of the time constant.
        let in_tau = |ticks: f64| ticks * tick_s / time_constant_s;
        let on = in_tau(f64::from(schedule.slot_ticks));
        let frame = in_tau(f64::from(schedule.frame_ticks));
        let first = |slot| schedule.first_sample_ticks(slot, cell).map(|ticks| ticks as f64);
        let samples = |after_ticks: f64| {
            (0..schedule.oversampling)
                .map(move |j| in_tau(after_ticks + f64::from(j) * f64::from(schedule.conversion_ticks)))
        };
        let count = f64::from(schedule.oversampling);

        // 1 − exp(−x) without cancellation.
        let rise = |x: f64| -(-x).exp_m1();
        let lit_ticks = first(slot)? - slot as f64 * f64::from(schedule.slot_ticks);
        let off_share = rise(frame - on) / rise(frame);
        let lit: f64 = samples(lit_ticks).map(|x| 1.0 - off_share * (-x).exp()).sum::<f64>() / count;
        let dark: f64 = match schedule.dark_slot().and_then(first) {
            Some(dark_ticks) => {
                let switched_off = (slot as f64 + 1.0) * f64::from(schedule.slot_ticks);
                let frame_ticks = f64::from(schedule.frame_ticks);
                let since = (dark_ticks - switched_off).rem_euclid(frame_ticks);
                let on_share = rise(on) / rise(frame);
                samples(since).map(|x| on_share * (-x).exp()).sum::<f64>() / count
            }
            None => 0.0,
        };
        // Light that left s before the sample counts with exp(−s/τ)/τ, 0 ≤ s ≤ x: on average
        // τ·(1 − x/(exp(x) − 1)).
        let delay = samples(lit_ticks).map(|x| 1.0 - x / x.exp_m1()).sum::<f64>() / count;
        Some(Self { gain: lit - dark, delay_s: if delay.is_finite() { delay * time_constant_s } else { 0.0 } })
    }
}

#[cfg(test)]
mod tests {
    use slitpose_firmware::pcb::default_configuration;

    use super::*;

    /// Integrates the front end in steps of half a tick, period after period, until it repeats.
    fn brute_force(schedule: &Schedule, cell: usize, time_constant_s: f64) -> f64 {
        let ticks = |ticks: f64| (2.0 * ticks).round() as u64;
        let decay = (-0.5 / f64::from(schedule.tick_hz) / time_constant_s).exp();
        let slot = schedule.lit_slot(cell).unwrap() as u64;
        let on = slot * 2 * u64::from(schedule.slot_ticks)..(slot + 1) * 2 * u64::from(schedule.slot_ticks);
        let instants = |slot: usize| {
            let first = schedule.first_sample_ticks(slot, cell).unwrap() as f64;
            (0..schedule.oversampling)
                .map(|j| ticks(first + f64::from(j) * f64::from(schedule.conversion_ticks)))
                .collect::<Vec<_>>()
        };
        let (lit, dark) = (instants(slot as usize), instants(schedule.dark_slot().unwrap()));
        let (mut y, mut before) = (0.0, f64::NAN);
        loop {
            let mut sum = 0.0;
            for step in 0..2 * u64::from(schedule.frame_ticks) {
                if lit.contains(&step) {
                    sum += y;
                }
                if dark.contains(&step) {
                    sum -= y;
                }
                let light = if on.contains(&step) { 1.0 } else { 0.0 };
                y = light + (y - light) * decay;
            }
            let gain = sum / f64::from(schedule.oversampling);
            if (gain - before).abs() < 1e-13 {
                return gain;
            }
            before = gain;
        }
    }

    #[test]
    fn gain_equals_step_by_step_integration() {
        let schedule = default_configuration().schedule;
        for time_constant_s in [1e-7, 1.36e-6, 2e-5, 2e-4] {
            for cell in [0, 4, 5] {
                let gain = Settling::of_cell(&schedule, cell, time_constant_s).unwrap().gain;
                let expected = brute_force(&schedule, cell, time_constant_s);
                assert!((gain - expected).abs() < 1e-10, "{time_constant_s} {cell}: {gain} {expected}");
            }
        }
    }

    #[test]
    fn any_time_constant_gives_numbers() {
        let schedule = default_configuration().schedule;
        for exponent in -12..=3 {
            let settling = Settling::of_cell(&schedule, 0, 10_f64.powi(exponent)).unwrap();
            assert!(settling.gain.abs() <= 1.0, "1e{exponent}: {settling:?}");
            assert!((0.0..1e-4).contains(&settling.delay_s), "1e{exponent}: {settling:?}");
        }
        let ideal = Settling::of_cell(&schedule, 0, 0.0).unwrap();
        assert_eq!(ideal, Settling { gain: 1.0, delay_s: 0.0 });
    }

    /// The age of light at a sample, weighted by what is left of it, summed in steps of a thousandth of
    /// the exposure.
    #[test]
    fn delay_equals_step_by_step_integration() {
        let mut schedule = default_configuration().schedule;
        schedule.oversampling = 1;
        for time_constant_s in [2e-6, 2e-5, 2e-4] {
            let exposure_s = f64::from(schedule.settling_ticks) / f64::from(schedule.tick_hz);
            let ages = (0..1000).map(|step| (f64::from(step) + 0.5) * 1e-3 * exposure_s);
            let (sum, weight) = ages.fold((0.0, 0.0), |(sum, weight), age_s| {
                let left = (-age_s / time_constant_s).exp();
                (sum + age_s * left, weight + left)
            });
            let delay_s = Settling::of_cell(&schedule, 0, time_constant_s).unwrap().delay_s;
            assert!((delay_s / (sum / weight) - 1.0).abs() < 1e-5, "{time_constant_s}: {delay_s} {}", sum / weight);
        }
    }
}
