//! Faults in a board and its head: what processor and converters do wrong, what is wrong with the light, and with the words of
//! scans.
//!
//! Words are sums of conversions, and codes may fall as the current rises ([`AdcScaling`]). The noise of a word that is
//! dimmed is dimmed with it, and what is missing comes from the dark word of the scan before.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{CompiledScene, Pair, Pose, Scene, SceneError, Tier};
use slitpose_protocol::{AdcScaling, RawScan, WordPair};

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
pub const EMITTER_PER_K: f64 = -0.006;

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

/// The faults of a head on the words of one board.
#[derive(Clone, Debug)]
pub struct WordFaults {
    faults: Vec<WordFault>,
    clock: FaultClock,
    dark_before: Option<RawScan>,
}

#[derive(Clone, Debug)]
struct WordFault {
    fault: Fault,
    random: ChaCha8Rng,
    /// The words that a stuck cell keeps.
    kept: Option<(WordPair, Option<WordPair>)>,
}

/// What words of one configuration are worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WordScale {
    pub(crate) scaling: AdcScaling,
    pub(crate) oversampling: u16,
    pub(crate) tick_hz: u32,
}

impl WordScale {
    fn top(&self) -> f64 {
        f64::from(u32::from(self.oversampling) * ((1_u32 << self.scaling.bits.min(16)) - 1)).min(f64::from(u16::MAX))
    }

    fn word(&self, value: f64) -> u16 {
        value.round().clamp(0.0, self.top()) as u16
    }

    fn steps(&self, current_a: f64) -> f64 {
        f64::from(self.oversampling) * current_a / self.scaling.amperes_per_code
    }

    fn zero(&self) -> f64 {
        f64::from(self.oversampling) * self.scaling.zero_code
    }
}

impl WordFaults {
    /// Those of `faults` that act on words; `None` if none does.
    pub fn of(faults: &Faults) -> Option<Self> {
        let faults: Vec<_> = faults
            .of(Layer::Words)
            .into_iter()
            .map(|(fault, random)| WordFault { fault, random, kept: None })
            .collect();
        (!faults.is_empty()).then(|| Self { faults, clock: FaultClock::default(), dark_before: None })
    }

    /// Changes the words of the next `scan`.
    pub(crate) fn apply(&mut self, scan: &mut RawScan, scale: &WordScale) {
        let time_s = self.clock.take(scan.tick, scale.tick_hz);
        let before = self.dark_before.replace(*scan).filter(|before| before.cells() == scan.cells());
        for fault in &mut self.faults {
            if fault.fault.window.is_open(time_s) {
                fault.apply(scan, before.as_ref(), scale);
            } else {
                fault.kept = None;
            }
        }
    }
}

impl WordFault {
    fn apply(&mut self, scan: &mut RawScan, before: Option<&RawScan>, scale: &WordScale) {
        // A board that has fewer cells than its head is refused elsewhere.
        if self.fault.cells().any(|cell| cell >= scan.cells()) {
            return;
        }
        let [cell, amount] = self.fault.values;
        let cell = cell as usize;
        match self.fault.kind.name {
            name @ ("occlude" | "dim") => {
                let to = if name == "dim" { amount } else { 0.0 };
                let zero = [scale.word(scale.zero()); 2];
                let dark = before.unwrap_or(scan).dark().map_or(zero, |dark| dark[cell]);
                for (lit, dark) in scan.lit_mut()[cell].iter_mut().zip(dark) {
                    *lit = scale.word(to * f64::from(*lit) + (1.0 - to) * f64::from(dark));
                }
            }
            "saturate" => {
                scan.lit_mut()[cell] =
                    [if scale.scaling.amperes_per_code < 0.0 { 0 } else { scale.word(scale.top()) }; 2];
            }
            "glint" => {
                let word = &mut scan.lit_mut()[cell][0];
                *word = scale.word(f64::from(*word) + scale.steps(amount));
            }
            "stray" => {
                change(scan, cell, |word| scale.word(f64::from(word) + scale.steps(amount)));
            }
            "noisy" => {
                let rms = scale.steps(amount).abs();
                let mut draw = || <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut self.random);
                change(scan, cell, |word| scale.word(f64::from(word) + rms * draw()));
            }
            "stuck" => {
                let now = || (scan.lit()[cell], scan.dark().map(|dark| dark[cell]));
                let (lit, dark) = *self.kept.get_or_insert_with(now);
                scan.lit_mut()[cell] = lit;
                if let (Some(words), Some(dark)) = (scan.dark_mut(), dark) {
                    words[cell] = dark;
                }
            }
            "swap-electrodes" => {
                scan.lit_mut()[cell].swap(0, 1);
                if let Some(dark) = scan.dark_mut() {
                    dark[cell].swap(0, 1);
                }
            }
            "swap-cells" => {
                let with = amount as usize;
                scan.lit_mut().swap(cell, with);
                if let Some(dark) = scan.dark_mut() {
                    dark.swap(cell, with);
                }
            }
            // Of other layers.
            _ => {}
        }
    }
}

fn change(scan: &mut RawScan, cell: usize, mut change: impl FnMut(u16) -> u16) {
    scan.lit_mut()[cell] = scan.lit()[cell].map(&mut change);
    if let Some(dark) = scan.dark_mut() {
        dark[cell] = dark[cell].map(&mut change);
    }
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

    const SCALE: WordScale = WordScale {
        scaling: AdcScaling { zero_code: 4000.0, amperes_per_code: -1e-9, bits: 12, saturation_code: 16 },
        oversampling: 4,
        tick_hz: 1000,
    };

    fn scan(tick: u64) -> RawScan {
        let mut scan = RawScan::new(3, true);
        (scan.sequence, scan.tick) = (tick, tick);
        for cell in 0..3 {
            scan.lit_mut()[cell] = [8000 + cell as u16 + tick as u16, 9000 + cell as u16];
            scan.dark_mut().unwrap()[cell] = [16_000 + tick as u16, 15_990];
        }
        scan
    }

    fn faulty(texts: &[&str], ticks: u64) -> Vec<RawScan> {
        let faults = Faults::new(texts.iter().map(|text| text.parse().unwrap()).collect(), 3).unwrap();
        let mut words = WordFaults::of(&faults).unwrap();
        let apply = |tick| {
            let mut scan = scan(tick);
            words.apply(&mut scan, &SCALE);
            scan
        };
        (0..ticks).map(apply).collect()
    }

    #[test]
    fn a_fault_acts_within_its_span_on_its_cell() {
        let scans = faulty(&["occlude:cell=1,from=2ms,for=2ms"], 6);
        for (tick, faulty) in (0..).zip(&scans) {
            let sound = scan(tick);
            // No light: as dark as the scan before.
            let expected = if (2..4).contains(&tick) { scan(tick - 1).dark().unwrap()[1] } else { sound.lit()[1] };
            assert_eq!(faulty.lit()[1], expected, "{tick}");
            assert_eq!(
                (faulty.lit()[0], faulty.lit()[2], faulty.dark()),
                (sound.lit()[0], sound.lit()[2], sound.dark())
            );
        }
    }

    #[test]
    fn each_fault_does_to_words_what_it_says() {
        let last = |text: &str| faulty(&[text], 3)[2];
        let sound = scan(2);
        // Half of the way to the dark word of the scan before, 16 001.
        assert_eq!(last("dim:cell=0,to=0.5").lit()[0][0], (16_001 + 8002_u16).div_ceil(2));
        assert_eq!(last("saturate:cell=0").lit()[0], [0, 0]);
        // 100 nA are 100 codes, and 400 steps down.
        assert_eq!(last("glint:cell=0,current=100nA").lit()[0], [8002 - 400, 9000]);
        assert_eq!(last("glint:cell=0,current=100nA").dark(), sound.dark());
        let stray = last("stray:cell=0,current=100nA");
        assert_eq!(
            (stray.lit()[0], stray.dark().unwrap()[0]),
            ([8002 - 400, 9000 - 400], [16_002 - 400, 15_990 - 400])
        );
        let stuck = last("stuck:cell=0,from=1ms");
        assert_eq!((stuck.lit()[0], stuck.dark().unwrap()[0]), (scan(1).lit()[0], scan(1).dark().unwrap()[0]));
        assert_eq!(last("swap-electrodes:cell=2").lit()[2], [9002, 8004]);
        let swapped = last("swap-cells:cell=0,with=2");
        assert_eq!((swapped.lit()[0], swapped.lit()[2]), (sound.lit()[2], sound.lit()[0]));
    }

    #[test]
    fn noise_is_as_large_as_asked_for_and_depends_on_the_seed() {
        let noisy = |text: &str| -> Vec<f64> {
            let lit =
                |(tick, faulty): (u64, RawScan)| f64::from(faulty.lit()[0][1]) - f64::from(scan(tick).lit()[0][1]);
            (0..).zip(faulty(&[text], 2000)).map(lit).collect()
        };
        let first = noisy("noisy:cell=0,rms=20nA");
        let rms = (first.iter().map(|step| step * step).sum::<f64>() / 2000.0).sqrt();
        // 80 steps, to six standard deviations of an estimate from 2000.
        assert!((rms - 80.0).abs() < 80.0 * 6.0 / 4000.0_f64.sqrt(), "seed 1: {rms}");
        assert_eq!(first, noisy("noisy:cell=0,rms=20nA,seed=1"));
        assert_ne!(first, noisy("noisy:cell=0,rms=20nA,seed=2"));
    }
}
