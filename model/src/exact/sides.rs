//! The light that the sides of a spot sweep over when the emitter moves: line integrals.

use heapless::Vec;

use crate::polygon::{Line, Motion};
use crate::profile::{Emission, Falloff};
use crate::scalar::{Linear3, Number};

use super::integrand::{Integrand, Sums};
use super::order::{ESTIMATED, MAX_NODES};

/// Most pieces waiting: bisection keeps at most one per level.
const MAX_WAITING: usize = 64;

const MAX_PIECES: usize = 64;

/// Share of the allowed error below which a piece is left out.
const NEGLIGIBLE: f64 = 0.01;

/// Adds the light that the side from `a` to `b` sweeps over. `power`: power of the whole spot.
pub fn add<S: Number>(
    integrand: &Integrand<'_, S>,
    line: &Line<S>,
    a: [S; 2],
    b: [S; 2],
    power: S,
    sums: &mut Sums<S>,
) {
    let at_horizon = integrand.emission.at_horizon();
    let is_dark = matches!(line.motion, Motion::Horizon { .. }) && at_horizon == S::zero();
    if is_dark || line.motion.is_still() {
        return;
    }
    let side = Side { integrand, line, a, b, at_horizon };
    let allowed = integrand.orders.tolerance() * power / integrand.size;
    let mut waiting: Vec<[S; 2], MAX_WAITING> = Vec::new();
    let _ = waiting.push([S::zero(), S::one()]);
    let mut pieces = 1;
    while let Some([low, high]) = waiting.pop() {
        let room = pieces < MAX_PIECES && waiting.len() + 2 <= MAX_WAITING;
        if !side.add_piece([low, high], allowed, !room, sums) {
            let middle = S::half() * (low + high);
            let _ = (waiting.push([low, middle]), waiting.push([middle, high]));
            pieces += 1;
        }
    }
}

/// I_rel at c; zero behind the horizon.
fn in_front<S: Number, F: Falloff<S>>(falloff: &F, c: S) -> S {
    if c > S::zero() { falloff.relative(c) } else { S::zero() }
}

struct Side<'a, 'b, S: Number> {
    integrand: &'a Integrand<'b, S>,
    line: &'a Line<S>,
    a: [S; 2],
    b: [S; 2],
    at_horizon: S,
}

impl<S: Number> Side<'_, '_, S> {
    fn at(&self, share: S) -> S::Vec3 {
        let ([ax, ay], [bx, by]) = (self.a, self.b);
        S::Vec3::new(ax + share * (bx - ax), ay + share * (by - ay), -self.integrand.height)
    }

    /// Adds a piece of the side, given as a range of shares; `false` if it must be divided and `must` is not set.
    fn add_piece(&self, [low, high]: [S; 2], allowed: S, must: bool, sums: &mut Sums<S>) -> bool {
        let integrand = self.integrand;
        let (p, q) = (self.at(low), self.at(high));
        let [fp, fq] = [p, q].map(|ray| integrand.axis.dot(ray).max(S::zero()));
        let length = (q - p).length();
        let reach = (p.length() + q.length()) / length;
        let horizon = if fp == fq { S::infinity() } else { (fp + fq) / (fp - fq).abs() };
        if matches!(self.line.motion, Motion::Horizon { .. }) {
            let nodes = integrand.orders.nodes(reach, S::infinity()).or(must.then_some(MAX_NODES));
            if let Some(nodes) = nodes {
                self.add_nodes([low, high], integrand.rules.get(nodes), sums, |_| self.at_horizon);
            }
            return nodes.is_some();
        }
        for (ends, sign) in [([fp, fq], S::one()), ([fq, fp], -S::one())] {
            if let Some(rule) = integrand.horizon_rule(ends, reach) {
                let rule = rule.map(|(xi, weight)| (sign * xi, weight));
                self.add_nodes([low, high], rule, sums, |c| in_front(integrand.emission, c));
                return true;
            }
        }
        if let Some((nodes, series)) =
            integrand.foreseen([p, q], core::iter::once((reach, horizon, fp / p.length() - fq / q.length())))
        {
            let rule = integrand.rules.get(nodes[0]);
            match series {
                Some(series) => self.add_nodes([low, high], rule, sums, |c| in_front(&series, c)),
                None => self.add_nodes([low, high], rule, sums, |c| in_front(integrand.emission, c)),
            }
            return true;
        }
        let cosines = integrand.cosines([p, q]);
        let height = integrand.height;
        let greatest = integrand.emission.greatest(cosines.lower, cosines.upper.max(S::zero()));
        if cosines.upper <= S::zero() || greatest * length <= S::of(NEGLIGIBLE) * allowed * height * height {
            return true;
        }
        if !must {
            if !integrand.emission.is_resolved(cosines.lower, cosines.upper) {
                return false;
            }
            let mut values = [S::zero(); ESTIMATED];
            for (value, (xi, _)) in values.iter_mut().zip(integrand.rules.get(ESTIMATED)) {
                *value = integrand.density(integrand.emission, self.at(S::half() * (low + high + (high - low) * xi)));
            }
            let estimate = integrand.rules.estimate(
                &values,
                integrand.orders.rounding(),
                integrand.emission.is_smooth(cosines.lower, cosines.upper),
            );
            if S::half() * length * estimate > allowed {
                return false;
            }
        }
        self.add_nodes([low, high], integrand.rules.get(ESTIMATED), sums, |c| in_front(integrand.emission, c));
        true
    }

    fn add_nodes(
        &self,
        [low, high]: [S; 2],
        rule: impl Iterator<Item = (S, S)>,
        sums: &mut Sums<S>,
        relative: impl Fn(S) -> S,
    ) {
        let integrand = self.integrand;
        let half_length = S::half() * (self.at(high) - self.at(low)).length();
        for (xi, weight) in rule {
            let ray = self.at(S::half() * (low + high) + S::half() * (high - low) * xi);
            let inverse = ray.length().recip();
            let c = integrand.axis.dot(ray) * inverse;
            let g =
                weight * half_length * relative(c * integrand.unit) * integrand.height * inverse * inverse * inverse;
            let [by_position, by_axis, by_turn] = self.line.speeds(ray);
            sums.sweep(ray.x() - integrand.reference, by_position * g, by_axis * g, by_turn * g);
        }
    }
}
