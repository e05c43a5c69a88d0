//! Bounds on the rate of a board's clock.

use slitpose_protocol::ClockSource;

/// Bounds on the rate of a board's clock relative to the host's. The rate is host seconds per board second, minus one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RateBounds {
    /// Greatest rate, either way.
    pub(super) most_rate: f64,
    /// Greatest change of the rate per second.
    pub(super) most_wander_per_s: f64,
}

impl RateBounds {
    /// The MCU's internal oscillator. Rate: HSI16 of the STM32G474 has 1 % at 30 °C and another 1 % from 0 to 85 °C
    /// (DS12288, table of HSI16 characteristics), with a margin of 0.5 %. Wander: those 2 % in 85 K, on a board that
    /// warms by 0.1 K per second, are 24 ppm per second.
    const OSCILLATOR: Self = Self { most_rate: 0.025, most_wander_per_s: 25e-6 };

    /// A crystal on the board.
    ///
    /// Rate: ±50 ppm of the board's crystal (20 at 25 °C, 30 over temperature and ageing), ±100 ppm of the host's clock
    /// (50 of its own crystal, 50 of NTP's correction), and a margin of 50 ppm.
    ///
    /// Wander: the rate of an AT-cut crystal changes by at most 1 ppm/K, at the ends of its temperature range. At 0.1 K
    /// per second, as above, that is 0.1 ppm per second, the same again for the host's crystal, and a margin of 0.05.
    ///
    /// NTP may correct a host's clock faster for some minutes after its start (ntpd by up to 500 ppm). The fit falls
    /// back to [`Self::OSCILLATOR`] when its points contradict these bounds.
    const CRYSTAL: Self = Self { most_rate: 200e-6, most_wander_per_s: 0.25e-6 };

    /// The bounds for a clock source; the widest if it is unknown.
    pub(super) fn of(source: Option<ClockSource>) -> Self {
        match source {
            Some(ClockSource::Crystal) => Self::CRYSTAL,
            Some(ClockSource::Internal | ClockSource::CrystalFailed) | None => Self::OSCILLATOR,
        }
    }

    /// Greatest distance of the curve from a straight line at `dx_ns` from the point where they touch.
    pub(super) fn bend_ns(&self, dx_ns: f64) -> f64 {
        0.5e-9 * self.most_wander_per_s * dx_ns * dx_ns
    }
}
