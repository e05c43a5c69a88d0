//! Frames by one timer, which lights the slots and triggers the converters without the
//! firmware.
//!
//! ```text
//! frame timer ─update───────▶ DMA ─▶ emitter gates           (table: one word a slot)
//!             ─compare 2────▶ converters ─▶ DMA ─▶ rings of words
//!             ─compare 2────▶ DMA ─▶ the timer's next period   (only with an idle rest)
//!             ─compare 4────▶ DMA ─▶ all gates off             (only with a rest behind a lit slot)
//!             ─compare 1, 3─▶ DMA ─▶ level lines               (only where levels differ)
//! guard timer ─no compare 2─▶ DMA ─▶ all gates off
//! ```
//! The frame of a word follows from the device clock, which runs from the same oscillator:
//! frame n of a run starts n periods after the run. At every poll, before any scan is handed
//! out, the position of each DMA channel in its table is compared with the clock. If a
//! position and the clock disagree, or words have been lost, timer, converters and DMA are
//! stopped and started again in step; the frames in between are missing from the sequence.
//! After too many such restarts acquisition ends in a fault.

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering, fence};

use embassy_stm32::pac::timer::vals::{Mms, Ocm, Urs};
use embassy_stm32::peripherals::{ADC1, ADC2, DMA1_CH1, TIM2, TIM3};
use embassy_stm32::{Peri, pac, rcc};
use heapless::Vec;
use slitpose_firmware::ScanError;
use slitpose_firmware::pcb::frame_plan::{BOARD_SLOTS, FramePlan};
use slitpose_firmware::pcb::wiring::LEVEL_LINES;
use slitpose_protocol::{Configuration, HardwareFault, Levels, RawScan};

use crate::clock::Clock;
use crate::converters::{Converters, Unresponsive};
use crate::dma::{Channel, Table};
use crate::emitters::{Emitters, GATE_DMA, LATE_GATE_DMA};
use crate::guard::{self, Guard};
use crate::pulse::FrameOutput;

/// Words in the ring of a converter: 85 frames of the default, 21 ms.
const RING_WORDS: usize = 2048;

/// The oldest frames of a ring, which are not read because the DMA may overwrite them.
const MARGIN_FRAMES: u64 = 2;

/// Ticks around an event within which its DMA may or may not have made its step: reading
/// the clock and all DMA positions takes less than half of them.
const EDGE_TICKS: u32 = 128;

/// More restarts than this without a whole frame in between are a fault.
const RESTARTS: u32 = 3;

static WORDS: [[AtomicU16; RING_WORDS]; 2] = [const { [const { AtomicU16::new(0) }; RING_WORDS] }; 2];
static PERIODS: [AtomicU32; BOARD_SLOTS] = [const { AtomicU32::new(0) }; BOARD_SLOTS];
static LEVELS: [[AtomicU32; BOARD_SLOTS]; LEVEL_LINES] = [const { [const { AtomicU32::new(0) }; BOARD_SLOTS] }; 2];

/// Request lines: RM0440, DMAMUX, assignment of multiplexer inputs.
const WORD_DMA: [Channel; 2] = [Channel::new(0, 5), Channel::new(1, 36)];
const PERIOD_DMA: Channel = Channel::new(4, 57);
const LEVEL_DMA: [Channel; LEVEL_LINES] = [Channel::new(5, 56), Channel::new(6, 58)];

/// Frame timer, converters and their DMA.
#[derive(Debug)]
pub struct Sampler {
    converters: Converters,
    guard: Guard,
    /// The frame output.
    pub output: FrameOutput,
    run: Option<Run>,
    /// Sequence number of the first frame of the next run.
    next_sequence: u64,
}

#[derive(Debug)]
struct Run {
    plan: FramePlan,
    levels: Levels,
    frames_in_ring: u32,
    /// The next frame to be handed out: its number, its first tick, and its index in the rings.
    sequence: u64,
    tick: u64,
    place: u32,
    /// Frames from the next one on that are known to be whole.
    proven: u64,
    /// Restarts since the last whole frame.
    restarts: u32,
    /// DMA channels that make one step a slot, and the tick of the step in its slot.
    rounds: Vec<(Channel, u32), 5>,
}

/// Device tick and DMA positions at one instant.
#[derive(Debug, Clone, Copy)]
struct Look {
    now: u64,
    words_left: [u32; 2],
    rounds_left: [u16; 5],
}

impl Sampler {
    /// Takes both timers, both converters, and DMA1 as a whole, represented by its first
    /// channel.
    pub fn new(
        adc1: Peri<'static, ADC1>,
        adc2: Peri<'static, ADC2>,
        _timer: Peri<'static, TIM2>,
        guard: Peri<'static, TIM3>,
        _dma: Peri<'static, DMA1_CH1>,
        output: FrameOutput,
    ) -> Self {
        rcc::enable_and_reset::<TIM2>();
        let (converters, guard) = (Converters::new(adc1, adc2), Guard::new(guard));
        Self { converters, guard, output, run: None, next_sequence: 0 }
    }

    /// Stops what runs and starts `configuration`.
    pub fn start(
        &mut self,
        configuration: &Configuration,
        emitters: &mut Emitters,
        clock: &mut Clock,
    ) -> Result<(), HardwareFault> {
        let plan = FramePlan::new(configuration)?;
        // A start clears the record of a low supply; a change under way does not.
        if self.run.is_none() {
            guard::clear_low_supply();
        }
        self.stop(emitters)?;
        let run = Run {
            frames_in_ring: (RING_WORDS / plan.words()) as u32,
            plan,
            levels: configuration.levels.clone(),
            sequence: self.next_sequence,
            tick: 0,
            place: 0,
            proven: 0,
            restarts: 0,
            rounds: Vec::new(),
        };
        self.launch(run, emitters, clock)
    }

    /// Switches the emitters off and stops sampling, both before it returns without an error.
    pub fn stop(&mut self, emitters: &mut Emitters) -> Result<(), HardwareFault> {
        // Frames that have finished since the last look are cut off like the frame under way.
        if let Some(run) = self.run.take() {
            self.next_sequence = run.sequence + run.proven;
        }
        self.halt(emitters)
    }

    pub fn next_scan(
        &mut self,
        scan: &mut RawScan,
        emitters: &mut Emitters,
        clock: &mut Clock,
    ) -> Result<bool, ScanError> {
        if guard::is_supply_low() {
            return Err(ScanError::Fault(HardwareFault::Supply));
        }
        let Some(run) = &mut self.run else {
            return Ok(false);
        };
        if run.proven == 0 {
            // After an overrun the words that follow are in the wrong places of the rings.
            let is_broken = self.converters.has_overrun() || self.guard.has_fired();
            let proven = if is_broken { None } else { run.prove(run.look(clock)) };
            match proven {
                Some(0) => return Ok(false),
                Some(frames) => run.proven = frames,
                None => return self.restart(emitters, clock),
            }
        }
        run.read(scan);
        run.advance();
        Ok(true)
    }

    /// Ticks until `frames` more frames are finished; `None` if none are under way.
    pub fn ticks_to(&self, frames: usize, clock: &mut Clock) -> Option<u64> {
        let run = self.run.as_ref()?;
        let ahead = frames.saturating_sub(1) as u64 * u64::from(run.plan.frame_ticks);
        let due = run.tick + ahead + u64::from(run.plan.done_ticks);
        Some(due.saturating_sub(clock.now()))
    }

    /// Ticks until the next conversion begins; `None` during conversions.
    pub fn pause_ticks(&self, clock: &mut Clock) -> Option<u32> {
        self.run.as_ref().map_or(Some(u32::MAX), |run| run.pause_ticks(clock.now()))
    }

    /// Starts again in step after words were lost.
    fn restart(&mut self, emitters: &mut Emitters, clock: &mut Clock) -> Result<bool, ScanError> {
        let Some(mut run) = self.run.take() else {
            return Ok(false);
        };
        run.sequence += run.finished(clock.now()).max(1);
        run.restarts += 1;
        self.next_sequence = run.sequence;
        self.halt(emitters).map_err(ScanError::Fault)?;
        if run.restarts > RESTARTS {
            return Err(ScanError::Fault(HardwareFault::Converters));
        }
        self.launch(run, emitters, clock).map_err(ScanError::Fault)?;
        Err(ScanError::Overrun)
    }

    fn halt(&mut self, emitters: &mut Emitters) -> Result<(), HardwareFault> {
        let is_dark = emitters.darken();
        pac::TIM2.dier().write(|_| {});
        let converters = self.converters.stop();
        self.guard.stop();
        self.output.stop();
        for channel in WORD_DMA.into_iter().chain(LEVEL_DMA).chain([PERIOD_DMA]) {
            channel.stop();
        }
        if !is_dark {
            return Err(HardwareFault::Emitters);
        }
        converters.map_err(|Unresponsive| HardwareFault::Converters)
    }

    /// Sets timer, converters and DMA up while the timer stands still, then starts the timer.
    fn launch(&mut self, mut run: Run, emitters: &mut Emitters, clock: &mut Clock) -> Result<(), HardwareFault> {
        (run.place, run.proven) = (0, 0);
        // The timer starts at the very end of a period, so that an update begins slot 0 of the
        // first frame as of all others.
        let timer = pac::TIM2;
        pac::RCC.apb1rstr1().modify(|w| w.set_tim2rst(true));
        pac::RCC.apb1rstr1().modify(|w| w.set_tim2rst(false));
        timer.cr1().write(|w| {
            w.set_arpe(true);
            w.set_urs(Urs::COUNTER_ONLY);
        });
        let plan = &run.plan;
        timer.arr().write_value(plan.periods[0] - 1);
        timer.ccr(0).write_value(1);
        timer.ccr(1).write_value(plan.trigger_ticks);
        timer.ccr(2).write_value(1);
        timer.ccr(3).write_value(plan.off_ticks.unwrap_or(u32::MAX));
        timer.egr().write(|w| w.set_ug(true));
        timer.cnt().write_value(plan.periods[0] - 1);
        timer.ccmr_output(0).modify(|w| w.set_ocm(1, Ocm::PWM_MODE2));
        timer.cr2().write(|w| w.set_mms(Mms::COMPARE_OC2));

        emitters.arm(&plan.emitters, plan.off_ticks.is_some());
        let has_rest = plan.periods.iter().any(|&period| period != plan.periods[0]);
        if has_rest {
            // Each slot writes the period of the next, which takes effect at the update.
            for (slot, item) in PERIODS.iter().take(plan.periods.len()).enumerate() {
                let next = (slot + 1) % plan.periods.len();
                item.store(plan.periods[next] - 1, Ordering::Relaxed);
            }
            PERIOD_DMA.feed(timer.arr().as_ptr().cast(), Table::of_words(&PERIODS[..plan.periods.len()]));
        }
        let varies: [bool; LEVEL_LINES] = core::array::from_fn(|line| !plan.is_level_constant(line));
        for (line, codes) in plan.level_codes.iter().enumerate() {
            if let Some(&first) = codes.first() {
                emitters.set_level(line, first);
            }
            if varies[line] {
                LEVELS[line].iter().zip(codes).for_each(|(item, &code)| item.store(code.into(), Ordering::Relaxed));
                let table = Table::of_words(&LEVELS[line][..codes.len()]);
                LEVEL_DMA[line].feed(Emitters::level_register(line), table);
            }
        }
        run.rounds = rounds(plan, has_rest, varies);
        self.converters.prepare(plan).map_err(|Unresponsive| HardwareFault::Converters)?;
        let ring = run.frames_in_ring as usize * plan.words();
        for ((channel, register), words) in WORD_DMA.into_iter().zip(Converters::data()).zip(&WORDS) {
            channel.collect(register, Table::of_halves(&words[..ring]));
        }
        self.converters.start();
        self.guard.start(plan);
        self.output.start(plan.periods.len(), run.sequence);
        timer.sr().write(|_| {});
        timer.dier().write(|w| {
            w.set_ude(true);
            w.set_ccde(0, varies[0]);
            w.set_ccde(1, has_rest);
            w.set_ccde(2, varies[1]);
            w.set_ccde(3, plan.off_ticks.is_some());
        });
        // No interrupt may come between the start of the timer and the reading of the clock.
        // The timer does not start if the supply has become too low meanwhile.
        let is_supplied = cortex_m::interrupt::free(|_| {
            let is_supplied = !guard::is_supply_low();
            timer.cr1().modify(|w| w.set_cen(is_supplied));
            run.tick = clock.now();
            is_supplied
        });
        if !is_supplied {
            self.halt(emitters)?;
            return Err(HardwareFault::Supply);
        }
        self.run = Some(run);
        Ok(())
    }
}

impl Run {
    /// Frames that are finished at `now` and have not been handed out.
    fn finished(&self, now: u64) -> u64 {
        let done = self.tick + u64::from(self.plan.done_ticks);
        if now < done { 0 } else { (now - done) / u64::from(self.plan.frame_ticks) + 1 }
    }

    /// Ticks from `now` until the next conversion begins; `None` during conversions.
    fn pause_ticks(&self, now: u64) -> Option<u32> {
        // The next frame to be handed out began less than the ring or a longest frame ago.
        let At { into_slot, to_next, .. } = self.at(now.saturating_sub(self.tick) as u32 % self.plan.frame_ticks);
        let FramePlan { trigger_ticks, converted_ticks, .. } = self.plan;
        if into_slot < trigger_ticks {
            Some(trigger_ticks - into_slot)
        } else {
            (into_slot >= converted_ticks).then_some(to_next + trigger_ticks)
        }
    }

    fn advance(&mut self) {
        self.proven -= 1;
        self.restarts = 0;
        self.sequence += 1;
        self.tick += u64::from(self.plan.frame_ticks);
        self.place = if self.place + 1 == self.frames_in_ring { 0 } else { self.place + 1 };
    }

    fn read(&self, scan: &mut RawScan) {
        // The words are read after the clock, which proved that the DMA had written them.
        fence(Ordering::Acquire);
        scan.sequence = self.sequence;
        scan.tick = self.tick;
        scan.levels_mut().copy_from_slice(&self.levels);
        let words = self.plan.words();
        let start = self.place as usize * words;
        let [first, second] = [&WORDS[0][start..start + words], &WORDS[1][start..start + words]];
        let pair = |at: u8| [first, second].map(|frame| frame[usize::from(at)].load(Ordering::Relaxed));
        for (cell, &at) in scan.lit_mut().iter_mut().zip(&self.plan.lit_at) {
            *cell = pair(at);
        }
        if let Some(dark) = scan.dark_mut() {
            for (cell, &at) in dark.iter_mut().zip(&self.plan.dark_at) {
                *cell = pair(at);
            }
        }
    }

    /// Reads the clock and all DMA positions, without an interrupt in between.
    fn look(&self, clock: &mut Clock) -> Look {
        cortex_m::interrupt::free(|_| {
            let mut rounds_left = [0; 5];
            let now = clock.now();
            for (left, (channel, _)) in rounds_left.iter_mut().zip(&self.rounds) {
                *left = channel.remaining();
            }
            Look { now, words_left: WORD_DMA.map(|channel| channel.remaining().into()), rounds_left }
        })
    }

    /// Number of whole frames in the rings; `None` if a DMA position contradicts the clock.
    fn prove(&self, look: Look) -> Option<u64> {
        if WORD_DMA.iter().chain(self.rounds.iter().map(|(channel, _)| channel)).any(|c| c.has_failed()) {
            return None;
        }
        let finished = self.finished(look.now);
        if finished >= u64::from(self.frames_in_ring) - MARGIN_FRAMES {
            return None;
        }
        let (words, ranks) = (self.plan.words() as u32, u32::from(self.plan.ranks));
        let ring = self.frames_in_ring * words;
        let [first, second] = look.words_left.map(|left| {
            let written = (ring - left + ring - self.place * words) % ring;
            written.wrapping_sub(finished as u32 * words)
        });
        let Some(at) = self.slot_at(look.now, finished) else {
            // In the idle rest before the next frame, which may begin during the look.
            let start = self.tick + finished * u64::from(self.plan.frame_ticks);
            let most = if start - look.now < u64::from(EDGE_TICKS) { ranks } else { 0 };
            return (first <= most && second <= most).then_some(finished);
        };
        // Words of the slot are coming in; near its edges also words of a neighbouring slot.
        let slack = if at.is_at_edge() { ranks } else { 0 };
        let expected = (at.slot * ranks).saturating_sub(slack)..=(at.slot + 1) * ranks + slack;
        let is_in_step = first.abs_diff(second) <= 1 && expected.contains(&first) && self.rounds_fit(&at, look);
        is_in_step.then_some(finished)
    }

    fn rounds_fit(&self, at: &At, look: Look) -> bool {
        let slots = self.plan.periods.len() as u32;
        self.rounds.iter().zip(look.rounds_left).all(|(&(_, step), left)| {
            let is_near = at.is_at_edge() || at.into_slot.abs_diff(step) < EDGE_TICKS;
            let done = at.slot + u32::from(at.into_slot > step);
            is_near || u32::from(left) == slots - done % slots
        })
    }

    /// Place of `now` in the frame after `finished` frames; `None` before that frame begins.
    fn slot_at(&self, now: u64, finished: u64) -> Option<At> {
        let start = self.tick + finished * u64::from(self.plan.frame_ticks);
        Some(self.at(now.checked_sub(start)? as u32))
    }

    /// The place that is `into_frame` ticks behind the start of a frame.
    fn at(&self, into_frame: u32) -> At {
        // All slots but the last have the period of the first.
        let period = self.plan.periods[0];
        let slot = (into_frame / period).min(self.plan.periods.len() as u32 - 1);
        let into_slot = into_frame - slot * period;
        At { slot, into_slot, to_next: self.plan.periods[slot as usize].saturating_sub(into_slot) }
    }
}

#[derive(Debug, Clone, Copy)]
struct At {
    slot: u32,
    /// Ticks from the start of the slot, and to the next one.
    into_slot: u32,
    to_next: u32,
}

impl At {
    /// Near the beginning or the end of the slot.
    fn is_at_edge(&self) -> bool {
        self.into_slot < EDGE_TICKS || self.to_next < EDGE_TICKS
    }
}

/// DMA channels of a run that make one step a slot, and the tick of the step in its slot.
fn rounds(plan: &FramePlan, has_rest: bool, varies: [bool; LEVEL_LINES]) -> Vec<(Channel, u32), 5> {
    let mut rounds = Vec::new();
    let levels = LEVEL_DMA.into_iter().zip(varies).filter(|&(_, varies)| varies);
    let all = [(GATE_DMA, 0)]
        .into_iter()
        .chain(levels.map(|(channel, _)| (channel, 1)))
        .chain(has_rest.then_some((PERIOD_DMA, plan.trigger_ticks)))
        .chain(plan.off_ticks.map(|off_ticks| (LATE_GATE_DMA, off_ticks)));
    for round in all {
        // At most five: gates, two level lines, period, late gates.
        let _ = rounds.push(round);
    }
    rounds
}
