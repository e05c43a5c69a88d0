//! How late poses come where each scan waits for those before it.

/// The longest time from a scan's arrival to its pose, seconds, if scans arrive every `period_s` and
/// cost `costs_s` each: one server, first come, first served.
pub fn most_lag_s(period_s: f64, costs_s: impl IntoIterator<Item = f64>) -> f64 {
    let (mut free_s, mut most_s) = (0.0_f64, 0.0_f64);
    for (scan, cost_s) in costs_s.into_iter().enumerate() {
        let arrival_s = scan as f64 * period_s;
        free_s = free_s.max(arrival_s) + cost_s;
        most_s = most_s.max(free_s - arrival_s);
    }
    most_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_grows_while_scans_cost_more_than_they_leave_time() {
        let most = |costs: &[f64]| most_lag_s(1.0, costs.iter().copied());
        assert_eq!(most(&[0.5, 0.25, 0.5]), 0.5);
        // Each of four scans adds half a period; then there is time to catch up.
        assert_eq!(most(&[1.5, 1.5, 1.5, 1.5, 0.25]), 3.0);
        assert_eq!(most(&[3.0, 0.25, 0.25, 0.25, 0.5]), 3.0);
    }
}
