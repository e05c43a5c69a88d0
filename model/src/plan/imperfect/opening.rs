//! What light may pass through in place of a slit on the base: a slit that rides with the emitter, a pinhole, a lens.
//!
//! The equations of De La Cruz et al. 2018 are for a slit on the base. Here both tiers integrate over the solid angle
//! of the spot.
//!
//! Through a round hole parallel to the detector, at the height h and with its centre at c, light of an emitter at e
//! would land at X = q·k − e·(k − 1), k = e_z/(e_z − h), for each point q of the hole. A thin lens of focal length f in
//! the hole sends it on to the image of the emitter, at the distance b behind the lens, 1/b = 1/f − 1/(e_z − h): it
//! lands where X lies after all distances from the landing of the ray through c have shrunk by ρ = 1 − h/(f·k). So the
//! lens changes neither the solid angle nor where the chief ray lands. (A pinhole has ρ = 1, a lens in focus 0.)

use glam::{DMat3, DVec3};

use crate::effects::Opening as Kind;
use crate::exact::{self, Orders, Rules, Turn};
use crate::polygon::{EmitterGradient, MAX_CORNERS, Motion, Polygon};
use crate::pose::{Transform, rotation_exp};
use crate::profile::Emission;
use crate::response::{Integration, Status};
use crate::scalar::{Linear3, Number, Vector3};
use crate::scene::Cell;

use super::super::optics::{Light, Place, Receiver, Seen, Source};

/// Corners of the polygon that stands for a circle of the same area. The second moment of its area, through which the
/// hole's size moves the light, is 0.1 % more than the circle's.
const CIRCLE_CORNERS: usize = 10;

#[derive(Clone, Debug)]
pub enum Opening<S: Number> {
    Riding(RidingSlit<S>),
    Round(Hole<S>),
}

/// A slit on the tool, tool frame.
#[derive(Clone, Debug)]
pub struct RidingSlit<S: Number> {
    faces: [[S::Vec3; 4]; 2],
    face_count: usize,
    centre: S::Vec3,
    /// Normal of the mask, away from the detector, and half its thickness.
    normal: S::Vec3,
    half_thickness: S,
}

/// A round hole, cell frame.
#[derive(Clone, Debug)]
pub struct Hole<S: Number> {
    around: [S::Vec3; CIRCLE_CORNERS],
    centre: S::Vec3,
    /// h/f; zero: no lens.
    power: S,
}

/// The spot, and how far light is bent on the way to it.
pub struct Spot<S: Number> {
    /// As it would be without a lens.
    polygon: Polygon<S>,
    pub status: Status,
    bent: Bent<S>,
}

/// ρ and the landing of the chief ray, with the derivatives by the emitter's position that are not zero.
#[derive(Clone, Copy)]
struct Bent<S> {
    shrunk: S,
    shrunk_by_z: S,
    chief: [S; 2],
    /// 1 − k, of the chief ray by the emitter's coordinate along it.
    chief_by: S,
    chief_by_z: [S; 2],
}

impl<S: Number> Opening<S> {
    /// `None` for a slit on the base.
    pub fn compile(cell: &Cell, kind: Kind) -> Option<Self> {
        let slit = &cell.slit;
        let centre = DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m);
        let hole = |power: f64| {
            let step = core::f64::consts::TAU / CIRCLE_CORNERS as f64;
            // Of a polygon with the area of the circle.
            let radius = 0.5 * slit.width_m * libm::sqrt(step / libm::sin(step));
            // Corners opposite each other along x are so to the last bit, and their coordinates y alike: the fewer
            // slabs has the spot.
            let corner = |i: usize| {
                let half = CIRCLE_CORNERS / 2;
                let (up, i) = if i <= half { (1.0, i) } else { (-1.0, CIRCLE_CORNERS - i) };
                let (right, i) = if 2 * i <= half { (1.0, i) } else { (-1.0, half - i) };
                let angle = i as f64 * step;
                S::Vec3::of(centre + DVec3::new(right * libm::cos(angle), up * libm::sin(angle), 0.0) * radius)
            };
            Self::Round(Hole { around: core::array::from_fn(corner), centre: S::Vec3::of(centre), power: S::of(power) })
        };
        Some(match kind {
            Kind::Slit => return None,
            Kind::RidingSlit => Self::Riding(RidingSlit::compile(cell, centre)),
            Kind::Pinhole => hole(0.0),
            Kind::Lens { focal_length_m } => hole(slit.distance_m / focal_length_m),
        })
    }

    pub fn hole_centre(&self) -> Option<S::Vec3> {
        match self {
            Self::Riding(_) => None,
            Self::Round(hole) => Some(hole.centre),
        }
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
            Self::Riding(slit) => slit.spot(receiver, source, seen, pose),
            Self::Round(hole) => hole.spot(receiver, seen),
        }
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
        let face = |height: f64| {
            [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(i, j)| {
                S::Vec3::of(
                    centre
                        + axes.z_axis * height
                        + axes.x_axis * (i * slit.width_m)
                        + axes.y_axis * (j * slit.length_m),
                )
            })
        };
        let half_thickness = 0.5 * slit.thickness_m;
        Self {
            faces: [-half_thickness, half_thickness].map(face),
            face_count: if half_thickness > 0.0 { 2 } else { 1 },
            centre: S::Vec3::of(centre),
            normal: S::Vec3::of(axes.z_axis * axes.z_axis.dot(detector.normal_base).signum()),
            half_thickness: S::of(half_thickness),
        }
    }

    fn spot(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        pose: &Transform<S>,
    ) -> Result<Spot<S>, Status> {
        // Differences are taken in the tool frame, where nothing moves and nothing cancels.
        let from_emitter = |place: S::Vec3| receiver.to_cell(pose.rotate(place - source.position));
        let is_behind = (source.position - self.centre).dot(self.normal) <= self.half_thickness;
        let height = seen.position.z();
        if is_behind || height <= S::zero() || height + from_emitter(self.centre).z() <= S::zero() {
            return Err(Status::Behind);
        }
        let faces = self.faces.map(|face| face.map(from_emitter));
        let (polygon, status) = Polygon::of_riding(&faces[..self.face_count], seen.position, receiver.half)?;
        Ok(Spot { polygon, status, bent: Bent::not() })
    }
}

impl<S: Number> Hole<S> {
    fn spot(&self, receiver: &Receiver<S>, seen: &Seen<S>) -> Result<Spot<S>, Status> {
        let e = seen.position;
        if e.z() <= self.centre.z() {
            return Err(Status::Behind);
        }
        let bent = Bent::of(self, e);
        let around = self.around.map(|corner| corner - e);
        // Both ends of the detector, then both of its long sides.
        let sides = [(0, -S::one()), (0, S::one()), (1, -S::one()), (1, S::one())]
            .map(|(axis, sign)| bent.side(axis, sign, e, receiver.half[axis]));
        let (polygon, status) = Polygon::of_hole(&around, e.z(), sides)?;
        Ok(Spot { polygon, status, bent })
    }
}

impl<S: Number> Bent<S> {
    /// Of light that goes straight on.
    fn not() -> Self {
        let zero = S::zero();
        Self { shrunk: S::one(), shrunk_by_z: zero, chief: [zero; 2], chief_by: zero, chief_by_z: [zero; 2] }
    }

    fn of(hole: &Hole<S>, e: S::Vec3) -> Self {
        let (one, height) = (S::one(), hole.centre.z());
        let per_rise = (e.z() - height).recip();
        let magnification = e.z() * per_rise;
        let away = [hole.centre.x() - e.x(), hole.centre.y() - e.y()];
        let magnification_by_z = -height * per_rise * per_rise;
        Self {
            shrunk: one - hole.power / magnification,
            shrunk_by_z: -hole.power * height / (e.z() * e.z()),
            chief: [e.x() + away[0] * magnification, e.y() + away[1] * magnification],
            chief_by: one - magnification,
            chief_by_z: away.map(|away| away * magnification_by_z),
        }
    }

    /// The side `sign`·p ≤ `half` of the detector along `axis`, in coordinates from the emitter's foot without a lens.
    fn side(&self, axis: usize, sign: S, e: S::Vec3, half: S) -> ([S; 2], S, Motion<S>) {
        let (zero, one) = (S::zero(), S::one());
        let foot = [e.x(), e.y()][axis];
        // The light lands at ρ·p + (1 − ρ)·chief.
        let (pull, chief) = (one - self.shrunk, self.chief[axis]);
        let at_foot = self.shrunk * foot + pull * chief;
        let mut normal = [zero; 2];
        normal[axis] = -sign * self.shrunk;
        let across = -sign * pull * self.chief_by;
        let from_chief = (sign * half - chief) / self.shrunk;
        let along = -sign * (pull * self.chief_by_z[axis] + self.shrunk_by_z * from_chief);
        let by_position = if axis == 0 { S::Vec3::new(across, zero, along) } else { S::Vec3::new(zero, across, along) };
        (normal, half - sign * at_foot, Motion::Refracted { by_position, is_end: axis == 0 })
    }

    /// Where light lands on the detector whose landing without a lens is `straight`.
    fn land(&self, axis: usize, straight: S) -> S {
        self.shrunk * straight + (S::one() - self.shrunk) * self.chief[axis]
    }

    /// [`Self::land`] along x, with its derivatives.
    fn landing(&self, straight: &EmitterGradient<S>) -> EmitterGradient<S> {
        let pull = S::one() - self.shrunk;
        let chief = S::Vec3::new(self.chief_by, S::zero(), self.chief_by_z[0]);
        let closing = S::Vec3::new(S::zero(), S::zero(), self.shrunk_by_z * (straight.value - self.chief[0]));
        EmitterGradient {
            value: self.land(0, straight.value),
            by_position: straight.by_position * self.shrunk + chief * pull + closing,
            by_axis: straight.by_axis * self.shrunk,
        }
    }
}

/// Light, and its derivatives by a turn of what rides with the emitter.
type Turned<S> = (Light<S>, Turn<S>);

impl<S: Number> Spot<S> {
    /// The light of the spot, and how it changes with a turn of what rides with the emitter.
    pub fn light<E: Emission<S>, const GRADIENT: bool>(
        &self,
        seen: &Seen<S>,
        emission: &E,
        orders: &Orders<S>,
        rules: &Rules<S>,
    ) -> (Option<Turned<S>>, Integration<S>) {
        let polygon = self.polygon.clone();
        let (light, integration) = exact::light_and_turn::<S, E, GRADIENT>(polygon, seen.axis, emission, orders, rules);
        let light = light.map(|((power, centroid), [power_turn, x_turn])| {
            let straight = EmitterGradient { value: seen.position.x() + centroid.value, ..centroid };
            let x_a = Place::Weighted(self.bent.landing(&straight));
            (Light { power, x_a }, [power_turn, x_turn * self.bent.shrunk])
        });
        (light, integration)
    }

    /// From the emitter to the middle of the spot without a lens.
    pub fn middle(&self) -> S::Vec3 {
        let [x, y] = self.polygon.centroid();
        S::Vec3::new(x, y, -self.polygon.height())
    }

    pub fn solid_angle(&self) -> S {
        self.polygon.solid_angle()
    }

    pub fn outline(&self, seen: &Seen<S>) -> heapless::Vec<[S; 2], MAX_CORNERS> {
        let foot = [seen.position.x(), seen.position.y()];
        let on_detector = |corner: &[S; 2]| [0, 1].map(|axis| self.bent.land(axis, foot[axis] + corner[axis]));
        self.polygon.corners().iter().map(on_detector).collect()
    }
}
