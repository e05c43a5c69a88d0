//! Frames made by one timer: it lights the slots, triggers the converters, and never
//! waits for the program.
//!
//! ```text
//! frame timer ─update────▶ transfer ─▶ emitter gates           (table: one word a slot)
//!             ─compare 2─▶ converters ─▶ transfers ─▶ rings of words
//!             ─compare 2─▶ transfer ─▶ its own next period     (only with an idle rest)
//!             ─compare 4─▶ transfer ─▶ all gates off           (only with a rest behind a lit slot)
//!             ─compare 1, 3─▶ transfers ─▶ level lines         (only where levels differ)
//! ```
//! Which frame a word belongs to follows from the device clock, which runs from the same
//! oscillator: frame n of a run starts n periods after the run did. Where the transfers
//! are in their tables is compared with that at every poll; when they disagree, or words
//! were lost on the way, everything is stopped and started again in step, and the frames
//! in between are missing from the sequence.

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering, fence};

use embassy_stm32::pac::timer::vals::{Mms, Ocm, Urs};
use embassy_stm32::peripherals::{ADC1, ADC2, DMA1_CH1, TIM2};
use embassy_stm32::{Peri, pac, rcc};
use slitpose_firmware::ScanError;
use slitpose_firmware::timing::{BOARD_SLOTS, FramePlan};
use slitpose_firmware::wiring::LEVEL_LINES;
use slitpose_protocol::{Configuration, HardwareFault, Levels, RawScan};

use crate::clock::Clock;
use crate::converters::{Converters, Unresponsive};
use crate::emitters::Emitters;
use crate::supply;
use crate::transfers::{Channel, Table};

/// Words in the ring of a converter: 85 frames of the default, 21 ms.
const RING_WORDS: usize = 2048;

/// Frames of a ring that are not read any more because they may be overwritten meanwhile.
const MARGIN_FRAMES: u64 = 2;

/// Ticks around a slot's start in which the transfers may be done or not: looking at the
/// clock and at them takes some twenty.
const SLOT_EDGE_TICKS: u32 = 128;

static WORDS: [[AtomicU16; RING_WORDS]; 2] = [const { [const { AtomicU16::new(0) }; RING_WORDS] }; 2];
static PERIODS: [AtomicU32; BOARD_SLOTS] = [const { AtomicU32::new(0) }; BOARD_SLOTS];
static LEVELS: [[AtomicU32; BOARD_SLOTS]; LEVEL_LINES] = [const { [const { AtomicU32::new(0) }; BOARD_SLOTS] }; 2];

/// Request lines: RM0440, DMAMUX, assignment of multiplexer inputs.
const WORD_TRANSFERS: [Channel; 2] = [Channel::new(0, 5), Channel::new(1, 36)];
const PERIOD_TRANSFER: Channel = Channel::new(4, 57);
const LEVEL_TRANSFERS: [Channel; LEVEL_LINES] = [Channel::new(5, 56), Channel::new(6, 58)];

/// Frame timer and converters.
#[derive(Debug)]
pub struct Acquisition {
    converters: Converters,
    run: Option<Run>,
    /// Sequence number of the first frame of the next run.
    next_sequence: u64,
}

/// Frames under way.
#[derive(Debug)]
struct Run {
    plan: FramePlan,
    levels: Levels,
    frames_in_ring: u32,
    /// The next frame to be handed out: its number, start, and place in the rings.
    sequence: u64,
    tick: u64,
    place: u32,
}

impl Acquisition {
    /// Takes the timer, both converters, and the first transfer controller as a whole, of
    /// which its first channel stands for all.
    pub fn new(
        adc1: Peri<'static, ADC1>,
        adc2: Peri<'static, ADC2>,
        _timer: Peri<'static, TIM2>,
        _transfers: Peri<'static, DMA1_CH1>,
    ) -> Self {
        rcc::enable_and_reset::<TIM2>();
        Self { converters: Converters::new(adc1, adc2), run: None, next_sequence: 0 }
    }

    /// Stops what runs and starts `configuration`.
    pub fn start(
        &mut self,
        configuration: &Configuration,
        emitters: &mut Emitters,
        clock: &mut Clock,
    ) -> Result<(), HardwareFault> {
        let plan = FramePlan::new(configuration)?;
        self.stop(emitters, clock)?;
        supply::forgive();
        let run = Run {
            frames_in_ring: (RING_WORDS / plan.words()) as u32,
            plan,
            levels: configuration.levels.clone(),
            sequence: self.next_sequence,
            tick: 0,
            place: 0,
        };
        self.launch(run, emitters, clock)
    }

    /// Dark and still when it returns without an error.
    pub fn stop(&mut self, emitters: &mut Emitters, clock: &mut Clock) -> Result<(), HardwareFault> {
        if let Some(run) = self.run.take() {
            self.next_sequence = run.sequence + run.finished(clock.now());
        }
        self.halt(emitters)
    }

    /// Reads the oldest finished frame.
    pub fn next_scan(
        &mut self,
        scan: &mut RawScan,
        emitters: &mut Emitters,
        clock: &mut Clock,
    ) -> Result<bool, ScanError> {
        if supply::is_low() {
            return Err(ScanError::Fault(HardwareFault::Supply));
        }
        let Some(run) = &mut self.run else {
            return Ok(false);
        };
        // Behind an overrun the converters' words move up in the rings.
        if self.converters.has_overrun() {
            return self.restart(emitters, clock);
        }
        let now = clock.now();
        if now < run.tick + u64::from(run.plan.done_ticks) {
            return if run.is_in_step(now, emitters) { Ok(false) } else { self.restart(emitters, clock) };
        }
        let behind = now - run.tick;
        if behind >= (u64::from(run.frames_in_ring) - MARGIN_FRAMES) * u64::from(run.plan.frame_ticks) {
            return self.restart(emitters, clock);
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

    /// Back in step after words were lost.
    fn restart(&mut self, emitters: &mut Emitters, clock: &mut Clock) -> Result<bool, ScanError> {
        let Some(mut run) = self.run.take() else {
            return Ok(false);
        };
        let lost = run.finished(clock.now()).max(1);
        run.sequence += lost;
        self.next_sequence = run.sequence;
        self.halt(emitters).and_then(|()| self.launch(run, emitters, clock)).map_err(ScanError::Fault)?;
        Err(ScanError::Overrun)
    }

    fn halt(&mut self, emitters: &mut Emitters) -> Result<(), HardwareFault> {
        let is_dark = emitters.darken();
        let timer = pac::TIM2;
        timer.dier().write(|_| {});
        for channel in WORD_TRANSFERS.into_iter().chain(LEVEL_TRANSFERS).chain([PERIOD_TRANSFER]) {
            channel.stop();
        }
        self.converters.disarm().map_err(|Unresponsive| HardwareFault::Converters)?;
        if is_dark { Ok(()) } else { Err(HardwareFault::Emitters) }
    }

    /// Sets everything up at a standstill and lets go.
    fn launch(&mut self, mut run: Run, emitters: &mut Emitters, clock: &mut Clock) -> Result<(), HardwareFault> {
        run.place = 0;
        // The timer starts at the very end of a period: its first update begins slot 0, like
        // all that follow.
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
            // Written in one slot for the next, which takes it over at the update.
            for (slot, item) in PERIODS.iter().take(plan.periods.len()).enumerate() {
                let next = (slot + 1) % plan.periods.len();
                item.store(plan.periods[next] - 1, Ordering::Relaxed);
            }
            PERIOD_TRANSFER.feed(timer.arr().as_ptr().cast(), Table::of_words(&PERIODS[..plan.periods.len()]));
        }
        let varies: [bool; LEVEL_LINES] = core::array::from_fn(|line| !plan.is_level_constant(line));
        for (line, codes) in plan.level_codes.iter().enumerate() {
            if let Some(&first) = codes.first() {
                emitters.set_level(line, first);
            }
            if varies[line] {
                LEVELS[line].iter().zip(codes).for_each(|(item, &code)| item.store(code.into(), Ordering::Relaxed));
                let table = Table::of_words(&LEVELS[line][..codes.len()]);
                LEVEL_TRANSFERS[line].feed(Emitters::level_register(line), table);
            }
        }
        let ring = run.frames_in_ring as usize * plan.words();
        for ((channel, register), words) in WORD_TRANSFERS.into_iter().zip(Converters::data()).zip(&WORDS) {
            channel.collect(register, Table::of_halves(&words[..ring]));
        }
        self.converters.arm(plan).map_err(|Unresponsive| HardwareFault::Converters)?;
        timer.sr().write(|_| {});
        timer.dier().write(|w| {
            w.set_ude(true);
            w.set_ccde(0, varies[0]);
            w.set_ccde(1, has_rest);
            w.set_ccde(2, varies[1]);
            w.set_ccde(3, plan.off_ticks.is_some());
        });
        // Nothing may come between the start of the timer and the look at the clock. The
        // supply may have gone meanwhile, and with it the right to light anything.
        let is_supplied = cortex_m::interrupt::free(|_| {
            let is_supplied = !supply::is_low();
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

    fn advance(&mut self) {
        self.sequence += 1;
        self.tick += u64::from(self.plan.frame_ticks);
        self.place = if self.place + 1 == self.frames_in_ring { 0 } else { self.place + 1 };
    }

    fn read(&self, scan: &mut RawScan) {
        // What the transfers wrote before the clock passed is read after it.
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

    /// Whether the transfers are where they must be at `now`, which lies in the frame that
    /// is handed out next, or in the idle rest before it.
    fn is_in_step(&self, now: u64, emitters: &Emitters) -> bool {
        if emitters.has_failed() || WORD_TRANSFERS.iter().any(|channel| channel.has_failed()) {
            return false;
        }
        let (words, ranks) = (self.plan.words() as u32, u32::from(self.plan.ranks));
        let ring = self.frames_in_ring * words;
        let written = WORD_TRANSFERS.map(|channel| ring - u32::from(channel.remaining()));
        let [first, second] = written.map(|at| (at + ring - self.place * words) % ring);
        let Some((slot, is_at_edge)) = self.slot_at(now) else {
            return first == 0 && second == 0;
        };
        // Within a slot its words come in; at its edges it may be the one before or after.
        let slack = if is_at_edge { ranks } else { 0 };
        let least = (slot * ranks).saturating_sub(slack);
        let most = (slot + 1) * ranks + slack;
        let are_words_in_step = first.abs_diff(second) <= 1 && (least..=most).contains(&first);
        let slots = self.plan.periods.len();
        are_words_in_step && (is_at_edge || emitters.next_slot(slots) == (slot as usize + 1) % slots)
    }

    /// The slot that `now` lies in, and whether near one of its ends; `None` before the
    /// frame begins.
    fn slot_at(&self, now: u64) -> Option<(u32, bool)> {
        let into_frame = now.checked_sub(self.tick)? as u32;
        let last = self.plan.periods.len() as u32 - 1;
        let period = self.plan.periods[0];
        // All slots but the last are as long as the first.
        let slot = if last == 0 { 0 } else { (into_frame / period).min(last) };
        let into_slot = into_frame - slot * period;
        let to_next = self.plan.periods[slot as usize].saturating_sub(into_slot);
        Some((slot, into_slot < SLOT_EDGE_TICKS || to_next < SLOT_EDGE_TICKS))
    }
}
