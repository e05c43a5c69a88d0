//! What light may pass through in place of a slit on the base: a slit that rides with the emitter, a pinhole, a lens.
//!
//! The equations of De La Cruz et al. 2018 are for a slit on the base. Here both tiers integrate over the solid angle
//! of the spot.
//!
//! Through a round hole parallel to the detector, at the height h and with its centre at c, light of an emitter at e
//! would land at X = q·k − e·(k − 1), k = e_z/(e_z − h), for each point q of the hole. A thin lens of focal length f in
//! the hole sends it on to the image of the emitter, at the distance b behind the lens, 1/b = 1/f − 1/(e_z − h): it
//! lands where X lies after all distances from the landing of the ray through c have shrunk by ρ = 1 − h/(f·k). So the
//! lens changes neither the solid angle nor where the chief ray lands, and light through q lands at σ·(q − c) from
//! there, σ = ρ·k = k − h/f. (A pinhole has σ = k, a lens in focus 0.) Light is integrated over the hole.
//!
//! Mostly nothing cuts the spot: all light of a hole falls on the detector, and a slit's long sides cross it from edge to
//! edge. One rule integrates that ([`exact::disc_light`], [`exact::strip_light`]). Other spots are polygons.

use glam::{DMat3, DVec3};

use crate::aperture::slit_edges;
use crate::effects::Opening as Kind;
use crate::exact::{self, Disc, LightAndTurn, Method, Strip};
use crate::polygon::{EmitterGradient, Line, MAX_CORNERS, Motion, Polygon};
use crate::pose::{Transform, rotation_exp};
use crate::response::{Integration, Status};
use crate::scalar::{Linear3, Number, Vector3};
use crate::scene::Cell;

use super::super::optics::{Light, Place, Receiver, Seen, Source};
use super::passage::{Passed, Way};

#[derive(Clone, Debug)]
pub enum Opening<S: Number> {
    Riding(RidingSlit<S>),
    Round(Hole<S>),
}

/// A slit on the tool, tool frame.
#[derive(Clone, Debug)]
pub struct RidingSlit<S: Number> {
    /// See [`slit_edges`].
    edges: [[[S::Vec3; 2]; 4]; 2],
    face_count: usize,
    centre: S::Vec3,
    /// Normal of the mask, away from the detector, and half its thickness.
    normal: S::Vec3,
    half_thickness: S,
    /// Where the light lands with the tool at home: it moves with that point of the tool.
    pub landing: S::Vec3,
}

/// Normals of the planes through the emitter and the edges of a riding slit, cell frame.
type Planes<S> = [[<S as crate::scalar::Real>::Vec3; 4]; 2];

/// A round hole, cell frame.
#[derive(Clone, Debug)]
pub struct Hole<S: Number> {
    disc: Disc<S>,
    centre: S::Vec3,
    /// h/f; zero: no lens.
    power: S,
}

/// A spot that is a polygon.
pub struct Spot<S: Number> {
    pub polygon: Polygon<S>,
    status: Status,
    /// Of a hole the polygon is in its plane.
    onward: Onward<S>,
}

/// σ and the landing of the chief ray, with the derivatives by the emitter's position that are not zero.
#[derive(Clone, Copy)]
struct Onward<S> {
    /// From the emitter's foot to the hole's middle.
    away: [S; 2],
    magnified: S,
    magnified_by_z: S,
    chief: [S; 2],
    /// 1 − k, of the chief ray by the emitter's coordinate along it.
    chief_by: S,
}

impl<S: Number> Opening<S> {
    /// `None` for a slit on the base.
    pub fn compile(cell: &Cell, kind: Kind) -> Option<Self> {
        let slit = &cell.slit;
        let centre = DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m);
        let hole = |power: f64| {
            Self::Round(Hole { disc: Disc::new(slit.width_m), centre: S::Vec3::of(centre), power: S::of(power) })
        };
        Some(match kind {
            Kind::Slit => return None,
            Kind::RidingSlit => Self::Riding(RidingSlit::compile(cell, centre)),
            Kind::Pinhole => hole(0.0),
            Kind::Lens { focal_length_m } => hole(slit.distance_m / focal_length_m),
        })
    }

    /// The spot of an emitter `seen` with the tool at `pose`.
    pub fn spot(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        pose: &Transform<S>,
    ) -> Result<Spot<S>, Status> {
        match self {
            Self::Riding(slit) => slit.spot(&slit.planes(receiver, source, seen, pose)?, receiver, seen),
            Self::Round(hole) => hole.spot(hole.onward(seen)?, receiver, seen),
        }
    }

    /// The light of an emitter `seen` with the tool at `pose`.
    pub fn pass<const GRADIENT: bool>(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        pose: &Transform<S>,
        method: &Method<'_, S>,
    ) -> Result<Passed<S>, Status> {
        let (axis, mut slack_m) = (seen.axis, S::zero());
        let spot = match self {
            Self::Riding(slit) => {
                let planes = slit.planes(receiver, source, seen, pose)?;
                if let Some((strip, apart_m)) = slit.strip(&planes, receiver, seen) {
                    slack_m = apart_m;
                    if let Some((light, integration)) = exact::strip_light::<S, GRADIENT>(&strip, axis, method) {
                        return Ok(self.landed(
                            (Some(light), integration),
                            Onward::straight(seen),
                            seen,
                            (Status::Lit, slack_m),
                        ));
                    }
                }
                slit.spot(&planes, receiver, seen)?
            }
            Self::Round(hole) => {
                let onward = hole.onward(seen)?;
                let (to_middle, magnified) = (hole.centre - seen.position, onward.magnified.abs());
                slack_m = onward.slack_m(hole.disc.corners[0].x(), receiver.half).max(S::zero());
                if slack_m > S::zero()
                    && let Some((light, integration)) =
                        exact::disc_light::<S, GRADIENT>(&hole.disc, to_middle, magnified, axis, method)
                {
                    return Ok(self.landed((Some(light), integration), onward, seen, (Status::Lit, slack_m)));
                }
                hole.spot(onward, receiver, seen)?
            }
        };
        let light = exact::polygon_light::<S, GRADIENT>(spot.polygon, axis, method);
        Ok(self.landed(light, spot.onward, seen, (spot.status, slack_m)))
    }

    /// Light where it lands on the detector, from what is `found` in the plane over which it is integrated.
    fn landed(
        &self,
        (light, integration): (Option<LightAndTurn<S>>, Integration<S>),
        onward: Onward<S>,
        seen: &Seen<S>,
        (status, slack_m): (Status, S),
    ) -> Passed<S> {
        let to_hole = match self {
            Self::Riding(_) => None,
            Self::Round(hole) => Some(hole.centre - seen.position),
        };
        let (light, turn) = light.unzip();
        let light = light.map(|(power, centroid)| Light { power, x_a: Place::Weighted(onward.landing(&centroid)) });
        let way = Way { turn, raise: (S::zero(), S::Vec3::default()), to_hole };
        Passed { light, way, integration: Some(integration), status, slack_m }
    }
}

impl<S: Number> RidingSlit<S> {
    fn compile(cell: &Cell, centre: DVec3) -> Self {
        let (slit, detector) = (&cell.slit, &cell.detector);
        let [x_axis, z_axis] = [detector.x_axis_base, detector.normal_base].map(DVec3::normalize);
        let base_from_cell = DMat3::from_cols(x_axis, z_axis.cross(x_axis), z_axis);
        let axes = base_from_cell * DMat3::from_quat(rotation_exp(slit.tilt_rad));
        // At home the frames of tool and base are one.
        let centre = detector.centre_base_m + base_from_cell * centre;
        let normal = axes.z_axis * axes.z_axis.dot(detector.normal_base).signum();
        let half_thickness = 0.5 * slit.thickness_m;
        let emitter = cell.emitter.position_tool_m;
        let height = |place: DVec3| (place - detector.centre_base_m).dot(z_axis);
        let magnification = (height(emitter) / (height(emitter) - height(centre))).max(1.0);
        Self {
            edges: slit_edges::<S>(slit, centre, normal, axes),
            face_count: if half_thickness > 0.0 { 2 } else { 1 },
            centre: S::Vec3::of(centre),
            normal: S::Vec3::of(normal),
            half_thickness: S::of(half_thickness),
            landing: S::Vec3::of(emitter + (centre - emitter) * magnification),
        }
    }

    fn planes(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        pose: &Transform<S>,
    ) -> Result<Planes<S>, Status> {
        // Differences are taken in the tool frame, where nothing moves and nothing cancels.
        let in_cell = |vector: S::Vec3| receiver.to_cell(pose.rotate(vector));
        let is_behind = (source.position - self.centre).dot(self.normal) <= self.half_thickness;
        let height = seen.position.z();
        if is_behind || height <= S::zero() || height + in_cell(self.centre - source.position).z() <= S::zero() {
            return Err(Status::Behind);
        }
        let mut planes = Planes::<S>::default();
        for (plane, [place, direction]) in self.edges[..self.face_count].as_flattened().iter().enumerate() {
            planes[plane / 4][plane % 4] = in_cell((*place - source.position).cross(*direction));
        }
        Ok(planes)
    }

    /// The spot if the same two long edges bound it across the whole width of the detector, and nothing else does, and how
    /// far it may move till then.
    fn strip(&self, planes: &Planes<S>, receiver: &Receiver<S>, seen: &Seen<S>) -> Option<(Strip<S>, S)> {
        let ([half_x, half_y], e) = (receiver.half, seen.position);
        let planes = &planes[..self.face_count];
        let long = if planes[0][1].x() > S::zero() { [1, 3] } else { [3, 1] };
        let is_bounding = |face: &[S::Vec3; 4]| face[long[0]].x() > S::zero() && face[long[1]].x() < S::zero();
        if !planes.iter().all(is_bounding) {
            return None;
        }
        let of_face = |face: &[S::Vec3; 4]| Strip {
            sides: long.map(|edge| face[edge] * face[edge].x().abs().recip()),
            y: [-half_y - e.y(), half_y - e.y()],
            height: e.z(),
        };
        let (mut strip, mut slack) = (of_face(&planes[0]), S::infinity());
        for other in planes[1..].iter().map(of_face) {
            let apart = strip.y.map(|y| (strip.x(y), other.x(y)));
            for (k, sign) in [(0, S::one()), (1, -S::one())] {
                let [first, last] = apart.map(|(own, others)| sign * (others[k] - own[k]));
                if first * last <= S::zero() {
                    return None;
                }
                slack = slack.min(first.abs()).min(last.abs());
                if first > S::zero() {
                    strip.sides[k] = other.sides[k];
                }
            }
        }
        for y in strip.y {
            let [low, high] = strip.x(y);
            slack = slack.min(high - low).min(half_x + e.x() + low).min(half_x - e.x() - high);
            for normal in planes.iter().flat_map(|face| [face[0], face[2]]) {
                let from_end = |x: S| normal.dot(S::Vec3::new(x, y, -strip.height));
                slack = slack.min(from_end(low).min(from_end(high)) / S::norm(normal.x(), normal.y()));
            }
        }
        (slack > S::zero()).then_some((strip, slack))
    }

    fn spot(&self, planes: &Planes<S>, receiver: &Receiver<S>, seen: &Seen<S>) -> Result<Spot<S>, Status> {
        let planes = planes[..self.face_count].as_flattened();
        let (polygon, status) = Polygon::of_riding(planes, seen.position, receiver.half)?;
        Ok(Spot { polygon, status, onward: Onward::straight(seen) })
    }
}

impl<S: Number> Hole<S> {
    fn onward(&self, seen: &Seen<S>) -> Result<Onward<S>, Status> {
        let (e, one, height) = (seen.position, S::one(), self.centre.z());
        if e.z() <= height {
            return Err(Status::Behind);
        }
        let per_rise = (e.z() - height).recip();
        let magnification = e.z() * per_rise;
        let away = [self.centre.x() - e.x(), self.centre.y() - e.y()];
        let magnified_by_z = -height * per_rise * per_rise;
        Ok(Onward {
            away,
            magnified: magnification - self.power,
            magnified_by_z,
            chief: [e.x() + away[0] * magnification, e.y() + away[1] * magnification],
            chief_by: one - magnification,
        })
    }

    fn spot(&self, onward: Onward<S>, receiver: &Receiver<S>, seen: &Seen<S>) -> Result<Spot<S>, Status> {
        let [x, y] = onward.away;
        let corners = self.disc.corners.iter().map(|corner| [x + corner.x(), y + corner.y()]);
        // Both ends of the detector, then both of its long sides.
        let sides = [(0, -S::one()), (0, S::one()), (1, -S::one()), (1, S::one())]
            .map(|(axis, sign)| onward.side(axis, sign, receiver.half[axis]));
        let (polygon, status) = Polygon::of_hole(corners, seen.position.z() - self.centre.z(), sides)?;
        Ok(Spot { polygon, status, onward })
    }
}

impl<S: Number> Onward<S> {
    /// Of light that is integrated where it lands.
    fn straight(seen: &Seen<S>) -> Self {
        let (zero, chief) = (S::zero(), [seen.position.x(), seen.position.y()]);
        Self { away: [zero; 2], magnified: S::one(), magnified_by_z: zero, chief, chief_by: zero }
    }

    /// How far the spot of a hole of this `radius` is from the nearest side of the detector.
    fn slack_m(&self, radius: S, half: [S; 2]) -> S {
        let reach = self.magnified.abs() * radius;
        (half[0] - self.chief[0].abs()).min(half[1] - self.chief[1].abs()) - reach
    }

    /// The side `sign`·p ≤ `half` of the detector along `axis`, in coordinates of the hole from the emitter's foot.
    fn side(&self, axis: usize, sign: S, half: S) -> Line<S> {
        let mut normal = [S::zero(); 2];
        normal[axis] = -sign * self.magnified;
        let offset = half - sign * (self.chief[axis] - self.magnified * self.away[axis]);
        // By e_z, σ and k change alike.
        let from_foot = (sign * half - self.chief[axis]) / self.magnified + self.away[axis];
        let (across, along) = (-sign * self.chief_by, -sign * self.magnified_by_z * from_foot);
        let zero = S::zero();
        let by_position = if axis == 0 { S::Vec3::new(across, zero, along) } else { S::Vec3::new(zero, across, along) };
        Line { normal, offset, motion: Motion::Moved { by_position, is_end: axis == 0 } }
    }

    /// Where light lands on the detector that passes the hole here, from the emitter's foot.
    fn land(&self, axis: usize, at: S) -> S {
        self.chief[axis] + self.magnified * (at - self.away[axis])
    }

    /// [`Self::land`] along x, with its derivatives.
    fn landing(&self, at: &EmitterGradient<S>) -> EmitterGradient<S> {
        let along = S::Vec3::new(self.chief_by, S::zero(), self.magnified_by_z * at.value);
        EmitterGradient {
            value: self.land(0, at.value),
            by_position: at.by_position * self.magnified + along,
            by_axis: at.by_axis * self.magnified,
        }
    }
}

impl<S: Number> Spot<S> {
    /// From the emitter to the middle of the spot, without a lens.
    pub fn middle(&self) -> S::Vec3 {
        let [x, y] = self.polygon.centroid();
        S::Vec3::new(x, y, -self.polygon.height())
    }

    pub fn outline(&self) -> heapless::Vec<[S; 2], MAX_CORNERS> {
        let on_detector = |corner: &[S; 2]| [0, 1].map(|axis| self.onward.land(axis, corner[axis]));
        self.polygon.corners().iter().map(on_detector).collect()
    }
}
