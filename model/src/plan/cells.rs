//! The exact tier for several cells at one pose, as many at once as the processor has lanes, if their emitters have one
//! profile: bit for bit what each cell gives alone. The paper tier is not here: there, four lanes are no faster for six cells
//! than three times the two of [`pack`](super::pack), for every lane looks up its power by itself.

use crate::lanes::MAX_LANES;
use crate::list::List;
use crate::pose::Transform;
use crate::response::Pair;
use crate::scalar::Real;
use crate::scene::MAX_CELLS;
use crate::width::{Instructions, Lanes, Task, Width};

use super::optics::Instant;
use super::pack::{Masks, Numbers, Pack};
use super::poses::InLanes;
use super::{CellTerms, CellsAtOnce, CompiledCell, CompiledScene, evaluate};

/// Most numbers of a cell: those of [`Pack::of_numbers`] with a thick mask.
const NUMBERS: usize = 38;

/// A number of each cell; the last one fills the remaining lanes.
type PerCell = [f64; MAX_CELLS];

const _: () = assert!(MAX_CELLS.is_multiple_of(MAX_LANES), "every group of cells fills all lanes");

/// The cells of a plan, number by number.
#[derive(Clone, Debug)]
pub struct WideCells {
    width: Width,
    masks: Masks,
    numbers: List<PerCell, NUMBERS>,
}

/// Numbers of one cell, to be stored as those of cell `cell`.
struct Stored<'a> {
    of: &'a CompiledCell<f64>,
    cell: usize,
    next: usize,
    numbers: &'a mut List<PerCell, NUMBERS>,
}

impl Numbers<f64> for Stored<'_> {
    #[inline(always)]
    fn next(&mut self, of: impl Fn(&CompiledCell<f64>) -> f64) -> f64 {
        if self.next == self.numbers.len() {
            // There are no more than it has space for: see `NUMBERS`.
            let _ = self.numbers.push([0.0; MAX_CELLS]);
        }
        let number = of(self.of);
        self.numbers[self.next][self.cell] = number;
        self.next += 1;
        number
    }
}

/// Numbers of as many cells as there are lanes, from number `first` on.
struct Loaded<'a, R> {
    like: R,
    first: usize,
    numbers: core::slice::Iter<'a, PerCell>,
}

impl<R: Real<Element = f64>> Numbers<R> for Loaded<'_, R> {
    #[inline(always)]
    fn next(&mut self, _: impl Fn(&CompiledCell<f64>) -> f64) -> R {
        match self.numbers.next() {
            Some(number) => {
                let number = &number[self.first..][..R::LANES];
                self.like.fill_with(|lane| number[lane])
            }
            None => self.like,
        }
    }
}

impl WideCells {
    /// `None` if the cells of `plan` are not of one kind. (Emitters of one exponent need the same rules: a plan has one
    /// tolerance.)
    pub(crate) fn with_width(plan: &CompiledScene<f64>, width: Width) -> Option<Self> {
        let masks = Masks::of(&plan.cells)?;
        let exponent = |cell: &CompiledCell<f64>| cell.emitter.profile.as_power().map(|power| power.exponent());
        let first = exponent(plan.cells.first()?)?;
        let has_lanes =
            |cell: &CompiledCell<f64>| exponent(cell) == Some(first) && cell.emitter.is_integrated_in_lanes();
        if !plan.cells.iter().all(has_lanes) {
            return None;
        }
        let mut numbers = List::new();
        for cell in 0..MAX_CELLS {
            let of = &plan.cells[cell.min(plan.cells.len() - 1)];
            Pack::of_numbers(&mut Stored { of, cell, next: 0, numbers: &mut numbers }, masks);
        }
        Some(Self { width, masks, numbers })
    }

    /// Passes what is found of each of the `wanted` cells to `sink`, in order: by `of_lane` where lanes serve, else by
    /// `alone`.
    #[inline(always)]
    fn each<const SLOPES: bool, T>(
        &self,
        (plan, instant): (&CompiledScene<f64>, &Instant<'_, f64>),
        wanted: impl Fn(usize) -> bool,
        of_lane: impl Fn(&InLanes, usize) -> Option<T>,
        alone: impl Fn(usize, &Transform<f64>) -> T,
        mut sink: impl FnMut(usize, T),
    ) {
        let (lanes, count) = (self.width.lanes(), plan.cell_count());
        let mut found = InLanes::NOTHING;
        for first in (0..count).step_by(lanes) {
            let wanted = || (first..count.min(first + lanes)).filter(|&cell| wanted(cell));
            let at_once = wanted().nth(1).is_some();
            if at_once {
                self.width.run(AtOnce::<SLOPES> { cells: self, plan, instant, first, found: &mut found });
            }
            for cell in wanted() {
                let of_lane = if at_once { of_lane(&found, cell - first) } else { None };
                sink(cell, of_lane.unwrap_or_else(|| alone(cell, &instant.pose_of(cell))));
            }
        }
    }
}

impl CellsAtOnce<f64> for WideCells {
    fn of(plan: &CompiledScene<f64>) -> Option<Self> {
        Self::with_width(plan, Width::widest())
    }

    fn linearise(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, &CellTerms<f64>),
    ) {
        let alone = |cell, pose: &_| evaluate::linearise(plan, cell, pose);
        self.each::<true, _>((plan, instant), wanted, InLanes::terms, alone, |cell, terms| sink(cell, &terms));
    }

    fn currents(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        sink: impl FnMut(usize, [f64; 2]),
    ) {
        let alone = |cell, pose: &_| {
            let Pair { i_x1_a, i_x2_a } = evaluate::photocurrents(plan, cell, pose);
            [i_x1_a, i_x2_a]
        };
        self.each::<false, _>((plan, instant), wanted, InLanes::pair, alone, sink);
    }
}

/// As many cells as there are lanes, from number `first` on; `SLOPES`: with derivatives.
struct AtOnce<'a, const SLOPES: bool> {
    cells: &'a WideCells,
    plan: &'a CompiledScene<f64>,
    instant: &'a Instant<'a, f64>,
    first: usize,
    found: &'a mut InLanes,
}

impl<const SLOPES: bool> AtOnce<'_, SLOPES> {
    #[inline(always)]
    fn all<R: Real<Element = f64>>(self, like: R) {
        let Self { cells, plan, instant, first, found } = self;
        let pack = Pack::of_numbers(&mut Loaded { like, first, numbers: cells.numbers.iter() }, cells.masks);
        let seen = pack.receiver.see(&pack.source, &moved(instant, like, first));
        let emitter = &plan.cells[0].emitter;
        if SLOPES {
            if let Some(terms) = plan.terms_lanes::<R, true>(emitter, &pack, &seen) {
                found.set(&terms);
            }
        } else if let Some(currents) = plan.pairs_lanes::<R, true>(emitter, &pack, &seen) {
            found.set_currents(&currents);
        }
    }
}

/// [`Instant::pose_of`] the cell of each lane, from number `first` on.
#[inline(always)]
fn moved<R: Real<Element = f64>>(instant: &Instant<'_, f64>, like: R, first: usize) -> Transform<R> {
    let pose = instant.pose.in_all_lanes(like);
    match instant.offsets_in_lanes(like, first) {
        Some(offset_s) => {
            let [shift, turn] = instant.displacement(offset_s);
            pose.moved(shift, turn)
        }
        None => pose,
    }
}

impl<const SLOPES: bool> Task for AtOnce<'_, SLOPES> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        self.all(Lanes::zero(instructions));
    }
}
