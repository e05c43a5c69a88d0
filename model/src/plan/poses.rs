//! Cells at several poses, a pose per lane, with the bits that each cell has alone at each pose.
//!
//! Where one formula does not serve all poses, currents of the others are NaN.

use crate::lanes::{MAX_LANES, PerLane, set};
use crate::pose::{Pose, Transform};
use crate::power::{Power, SharedPower};
use crate::rectangle::Visibility;
use crate::response::{Pair, Status};
use crate::scalar::{Linear3, Real};
use crate::scene::MAX_CELLS;
use crate::width::{Instructions, Lanes, Task, Width};
use crate::{exact, paper};

use super::optics::{Light, Seen, of_sides};
use super::pack::{Masks, Numbers, Pack};
use super::{CellTerms, CompiledCell, CompiledEmitter, CompiledScene, CurrentsJacobian};

/// A cell's currents at the pose of each lane.
pub struct Currents<R> {
    /// Photocurrents without dark current, amperes; zero without a spot.
    pub pair: [R; 2],
    /// One where there is a spot, else zero.
    pub lit: R,
    visibility: Visibility<R>,
}

/// A cell's currents and derivatives at the pose of each lane.
pub struct Terms<R> {
    pub currents: Currents<R>,
    pub jacobian: [[R; 6]; 2],
    /// See [`CellTerms`](super::CellTerms).
    pub slack_m: R,
}

impl CompiledScene<f64> {
    /// Whether its cells can be evaluated at several poses at once.
    pub(crate) fn has_lanes(&self) -> bool {
        let has_lanes = |cell: &CompiledCell<f64>| {
            let emitter = &cell.emitter;
            let has_formula =
                if self.is_paper { emitter.has_power_in_lanes() } else { emitter.is_integrated_in_lanes() };
            has_formula && Masks::of(core::slice::from_ref(cell)).is_some()
        };
        self.cells.iter().all(has_lanes)
    }

    /// Passes the indices of pose and cell, and what [`Self::linearise`] gives there, to `sink`: for each of `poses` in
    /// order, each cell in order. Bit for bit, but faster: as many poses at once as `width` has lanes, if all cells are of
    /// a kind that has them.
    pub fn linearise_many(
        &self,
        poses: &[Pose],
        width: Width,
        mut sink: impl FnMut(usize, usize, (Status, Pair<f64>, CurrentsJacobian<f64>)),
    ) {
        let has_lanes = self.has_lanes();
        let mut found = [const { InLanes::NOTHING }; MAX_CELLS];
        for (group, poses) in poses.chunks(width.lanes()).enumerate() {
            if has_lanes {
                self.linearise_group(poses, width, &mut found);
            }
            for (lane, pose) in poses.iter().enumerate() {
                for cell in 0..self.cell_count() {
                    let at_once = if has_lanes { found[cell].terms(lane) } else { None };
                    let terms = match at_once {
                        Some(CellTerms { status, pair: [i_x1_a, i_x2_a], jacobian, .. }) => {
                            (status, Pair { i_x1_a, i_x2_a }, jacobian)
                        }
                        None => self.linearise(cell, pose),
                    };
                    sink(group * width.lanes() + lane, cell, terms);
                }
            }
        }
    }

    /// All cells at no more `poses` than `width` has lanes.
    fn linearise_group(&self, poses: &[Pose], width: Width, found: &mut [InLanes; MAX_CELLS]) {
        width.run(Linearise { plan: self, poses, found });
    }

    /// Whether it is of the exact tier.
    pub(crate) fn is_exact(&self) -> bool {
        !self.is_paper
    }

    /// Currents and derivatives of cell `cell`, which [has lanes](Self::has_lanes), at `pose`. `EXACT`: the plan is of the
    /// exact tier.
    #[inline(always)]
    pub(crate) fn linearise_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        cell: usize,
        pose: &Transform<R>,
    ) -> Option<Terms<R>> {
        let cell = &self.cells[cell];
        let pack = Pack::in_all_lanes(cell, pose.translation().x())?;
        self.terms_lanes::<R, EXACT>(&cell.emitter, &pack, &pack.receiver.see(&pack.source, pose))
    }

    /// Currents and derivatives of cells that are `seen`, with the profile of `emitter`.
    #[inline(always)]
    pub(crate) fn terms_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        emitter: &CompiledEmitter<f64>,
        cells: &Pack<R, ()>,
        seen: &Seen<R>,
    ) -> Option<Terms<R>> {
        let (light, visibility) = self.light_lanes::<R, EXACT, true>(emitter, cells, seen)?;
        let (pair, jacobian) = cells.receiver.linearise(&cells.source, &light, seen, !EXACT);
        Some(Terms { currents: Currents::of(pair, visibility), jacobian, slack_m: visibility.slacks_m() })
    }

    /// Currents of cell `cell`, which [has lanes](Self::has_lanes), at `pose`. `EXACT`: the plan is of the exact tier.
    #[inline(always)]
    pub(crate) fn currents_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        cell: usize,
        pose: &Transform<R>,
    ) -> Option<Currents<R>> {
        let cell = &self.cells[cell];
        let pack = Pack::in_all_lanes(cell, pose.translation().x())?;
        self.pairs_lanes::<R, EXACT>(&cell.emitter, &pack, &pack.receiver.see(&pack.source, pose))
    }

    /// Currents of cells that are `seen`, with the profile of `emitter`.
    #[inline(always)]
    pub(crate) fn pairs_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        emitter: &CompiledEmitter<f64>,
        cells: &Pack<R, ()>,
        seen: &Seen<R>,
    ) -> Option<Currents<R>> {
        let (light, visibility) = self.light_lanes::<R, EXACT, false>(emitter, cells, seen)?;
        let gain = cells.receiver.responsivity * cells.source.intensity;
        let pair = cells.receiver.divide(gain * light.power.value, light.x_a.value(), !EXACT);
        Some(Currents::of(pair, visibility))
    }

    /// The light of cells that are `seen`, with the profile of `emitter`.
    #[inline(always)]
    fn light_lanes<R: Real<Element = f64>, const EXACT: bool, const GRADIENT: bool>(
        &self,
        emitter: &CompiledEmitter<f64>,
        cells: &Pack<R, ()>,
        seen: &Seen<R>,
    ) -> Option<(Light<R>, Visibility<R>)> {
        let (spot, visibility) = cells.spot(seen);
        let CompiledEmitter { profile, orders, .. } = emitter;
        let light = if EXACT {
            let (orders, rules) = (orders.as_ref()?, self.rules.as_ref()?);
            exact::rectangle_light_lanes::<R, GRADIENT>(&spot, seen.axis, profile.as_cosine()?, orders, rules)
        } else {
            let emission = SharedPower::of(spot.height, profile.as_power()?);
            paper::rectangle_light::<R, _, GRADIENT>(&spot, seen.axis, &emission)
        };
        Some((of_sides::<R, GRADIENT>(&light, &spot, EXACT), visibility))
    }

    /// From the tool's origin to the emitter of cell `cell`, base frame, metres.
    #[inline(always)]
    pub(crate) fn arm_lanes<R: Real<Element = f64>>(&self, cell: usize, pose: &Transform<R>) -> R::Vec3 {
        pose.rotate(pose.translation().x().splat3(self.cells[cell].emitter.source.position))
    }
}

impl CompiledEmitter<f64> {
    /// Whether its intensity, in the paper tier, has a series that serves all lanes.
    fn has_power_in_lanes(&self) -> bool {
        self.profile.as_power().is_some_and(Power::has_series)
    }

    /// Whether light of it in several lanes is integrated by one rule.
    pub fn is_integrated_in_lanes(&self) -> bool {
        self.profile.as_cosine().is_some() && self.orders.as_ref().is_some_and(|orders| !orders.is_narrow())
    }
}

/// What is found in each lane: of one cell at several poses, or of several cells.
pub struct InLanes {
    statuses: [Status; MAX_LANES],
    /// NaN where it must be evaluated alone.
    pair: [PerLane; 2],
    jacobian: [[PerLane; 6]; 2],
    slack_m: PerLane,
}

impl InLanes {
    /// Nothing: all must be evaluated alone.
    pub const NOTHING: Self = Self {
        statuses: [Status::Lit; MAX_LANES],
        pair: [[f64::NAN; MAX_LANES]; 2],
        jacobian: [[[0.0; MAX_LANES]; 6]; 2],
        slack_m: [0.0; MAX_LANES],
    };

    #[inline(always)]
    pub fn set_currents<R: Real<Element = f64>>(&mut self, currents: &Currents<R>) {
        for lane in 0..R::LANES {
            self.statuses[lane] = currents.visibility.status(lane);
        }
        set(&mut self.pair[0], currents.pair[0]);
        set(&mut self.pair[1], currents.pair[1]);
    }

    #[inline(always)]
    pub fn set<R: Real<Element = f64>>(&mut self, terms: &Terms<R>) {
        self.set_currents(&terms.currents);
        set(&mut self.slack_m, terms.slack_m);
        for row in 0..2 {
            for axis in 0..6 {
                set(&mut self.jacobian[row][axis], terms.jacobian[row][axis]);
            }
        }
    }

    /// Photocurrents without dark current; `None` where they must be evaluated alone.
    pub fn pair(&self, lane: usize) -> Option<[f64; 2]> {
        let pair = self.pair.map(|current| current[lane]);
        (!(pair[0] + pair[1]).is_nan()).then_some(pair)
    }

    /// `None` where they must be evaluated alone.
    pub fn terms(&self, lane: usize) -> Option<CellTerms<f64>> {
        let status = self.statuses[lane];
        if !status.has_spot() {
            return Some(CellTerms::dark(status));
        }
        let jacobian = self.jacobian.map(|row| row.map(|value| value[lane]));
        let slack_m = self.slack_m[lane];
        self.pair(lane).map(|pair| CellTerms { pair, jacobian, slack_m, ..CellTerms::dark(status) })
    }
}

/// All cells of a plan that [has lanes](CompiledScene::has_lanes), at a pose per lane.
struct Linearise<'a> {
    plan: &'a CompiledScene<f64>,
    poses: &'a [Pose],
    found: &'a mut [InLanes; MAX_CELLS],
}

impl Linearise<'_> {
    #[inline(always)]
    fn all<R: Real<Element = f64>, const EXACT: bool>(self, like: R) {
        let last = self.poses.len() - 1;
        let of = |lane: usize| &self.poses[lane.min(last)];
        let rotation = [
            like.fill_with(|lane| of(lane).rotation.x),
            like.fill_with(|lane| of(lane).rotation.y),
            like.fill_with(|lane| of(lane).rotation.z),
            like.fill_with(|lane| of(lane).rotation.w),
        ];
        let translation = R::Vec3::new(
            like.fill_with(|lane| of(lane).translation_m.x),
            like.fill_with(|lane| of(lane).translation_m.y),
            like.fill_with(|lane| of(lane).translation_m.z),
        );
        let pose = Transform::of_parts(rotation, translation);
        for (cell, found) in self.found.iter_mut().enumerate().take(self.plan.cell_count()) {
            let Some(terms) = self.plan.linearise_lanes::<R, EXACT>(cell, &pose) else { return };
            found.set(&terms);
        }
    }
}

impl Task for Linearise<'_> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        let like = Lanes::zero(instructions);
        if self.plan.is_exact() { self.all::<_, true>(like) } else { self.all::<_, false>(like) }
    }
}

impl<R: Real> Currents<R> {
    #[inline(always)]
    fn of(pair: [R; 2], visibility: Visibility<R>) -> Self {
        let (zero, one) = (pair[0].constant(0.0), pair[0].constant(1.0));
        let [first, second] = pair;
        let pair = [visibility.where_spot(first, zero), visibility.where_spot(second, zero)];
        Self { pair, lit: visibility.where_spot(one, zero), visibility }
    }
}

/// Numbers of one cell in all lanes.
struct Shared<'a, R: Real> {
    like: R,
    cell: &'a CompiledCell<R::Element>,
}

impl<R: Real> Numbers<R> for Shared<'_, R> {
    #[inline(always)]
    fn next(&mut self, of: impl Fn(&CompiledCell<R::Element>) -> R::Element) -> R {
        self.like.splat(of(self.cell))
    }
}

impl<R: Real> Pack<R, ()> {
    /// `cell` without its profile in all lanes of `like`; `None` if it is of another kind.
    #[inline(always)]
    fn in_all_lanes(cell: &CompiledCell<R::Element>, like: R) -> Option<Self> {
        let masks = Masks::of(core::slice::from_ref(cell))?;
        Some(Self::of_numbers(&mut Shared { like, cell }, masks))
    }
}
