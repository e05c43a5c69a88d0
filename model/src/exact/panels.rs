//! Panels of a spot. Where no rule can be chosen beforehand, the panel with the largest estimated error
//! is halved until the sum of the errors is within the tolerance or the limit of work is reached.

use heapless::Vec;

use crate::polygon::MAX_CORNERS;
use crate::profile::{Emission, Falloff, Series};
use crate::scalar::{Linear3, Number};

use super::Integration;
use super::integrand::{Integrand, Slab, Sums, of_slab};
use super::order::{ESTIMATED, HORIZON_NODES, MAX_NODES, Nodes};

/// Most panels of a spot. Ordinary spots have one per slab; a lobe much narrower than its spot takes
/// tens; a table of nine points over a spot of 150° at a tolerance of 1e-10 takes about a hundred.
const MAX_PANELS: usize = 256;

/// Most evaluations of the profile for the currents of one cell: every division measures two new panels.
pub const MAX_EVALUATIONS: usize = 2 * MAX_PANELS * ESTIMATED * ESTIMATED;

/// Share of the tolerance for the sum of the estimated errors.
const SHARE: f64 = 0.5;

/// Part of a slab: a range of shares from its left to its right side, and a range of t.
#[derive(Clone, Copy)]
struct Panel<S> {
    slab: usize,
    share: [S; 2],
    t: [S; 2],
}

/// Divisions of all slabs along s and t to try before adaptive division: a table often has a polynomial
/// for half a spot or a quarter of one.
const DIVISIONS: [[usize; 2]; 4] = [[1, 1], [2, 1], [1, 2], [2, 2]];

struct Rule<'a, S> {
    along_s: Nodes<'a, S>,
    along_t: Vec<(S, S), MAX_ALONG_T>,
    is_from_horizon: bool,
    series: Option<Series<S>>,
}

/// Most nodes along t: those of two rules from the horizon.
const MAX_ALONG_T: usize = 2 * HORIZON_NODES;

/// A panel counts as all light between the horizon and its upper end, less that below its lower end, where u·d at the lower
/// end is at most this share of u·d at the upper one: of ordinary emitters a fifth is subtracted then, and little cancels.
const BESIDE_HORIZON: f64 = 0.5;

impl<S: Number> Rule<'_, S> {
    fn evaluations(&self) -> usize {
        self.along_s.len() * self.along_t.len()
    }
}

struct Measured<S> {
    panel: Panel<S>,
    /// Whether it is dark, or too wide to sample its profile.
    is_left_out: bool,
    power: S,
    moment: S,
    /// Estimated error of the power; for a panel that is not sampled, a bound on its power.
    error: S,
    /// Whether the sign of the error is random.
    is_rough: bool,
    /// Whether to halve the panel along t, not along s.
    across_t: bool,
    evaluations: usize,
}

pub fn add_all<S: Number, const GRADIENT: bool>(
    integrand: &Integrand<'_, S>,
    slabs: &Vec<Slab<S>, MAX_CORNERS>,
) -> (Sums<S>, Integration<S>) {
    let tolerance = integrand.orders.tolerance();
    let is_narrow = integrand.orders.is_narrow();
    'divisions: for parts in
        if integrand.emission.needs_series() || is_narrow { &DIVISIONS[..] } else { &DIVISIONS[..1] }
    {
        let (mut sums, mut evaluations) = (Sums::default(), 0);
        for panel in (0..slabs.len()).flat_map(|slab| integrand.lit(whole(slabs, slab), slabs).parts(*parts)) {
            let slab = &slabs[panel.slab];
            let Some(rule) = integrand.rule(slab, &panel) else { continue 'divisions };
            evaluations += rule.evaluations();
            integrand.add_panel::<GRADIENT>(slab, &panel, &rule, &mut sums);
        }
        if is_narrow && !integrand.may_leave_out(sums.power.value) {
            break;
        }
        return (sums, Integration { evaluations, relative_error: tolerance });
    }
    divide::<S, GRADIENT>(integrand, slabs)
}

fn whole<S: Number>(slabs: &[Slab<S>], slab: usize) -> Panel<S> {
    Panel { slab, share: [S::zero(), S::one()], t: slabs[slab].t }
}

/// Sums over all slabs where no rule is known beforehand to suffice: the panel with the largest error is
/// halved until the sum of the errors is small. Not inlined: its panels take kilobytes of stack.
#[inline(never)]
fn divide<S: Number, const GRADIENT: bool>(
    integrand: &Integrand<'_, S>,
    slabs: &Vec<Slab<S>, MAX_CORNERS>,
) -> (Sums<S>, Integration<S>) {
    let tolerance = integrand.orders.tolerance();
    let mut sums = Sums::default();
    let mut panels: Vec<Measured<S>, MAX_PANELS> = Vec::new();
    for (i, slab) in slabs.iter().enumerate() {
        // At most one slab per corner.
        let _ = panels.push(integrand.measure(slab, whole(slabs, i)));
    }
    let mut evaluations: usize = panels.iter().map(|panel| panel.evaluations).sum();
    let allowed = (S::of(SHARE) * tolerance).max(integrand.orders.rounding());
    let (mut total, mut error);
    loop {
        (total, error) = (S::zero(), S::zero());
        let mut rough = S::zero();
        let (mut worst, mut largest) = (0, S::zero());
        for (i, panel) in panels.iter().enumerate() {
            total += panel.power;
            if panel.is_rough {
                rough += panel.error * panel.error;
            } else {
                error += panel.error;
            }
            if panel.error > largest {
                (worst, largest) = (i, panel.error);
            }
        }
        // Two standard deviations of the sum of errors with random signs.
        error += S::two() * rough.root();
        if error <= allowed * total || largest == S::zero() || panels.len() == MAX_PANELS {
            break;
        }
        for (half, panel) in panels[worst].halves().enumerate() {
            let measured = integrand.measure(&slabs[panel.slab], panel);
            evaluations += measured.evaluations;
            if half == 0 {
                panels[worst] = measured;
            } else {
                // Below the capacity, as just checked.
                let _ = panels.push(measured);
            }
        }
    }
    if GRADIENT {
        for measured in panels.iter().filter(|measured| !measured.is_left_out) {
            let slab = &slabs[measured.panel.slab];
            let rule = integrand.rule(slab, &measured.panel).unwrap_or_else(|| integrand.sampling());
            integrand.add_panel::<true>(slab, &measured.panel, &rule, &mut sums);
        }
    }
    // The values are the same with and without derivatives.
    sums.power.value = total;
    sums.moment.value = panels.iter().fold(S::zero(), |sum, panel| sum + panel.moment);
    let relative_error = if error <= allowed * total {
        tolerance
    } else if total > S::zero() {
        error / total
    } else {
        S::infinity()
    };
    (sums, Integration { evaluations, relative_error })
}

impl<S: Number> Panel<S> {
    /// Divides the panel into equal parts along s and along t.
    fn parts(self, [along_s, along_t]: [usize; 2]) -> impl Iterator<Item = Self> + use<S> {
        let part = |[a, b]: [S; 2], i: usize, of: usize| {
            let at = |i: usize| a + (b - a) * (S::of(i as f64) / S::of(of as f64));
            [at(i), at(i + 1)]
        };
        (0..along_s * along_t).map(move |i| Self {
            share: part(self.share, i % along_s, along_s),
            t: part(self.t, i / along_s, along_t),
            ..self
        })
    }
}

impl<S: Number> Measured<S> {
    fn halves(&self) -> impl Iterator<Item = Panel<S>> + use<S> {
        self.panel.parts(if self.across_t { [1, 2] } else { [2, 1] })
    }
}

impl<S: Number> Integrand<'_, S> {
    /// Rays to the corners of a panel, in order around it.
    fn corners(&self, slab: &Slab<S>, panel: &Panel<S>) -> [S::Vec3; 4] {
        let ([c0, c1], [t0, t1]) = (panel.share, panel.t);
        [[c0, t0], [c1, t0], [c1, t1], [c0, t1]].map(|[share, t]| self.ray(slab.s(share, t), t))
    }

    /// The part of a whole slab that a narrow lobe lights.
    fn lit(&self, panel: Panel<S>, slabs: &[Slab<S>]) -> Panel<S> {
        let Some(cone) = &self.cone else {
            return panel;
        };
        let slab = &slabs[panel.slab];
        let [[left0, right0], [left1, right1]] = panel.t.map(|t| slab.sides(t));
        let [s, t] = cone.within([[left0.min(left1), right0.max(right1)], panel.t]);
        // As shares of the widths at both ends of the range of t.
        let share = |s: S, end: fn(S, S) -> S| {
            let [one, other] = t.map(|t| {
                let [left, right] = slab.sides(t);
                if right > left { (s - left) / (right - left) } else { S::half() }
            });
            end(one, other).max(S::zero()).min(S::one())
        };
        let share = [share(s[0], S::min), share(s[1], S::max)];
        if share[0] < share[1] { Panel { share, t, ..panel } } else { panel }
    }

    /// Whether the light that [`Self::lit`] leaves out is negligible beside `power`.
    fn may_leave_out(&self, power: S) -> bool {
        self.cone.as_ref().is_none_or(|cone| {
            self.orders.may_leave_out(cone.cosine, self.emission.relative(cone.cosine * self.unit), power)
        })
    }

    /// The rule that suffices for a panel, if it can be foreseen.
    fn rule(&self, slab: &Slab<S>, panel: &Panel<S>) -> Option<Rule<'_, S>> {
        self.plain_rule(slab, panel).or_else(|| self.rule_beside_horizon(slab, panel))
    }

    /// The same without what lies beside the panel.
    fn plain_rule(&self, slab: &Slab<S>, panel: &Panel<S>) -> Option<Rule<'_, S>> {
        let ([c0, c1], [t0, t1]) = (panel.share, panel.t);
        let corners = self.corners(slab, panel);
        let [f00, f10, f11, f01] = corners.map(|ray| self.axis.dot(ray).max(S::zero()));
        let horizon = |a: S, b: S| if a == b { S::infinity() } else { (a + b) / (a - b).abs() };
        let reach = |[s0, t0]: [S; 2], [s1, t1]: [S; 2]| {
            let length = S::norm(s1 - s0, t1 - t0);
            let rays = self.ray(s0, t0).length() + self.ray(s1, t1).length();
            if length > S::zero() { rays / length } else { S::infinity() }
        };
        let clamp = |value: S, range: [S; 2]| range[0].max(range[1].min(value));

        // Lines along s and along t at the panel's ends and nearest to the emitter's foot.
        let t_near = clamp(S::zero(), panel.t);
        let reach_s = [t0, t1, t_near]
            .map(|t| reach([slab.s(c0, t), t], [slab.s(c1, t), t]))
            .into_iter()
            .fold(S::infinity(), S::min);
        let share_near = {
            let [left, right] = slab.sides(S::half() * (t0 + t1));
            clamp(-left / (right - left), panel.share)
        };
        let reach_t = [c0, c1, share_near]
            .map(|share| reach([slab.s(share, t0), t0], [slab.s(share, t1), t1]))
            .into_iter()
            .fold(S::infinity(), S::min);
        let horizon_s = if self.across_horizon { S::infinity() } else { horizon(f00, f10).min(horizon(f01, f11)) };
        let from_horizon =
            if self.across_horizon { self.horizon_rule([f00.max(f10), f01.max(f11)], reach_t) } else { None };
        let horizon_t = if from_horizon.is_some() { S::infinity() } else { horizon(f00, f01).min(horizon(f10, f11)) };
        let [by_s, by_t] = self.differences(corners);
        let along = [(reach_s, horizon_s, by_s), (reach_t, horizon_t, by_t)];
        let (nodes, series) = self.foreseen(corners, along.into_iter())?;
        let (along_s, along_t) = of_slab(&nodes);
        let is_from_horizon = from_horizon.is_some();
        Some(Rule {
            along_s: self.rules.get(along_s),
            is_from_horizon,
            along_t: from_horizon.unwrap_or_else(|| self.rules.get(along_t)).collect(),
            series,
        })
    }

    /// The rule for a panel near the horizon: that of the panel with all that lies between it and the horizon, less that
    /// of the latter, both from the horizon on.
    fn rule_beside_horizon(&self, slab: &Slab<S>, panel: &Panel<S>) -> Option<Rule<'_, S>> {
        let [t0, t1] = panel.t;
        let [low, high] = panel.t.map(|t| self.axis.dot(self.ray(slab.s(S::half(), t), t)));
        if !self.across_horizon || low <= S::zero() || low > S::of(BESIDE_HORIZON) * high {
            return None;
        }
        let horizon = t0 - low * (t1 - t0) / (high - low);
        let whole = self.plain_rule(slab, &Panel { t: [horizon, t1], ..*panel });
        let mut rule = whole.filter(|rule| rule.is_from_horizon)?;
        // Where the panel's own range is −1…1.
        let of_panel = |end: S, sign: S| {
            let share = (end - horizon) / (t1 - t0);
            move |&(xi, weight): &(S, S)| {
                (share * (xi - S::one()) + S::two() * (end - t1) / (t1 - t0) + S::one(), sign * share * weight)
            }
        };
        let [with, without] = [of_panel(t1, S::one()), of_panel(t0, -S::one())];
        rule.along_t = rule.along_t.iter().map(with).chain(rule.along_t.iter().map(without)).collect();
        Some(rule)
    }

    fn sampling(&self) -> Rule<'_, S> {
        let (along_s, along_t) = (self.rules.get(ESTIMATED), self.rules.get(ESTIMATED));
        Rule { along_s, along_t: along_t.collect(), is_from_horizon: false, series: None }
    }

    /// Integrates over a panel and estimates the error, or bounds its power if it is too wide for that.
    fn measure(&self, slab: &Slab<S>, panel: Panel<S>) -> Measured<S> {
        let half = S::half();
        let ([c0, c1], [t0, t1]) = (panel.share, panel.t);
        let corners = self.corners(slab, &panel);
        let cosines = self.cosines(corners);
        let (t, share) = (half * (t0 + t1), half * (c0 + c1));
        let [left, right] = slab.sides(t);
        let (length_s, length_t) = ((right - left) * (c1 - c0), t1 - t0);
        let mut measured = Measured {
            panel,
            is_left_out: true,
            power: S::zero(),
            moment: S::zero(),
            error: S::zero(),
            is_rough: false,
            across_t: self.is_wider_along_t(corners, [length_s, length_t]),
            evaluations: 0,
        };
        if cosines.upper <= S::zero() {
            return measured;
        }
        let greatest = self.emission.greatest(cosines.lower, cosines.upper);
        if greatest == S::zero() {
            return measured;
        }
        if let Some(rule) = self.rule(slab, &panel) {
            let mut sums = Sums::default();
            self.add_panel::<false>(slab, &panel, &rule, &mut sums);
            measured.is_left_out = false;
            measured.evaluations = rule.evaluations();
            (measured.power, measured.moment) = (sums.power.value, sums.moment.value);
        } else if self.emission.is_resolved(cosines.lower, cosines.upper) {
            self.sample(slab, &mut measured, self.emission.is_smooth(cosines.lower, cosines.upper));
        } else {
            let centre = self.ray(slab.s(share, t), t);
            let radius = corners.into_iter().fold(S::zero(), |radius, ray| radius.max((ray - centre).length()));
            let nearest = self.height.max(centre.length() - radius);
            measured.error = greatest * length_s * length_t * self.height / (nearest * nearest * nearest);
        }
        measured
    }

    /// Greatest difference of cos γ between the ends of the sides along s, and along t.
    fn differences(&self, corners: [S::Vec3; 4]) -> [S; 2] {
        let cosines = corners.map(|ray| self.axis.dot(ray) / ray.length());
        [[0, 1, 3, 2], [0, 3, 1, 2]]
            .map(|[a, b, c, d]: [usize; 4]| (cosines[a] - cosines[b]).abs().max((cosines[c] - cosines[d]).abs()))
    }

    /// Whether to divide a panel of these lengths along t: where it is longer along t, or, next to the horizon, where γ
    /// changes more along t. cos γ changes by tan γ·δ + δ²/2 along a side that subtends δ.
    fn is_wider_along_t(&self, corners: [S::Vec3; 4], lengths: [S; 2]) -> bool {
        if !self.across_horizon {
            return lengths[1] > lengths[0];
        }
        let [by_s, by_t] = self.differences(corners);
        let [bend_s, bend_t] = lengths.map(|length| S::half() * length * length / corners[0].dot(corners[0]));
        by_t + bend_t > by_s + bend_s
    }

    /// Integrates by the rule with [`ESTIMATED`] nodes, and estimates its error from the sums along each direction.
    fn sample(&self, slab: &Slab<S>, measured: &mut Measured<S>, is_smooth: bool) {
        let half = S::half();
        let Panel { share: [c0, c1], t: [t0, t1], .. } = measured.panel;
        let (half_t, half_share) = (half * (t1 - t0), half * (c1 - c0));
        let (mut along_s, mut along_t) = ([S::zero(); ESTIMATED], [S::zero(); ESTIMATED]);
        for (j, (eta, weight_t)) in self.rules.get(ESTIMATED).enumerate() {
            let t = half * (t0 + t1) + half_t * eta;
            let [left, right] = slab.sides(t);
            let scale = half_t * half_share * (right - left);
            for (i, (xi, weight_s)) in self.rules.get(ESTIMATED).enumerate() {
                let ray = self.ray(left + (right - left) * (half * (c0 + c1) + half_share * xi), t);
                let g = scale * self.density(self.emission, ray);
                along_s[i] += weight_t * g;
                along_t[j] += weight_s * g;
                measured.power += weight_t * weight_s * g;
                measured.moment += weight_t * weight_s * g * (ray.x() - self.reference);
            }
        }
        let [by_s, by_t] = [along_s, along_t].map(|sums| self.rules.estimate(&sums, self.orders.rounding(), is_smooth));
        measured.is_left_out = false;
        measured.evaluations = ESTIMATED * ESTIMATED;
        measured.error = by_s + by_t;
        measured.is_rough = !is_smooth;
        measured.across_t = by_t > by_s;
    }

    fn add_panel<const GRADIENT: bool>(
        &self,
        slab: &Slab<S>,
        panel: &Panel<S>,
        rule: &Rule<'_, S>,
        sums: &mut Sums<S>,
    ) {
        match &rule.series {
            Some(series) => self.add_nodes::<_, GRADIENT>(series, slab, panel, rule, sums),
            None => self.add_nodes::<_, GRADIENT>(self.emission, slab, panel, rule, sums),
        }
    }

    fn add_nodes<F: Falloff<S>, const GRADIENT: bool>(
        &self,
        falloff: &F,
        slab: &Slab<S>,
        panel: &Panel<S>,
        rule: &Rule<'_, S>,
        sums: &mut Sums<S>,
    ) {
        let half = S::half();
        let [t0, t1] = panel.t;
        let half_t = half * (t1 - t0);
        let half_share = half * (panel.share[1] - panel.share[0]);
        let middle_share = half * (panel.share[0] + panel.share[1]);
        for &(eta, weight_t) in &rule.along_t {
            let t = half * (t0 + t1) + half_t * eta;
            let [left, right] = slab.sides(t);
            let scale = weight_t * half_t * half_share * (right - left);
            for (xi, weight_s) in rule.along_s.clone() {
                let s = left + (right - left) * (middle_share + half_share * xi);
                self.add_point::<F, GRADIENT>(falloff, self.ray(s, t), weight_s * scale, sums);
            }
        }
    }
}

const _: () = assert!(ESTIMATED <= MAX_NODES && MAX_NODES <= MAX_ALONG_T && MAX_PANELS >= 2 * MAX_CORNERS);
