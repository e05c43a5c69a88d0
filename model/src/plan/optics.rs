//! Detector and emitter of a cell, and the currents that follow from the light: for one cell, or for
//! several in SIMD lanes.

use serde::{Deserialize, Serialize};

use crate::polygon::EmitterGradient;
use crate::pose::Transform;
use crate::rectangle::{Edge, Rectangle, RectangleLight, SideGradient};
use crate::scalar::{Linear3, Number, Real, array, zero_half_one};

/// The detector on the base, without its aperture.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "R: Number")]
pub struct Receiver<R: Real> {
    /// x, y, z axes of the cell frame in the base frame.
    pub axes: [R::Vec3; 3],
    pub centre: R::Vec3,
    pub half: [R; 2],
    /// 1/Lx.
    pub per_length: R,
    pub responsivity: R,
    pub dark: R,
}

/// The emitter on the tool, without its profile.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "R: Number")]
pub struct Source<R: Real> {
    pub position: R::Vec3,
    pub axis: R::Vec3,
    pub intensity: R,
}

pub struct Seen<R: Real> {
    /// Position and axis, cell frame.
    pub position: R::Vec3,
    pub axis: R::Vec3,
    /// From the tool's origin to the emitter, base frame.
    arm: R::Vec3,
    pub axis_base: R::Vec3,
}

/// The tool's motion around a reference instant, and each cell's exposure.
pub struct Instant<'a, S: Number> {
    /// Pose at the reference instant.
    pub(crate) pose: &'a Transform<S>,
    /// Linear and angular: m/s and rad/s.
    pub(crate) twist: [S::Vec3; 2],
    /// Half the change of the twist per second, m/s² and rad/s²; `None`: zero.
    pub(crate) bend: Option<[S::Vec3; 2]>,
    /// Exposure of each cell relative to the reference instant, seconds; empty: all zero.
    pub(crate) offsets_s: &'a [S],
}

impl<S: Number> Instant<'_, S> {
    /// Where the tool's origin is at the exposure of one cell, at a constant twist.
    #[inline(always)]
    pub(crate) fn translation_of(&self, cell: usize) -> S::Vec3 {
        let offset_s = self.offsets_s.get(cell).copied().unwrap_or_default();
        self.pose.translation() + self.twist[0] * offset_s
    }

    /// The pose at the exposure of one cell.
    pub(crate) fn pose_of(&self, cell: usize) -> Transform<S> {
        self.pose_in_lanes(S::zero(), cell)
    }

    /// The pose at the exposures of as many cells as `like` has lanes, from number `first` on.
    #[inline(always)]
    pub(crate) fn pose_in_lanes<R: Real<Element = S>>(&self, like: R, first: usize) -> Transform<R> {
        let pose = self.pose.in_all_lanes(like);
        let Some(last) = self.offsets_s.len().checked_sub(1) else { return pose };
        let offset_s = like.fill_with(|lane| self.offsets_s[(first + lane).min(last)]);
        let [shift, turn] = self.displacement(offset_s);
        pose.moved(shift, turn)
    }

    /// How far the tool moves and turns until `offset_s` seconds after the reference instant.
    #[inline(always)]
    pub(crate) fn displacement<R: Real<Element = S>>(&self, offset_s: R) -> [R::Vec3; 2] {
        let twist = self.twist.map(|rate| offset_s.splat3(rate));
        let mean = match &self.bend {
            Some(bend) => [0, 1].map(|i| twist[i] + offset_s.splat3(bend[i]) * offset_s),
            None => twist,
        };
        mean.map(|rate| rate * offset_s)
    }
}

/// Power per axial intensity (∫ I_rel dΩ, steradians) and X_A (metres, cell frame), with derivatives
/// with respect to the emitter's position and axis in the cell frame.
pub struct Light<R: Real> {
    pub power: EmitterGradient<R>,
    pub x_a: Place<R>,
}

/// X_A with its derivatives.
pub enum Place<R: Real> {
    /// The power-weighted centroid, which depends on the emitter's position and axis.
    Weighted(EmitterGradient<R>),
    /// The middle of a rectangle: value, and derivatives with respect to the emitter's x and z.
    Middle(R, [R; 2]),
}

impl<R: Real> Place<R> {
    #[inline(always)]
    pub fn value(&self) -> R {
        match self {
            Self::Weighted(gradient) => gradient.value,
            Self::Middle(value, _) => *value,
        }
    }
}

impl<R: Real> Receiver<R> {
    #[inline(always)]
    pub fn to_cell(&self, base: R::Vec3) -> R::Vec3 {
        R::Vec3::new(self.axes[0].dot(base), self.axes[1].dot(base), self.axes[2].dot(base))
    }

    #[inline(always)]
    pub fn to_base(&self, cell: R::Vec3) -> R::Vec3 {
        self.axes[0] * cell.x() + self.axes[1] * cell.y() + self.axes[2] * cell.z()
    }

    /// The emitter with the tool at `pose`.
    #[inline(always)]
    pub fn see(&self, source: &Source<R>, pose: &Transform<R>) -> Seen<R> {
        let (arm, axis) = (pose.rotate(source.position), pose.rotate(source.axis));
        self.seen(pose.translation() + arm, arm, axis)
    }

    /// The emitter after the tool was at `pose` and has shifted and turned a little.
    #[inline(always)]
    pub fn see_moved(&self, source: &Source<R>, pose: &Transform<R>, [shift, turn]: [R::Vec3; 2]) -> Seen<R> {
        let step = Transform::<R>::small_turn(turn);
        let (arm, axis) = (step(pose.rotate(source.position)), step(pose.rotate(source.axis)));
        self.seen(pose.translation() + shift + arm, arm, axis)
    }

    #[inline(always)]
    fn seen(&self, position: R::Vec3, arm: R::Vec3, axis: R::Vec3) -> Seen<R> {
        Seen { position: self.to_cell(position - self.centre), axis: self.to_cell(axis), arm, axis_base: axis }
    }

    /// `photocurrent` at `x_a` divided between the electrodes, without dark current: equation (1) of
    /// De La Cruz et al. 2018. With `divides_dark`, I_D is divided by position, too, as printed there.
    #[inline(always)]
    pub fn divide(&self, photocurrent: R, x_a: R, divides_dark: bool) -> [R; 2] {
        let half = photocurrent.constant(0.5) * photocurrent;
        let divided = if divides_dark { photocurrent + self.dark } else { photocurrent };
        let imbalance = divided * (x_a * self.per_length);
        [half - imbalance, half + imbalance]
    }

    /// [`Self::divide`] of `light`, with its derivatives with respect to a perturbation of the pose.
    #[inline(always)]
    pub fn linearise(
        &self,
        source: &Source<R>,
        light: &Light<R>,
        seen: &Seen<R>,
        divides_dark: bool,
    ) -> ([R; 2], [[R; 6]; 2]) {
        let gain = self.responsivity * source.intensity;
        let photocurrent = gain * light.power.value;
        let divided = if divides_dark { photocurrent + self.dark } else { photocurrent };
        let share = light.x_a.value() * self.per_length;
        let (half, imbalance) = (photocurrent.constant(0.5) * photocurrent, divided * share);

        // I_X1 + I_X2 = I and I_X1 = I/2 − (I + I_D')·X_A/Lx, with I_D' = I_D or 0.
        let total = self.of_pose(&light.power, seen);
        let position = match &light.x_a {
            Place::Weighted(gradient) => self.of_pose(gradient, seen),
            Place::Middle(_, [by_x, by_z]) => {
                let by_position = self.axes[0] * *by_x + self.axes[2] * *by_z;
                let turn = seen.arm.cross(by_position);
                [by_position.x(), by_position.y(), by_position.z(), turn.x(), turn.y(), turn.z()]
            }
        };
        let (of_power, of_position) = (gain * (share.constant(0.5) - share), divided * self.per_length);
        let first: [R; 6] = array(share, |i| total[i] * of_power - position[i] * of_position);
        let second = array(share, |i| total[i] * gain - first[i]);
        ([half - imbalance, half + imbalance], [first, second])
    }

    /// Converts derivatives with respect to the emitter's position to those with respect to the pose.
    #[inline(always)]
    pub fn of_position(&self, by_position: R::Vec3, seen: &Seen<R>) -> [R; 6] {
        let by_position = self.to_base(by_position);
        let turn = seen.arm.cross(by_position);
        [by_position.x(), by_position.y(), by_position.z(), turn.x(), turn.y(), turn.z()]
    }

    /// Converts derivatives with respect to the emitter to those with respect to the pose: a rotation δθ
    /// about the tool's origin moves the emitter by δθ × arm and its axis by δθ × axis.
    #[inline(always)]
    pub fn of_pose(&self, gradient: &EmitterGradient<R>, seen: &Seen<R>) -> [R; 6] {
        let by_position = self.to_base(gradient.by_position);
        let by_axis = self.to_base(gradient.by_axis);
        let turn = seen.arm.cross(by_position) + seen.axis_base.cross(by_axis);
        [by_position.x(), by_position.y(), by_position.z(), turn.x(), turn.y(), turn.z()]
    }
}

/// Converts derivatives with respect to the sides of a rectangle to those with respect to the emitter:
/// ∂X/∂e = −k, ∂X/∂e_z = −X·(k − 1)/e_z (see [`crate::rectangle::Edge`]). `weighted`: whether the
/// centroid is power-weighted, not the middle of the sides.
#[inline(always)]
pub fn of_sides<R: Real, const GRADIENT: bool>(
    light: &RectangleLight<R>,
    spot: &Rectangle<R>,
    weighted: bool,
) -> Light<R> {
    let [zero, half, one] = zero_half_one(spot.height);
    let x_a = spot.x.landing + light.centroid.value;
    if !GRADIENT {
        return Light { power: EmitterGradient::of_value(light.power.value), x_a: Place::Middle(x_a, [zero; 2]) };
    }
    let edges = [spot.x.low, spot.x.high, spot.y.low, spot.y.high];
    let per_height = spot.height.inverse();
    let rises: [R; 4] = array(zero, |i| edges[i].position * (edges[i].magnification - one) * per_height);
    Light {
        power: EmitterGradient {
            value: light.power.value,
            by_position: chain(&light.power, &edges, &rises),
            by_axis: light.power.by_axis,
        },
        x_a: if weighted {
            Place::Weighted(EmitterGradient {
                value: x_a,
                by_position: chain(&light.centroid, &edges, &rises) + R::Vec3::new(one, zero, zero),
                by_axis: light.centroid.by_axis,
            })
        } else {
            let along = one - half * (edges[0].magnification + edges[1].magnification);
            Place::Middle(x_a, [along, -(half * (rises[0] + rises[1]))])
        },
    }
}

/// Derivatives with respect to the emitter's position from those with respect to the sides, which are `edges` and move by
/// `rises` as the emitter rises.
#[inline(always)]
fn chain<R: Real>(side: &SideGradient<R>, edges: &[Edge<R>; 4], rises: &[R; 4]) -> R::Vec3 {
    let along: [R; 4] = array(side.value, |i| -(side.by_side[i] * edges[i].magnification));
    let rise: [R; 4] = array(side.value, |i| side.by_side[i] * rises[i]);
    let z = side.by_height - (rise[0] + rise[1] + rise[2] + rise[3]);
    R::Vec3::new(along[0] + along[1], along[2] + along[3], z)
}
