//! Times in order.

use std::fmt;

/// How times are distributed.
#[derive(Clone, Debug)]
pub struct Distribution {
    sorted_ns: Vec<u64>,
}

impl Distribution {
    /// Of these, ns.
    pub fn of(times_ns: impl IntoIterator<Item = u64>) -> Self {
        let mut sorted_ns: Vec<u64> = times_ns.into_iter().collect();
        sorted_ns.sort_unstable();
        Self { sorted_ns }
    }

    /// The least time that `share` of them do not exceed, µs.
    ///
    /// # Panics
    /// Without any.
    pub fn quantile_us(&self, share: f64) -> f64 {
        let rank = (share * self.sorted_ns.len() as f64).ceil() as usize;
        self.sorted_ns[rank.clamp(1, self.sorted_ns.len()) - 1] as f64 * 1e-3
    }

    /// The longest, µs.
    ///
    /// # Panics
    /// Without any.
    pub fn longest_us(&self) -> f64 {
        self.quantile_us(1.0)
    }
}

/// In columns under [`Distribution::HEADING`].
impl fmt::Display for Distribution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for share in [0.5, 0.9, 0.99, 0.999, 1.0] {
            write!(f, "{:>10.1}", self.quantile_us(share))?;
        }
        Ok(())
    }
}

impl Distribution {
    /// What stands above the columns.
    pub const HEADING: &'static str = "    median      90 %      99 %    99.9 %   longest";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_members_by_nearest_rank() {
        let times = Distribution::of((1..=1000).rev().map(|us| us * 1000));
        for (share, expected_us) in [(0.0, 1.0), (0.5, 500.0), (0.99, 990.0), (0.999, 999.0), (1.0, 1000.0)] {
            assert_eq!(times.quantile_us(share), expected_us, "{share}");
        }
        assert_eq!(Distribution::of([7]).to_string(), "       0.0".repeat(5));
    }
}
