//! Faults in a board and its head: what processor and converters do wrong, and what is wrong with the light.

use slitpose_model::{CompiledScene, Pair, Pose, Scene, SceneError, Tier};

use super::Faults;
use super::kinds::Layer;
use super::text::{Fault, FaultClock};

/// The faults of one simulated board.
#[derive(Clone, Debug)]
pub struct BoardFaults {
    /// With the number of spans that have been acted on.
    faults: Vec<(Fault, u64)>,
}

/// What befalls a board now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// So many scans are overwritten.
    Overrun(u64),
    /// The watchdog resets the board, which then needs this long to start, seconds.
    Reset(f64),
    /// The board is without supply for this long, seconds.
    Restart(f64),
    /// The converters fail.
    Stop,
}

impl BoardFaults {
    /// Those of `faults` that act in a board; `None` if none does.
    pub fn of(faults: &Faults) -> Option<Self> {
        let faults: Vec<_> = faults.of(Layer::Board).into_iter().map(|(fault, _)| (fault, 0)).collect();
        (!faults.is_empty()).then_some(Self { faults })
    }

    /// What begins by `time_s`, once for each begin.
    pub fn begin(&mut self, time_s: f64) -> Option<Trouble> {
        self.faults.iter_mut().find_map(|(fault, acted)| {
            let begun = fault.window.begun(time_s);
            if begun <= *acted {
                return None;
            }
            *acted = begun;
            let [amount, _] = fault.values;
            match fault.kind.name {
                "overrun" => Some(Trouble::Overrun(amount as u64)),
                "reset" => Some(Trouble::Reset(amount)),
                "restart" => Some(Trouble::Restart(fault.window.for_s)),
                "stop" => Some(Trouble::Stop),
                _ => None,
            }
        })
    }

    /// The time between two looks of a board at its scans, while it is slow, seconds.
    pub fn poll_s(&self, time_s: f64) -> Option<f64> {
        let is_slow = |fault: &Fault| fault.kind.name == "slow" && fault.window.is_open(time_s);
        self.faults.iter().find(|(fault, _)| is_slow(fault)).map(|(fault, _)| fault.values[0])
    }
}

/// Change of an emitter's power, 1/K: the temperature coefficient of GaAlAs emitters (Vishay TSAL6200, −0.6 %/K).
const EMITTER_PER_K: f64 = -0.006;

/// Factor of the dark current of a silicon detector for each kelvin: usual in Hamamatsu's data sheets.
const DARK_PER_K: f64 = 1.15;

/// The faults of one head on light.
#[derive(Debug)]
pub struct LightFaults {
    faults: Vec<LightFault>,
    clock: FaultClock,
    /// Device time of the scan under way, seconds.
    time_s: f64,
    /// Dark current of each cell at nominal temperature, both electrodes, amperes.
    dark_a: Vec<f64>,
}

#[derive(Debug)]
struct LightFault {
    fault: Fault,
    /// The optics with the part that has moved.
    moved: Option<CompiledScene<f64>>,
}

impl LightFaults {
    /// Those of `faults` that act on the light of `scene`; `None` if none does.
    pub fn of(faults: &Faults, scene: &Scene, tier: Tier) -> Result<Option<Self>, SceneError> {
        let mut of_light = Vec::new();
        for (fault, _) in faults.of(Layer::Light) {
            let [cell, by_m] = fault.values;
            let moves = fault.kind.name == "move";
            let moved = moves.then(|| moved(scene, cell as usize, by_m, tier)).transpose()?;
            of_light.push(LightFault { fault, moved });
        }
        let dark_a = scene.cells.iter().map(|cell| cell.detector.dark_current_a).collect();
        Ok((!of_light.is_empty()).then(|| Self { faults: of_light, clock: FaultClock::default(), time_s: 0.0, dark_a }))
    }

    pub(crate) fn begin(&mut self, tick: u64, tick_hz: u32) {
        self.time_s = self.clock.take(tick, tick_hz);
    }

    fn open(&self) -> impl Iterator<Item = &LightFault> {
        self.faults.iter().filter(|it| it.fault.window.is_open(self.time_s))
    }

    pub(crate) fn warmer_k(&self) -> f64 {
        let of_fault = |it: &LightFault| {
            let ([by_k, over_s], since_s) = (it.fault.values, it.fault.window.since_s(self.time_s));
            match since_s.filter(|_| it.fault.kind.name == "warm") {
                Some(since_s) if since_s < over_s => by_k * since_s / over_s,
                Some(_) => by_k,
                None => 0.0,
            }
        };
        self.faults.iter().map(of_fault).sum()
    }

    pub(crate) fn is_dead(&self, emitter: usize) -> bool {
        self.open().any(|it| it.fault.kind.name == "dead" && it.fault.cells().any(|dead| dead == emitter))
    }

    /// Photocurrents of `cell` where a part has moved: of the emitters `lit`, with the tool at `pose`.
    pub(crate) fn moved(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Option<Pair<f64>> {
        let is_of_cell = |it: &&LightFault| it.fault.cells().any(|of| of == cell);
        let plan = self.open().filter(is_of_cell).find_map(|it| it.moved.as_ref())?;
        Some(plan.photocurrents_of(cell, lit.iter().copied(), pose))
    }

    /// Light as a warm emitter gives it, and what the dark current of a warm detector has more than a cold one's.
    pub(crate) fn warmed(&self, cell: usize, light: Pair<f64>) -> Pair<f64> {
        let warmer_k = self.warmer_k();
        let share = (1.0 + EMITTER_PER_K * warmer_k).max(0.0);
        let dark_a = 0.5 * self.dark_a[cell] * (DARK_PER_K.powf(warmer_k) - 1.0);
        Pair { i_x1_a: share * light.i_x1_a + dark_a, i_x2_a: share * light.i_x2_a + dark_a }
    }
}

/// The optics of `scene` with the slit of a cell elsewhere.
fn moved(scene: &Scene, cell: usize, by_m: f64, tier: Tier) -> Result<CompiledScene<f64>, SceneError> {
    let mut scene = scene.clone();
    scene.cells[cell].slit.offset_m.x += by_m;
    CompiledScene::compile(&scene, tier)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene_file::WIDE;

    #[test]
    fn each_begin_makes_trouble_once() {
        let texts = ["overrun:scans=3,from=1s,every=1s", "restart:from=2s", "slow:poll=5ms,for=500ms"];
        let faults = Faults::new(texts.iter().map(|text| text.parse().unwrap()).collect(), 6).unwrap();
        let mut board = BoardFaults::of(&faults).unwrap();
        let times = [0.0, 0.9, 1.0, 1.5, 2.0, 2.0, 2.0, 3.1];
        let troubles = times.map(|time_s| board.begin(time_s));
        let overrun = Some(Trouble::Overrun(3));
        assert_eq!(troubles, [None, None, overrun, None, overrun, Some(Trouble::Restart(0.3)), None, overrun]);
        assert_eq!([0.0, 0.4, 0.5].map(|time_s| board.poll_s(time_s)), [Some(0.005), Some(0.005), None]);
    }

    fn faults(text: &str) -> LightFaults {
        let mut scene = WIDE.read().unwrap().scene;
        scene.cells[0].detector.dark_current_a = 20e-9;
        let faults = Faults::new(vec![text.parse().unwrap()], 6).unwrap();
        LightFaults::of(&faults, &scene, Tier::Paper).unwrap().unwrap()
    }

    #[test]
    fn an_emitter_is_dead_within_its_span() {
        let mut dead = faults("dead:emitter=3,from=1s");
        dead.begin(0, 10);
        assert!(!dead.is_dead(3));
        dead.begin(10, 10);
        assert!(dead.is_dead(3) && !dead.is_dead(2));
    }

    #[test]
    fn warmth_comes_by_and_by() {
        let mut warm = faults("warm:by=20K,over=2s,from=1s");
        let light = Pair { i_x1_a: 1e-6, i_x2_a: 2e-6 };
        for (tick, warmer_k) in [(0, 0.0), (10, 0.0), (20, 10.0), (30, 20.0), (90, 20.0)] {
            warm.begin(tick, 10);
            assert_eq!(warm.warmer_k(), warmer_k, "{tick}");
        }
        // 12 % less light, and 16.37 times the 10 nA of an electrode.
        let warmed = warm.warmed(0, light);
        let [first, second] = [warmed.i_x1_a - 0.88e-6, warmed.i_x2_a - 1.76e-6];
        assert!((first - 153.7e-9).abs() < 0.1e-9 && (second - first).abs() < 1e-15, "{first} {second}");
    }

    #[test]
    fn a_slit_that_has_moved_shifts_the_light_of_its_cell_alone() {
        let mut moved = faults("move:cell=2,by=50um");
        moved.begin(0, 10);
        let plan = CompiledScene::<f64>::compile(&WIDE.read().unwrap().scene, Tier::Paper).unwrap();
        let sound = plan.photocurrents_of(2, [(2, 1.0)], &Pose::HOME);
        let shifted = moved.moved(2, &[(2, 1.0)], &Pose::HOME).unwrap();
        let place = |pair: Pair<f64>| (pair.i_x2_a - pair.i_x1_a) / pair.total_a();
        // By more than 50 µm of the 6 mm to either side, and not by twice that.
        assert!((0.0083..0.0167).contains(&(place(shifted) - place(sound))), "{} {}", place(shifted), place(sound));
        assert_eq!(moved.moved(1, &[(1, 1.0)], &Pose::HOME), None);
    }
}
