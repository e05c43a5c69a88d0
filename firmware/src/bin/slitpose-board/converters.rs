//! The two converters: I_X1 of every cell on ADC1, I_X2 on ADC2. The same edge starts both,
//! so that the two currents of a cell are held at the same instant. What all converters of the MCU have in common is
//! here, too: [`crate::sensors`] has one of its own.

use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::vals::{Adstp, Dmacfg, Dmaen, Exten, Ovrmod, Rovsm, SampleTime, Trovs};
use embassy_stm32::pac::adccommon::AdcCommon;
use embassy_stm32::pac::adccommon::vals::Ckmode;
use embassy_stm32::peripherals::{ADC1, ADC2};
use embassy_stm32::{Peri, pac, rcc};
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_firmware::pcb::frame_plan::FramePlan;
use slitpose_firmware::pcb::pins::ADC_INPUTS;

/// The line of the frame timer's output among the converters' triggers (RM0440, ADC1/2
/// external triggers).
const TRIGGER: u8 = 11;

/// Processor cycles the converters' regulator takes to come up: 20 µs (data sheet, t_ADCVREG).
const REGULATOR_CYCLES: u32 = TICK_HZ / 1_000_000 * 20;

/// Processor cycles between the last change at the trigger's input and the start: several
/// periods of the converters' clock.
const TRIGGER_CYCLES: u32 = 64;

/// Number of polls of a flag before a time-out: some 60 µs, several times what any step but
/// calibration takes.
const PATIENCE: u32 = 1_000;

/// The same for calibration, which takes 116 periods of the converters' clock.
const CALIBRATION_PATIENCE: u32 = 10_000;

/// A flag of the converters did not change in time.
#[derive(Debug, Clone, Copy)]
pub struct Unresponsive;

#[derive(Debug)]
pub struct Converters {
    is_up: bool,
}

fn both() -> [Adc; 2] {
    [pac::ADC1, pac::ADC2]
}

fn wait(patience: u32, mut done: impl FnMut() -> bool) -> Result<(), Unresponsive> {
    if (0..patience).any(|_| done()) { Ok(()) } else { Err(Unresponsive) }
}

impl Converters {
    pub fn new(_first: Peri<'static, ADC1>, _second: Peri<'static, ADC2>) -> Self {
        // ADC1 and ADC2 share one clock and one reset.
        rcc::enable_and_reset::<ADC1>();
        Self { is_up: false }
    }

    /// Addresses of the data registers, for the DMA.
    pub fn data() -> [*mut (); 2] {
        both().map(|adc| adc.dr().as_ptr().cast())
    }

    /// Prepares both for scans of `plan`, with no word and no request left of earlier scans.
    pub fn prepare(&mut self, plan: &FramePlan) -> Result<(), Unresponsive> {
        if !self.is_up {
            // The reset undoes the first steps of an attempt that failed.
            pac::RCC.ahb2rstr().modify(|w| w.set_adc12rst(true));
            pac::RCC.ahb2rstr().modify(|w| w.set_adc12rst(false));
            power_up(&both(), pac::ADC12_COMMON)?;
            self.is_up = true;
        }
        for (adc, inputs) in both().into_iter().zip(&ADC_INPUTS) {
            enable(adc)?;
            convert_in_vain(adc)?;
            configure(adc, inputs, plan);
        }
        Ok(())
    }

    /// From now on each edge of the trigger starts a scan. The DMA must be running.
    pub fn start(&mut self) {
        for adc in both() {
            adc.cfgr().modify(|w| w.set_dmaen(Dmaen::ENABLE));
        }
        cortex_m::asm::delay(TRIGGER_CYCLES);
        for adc in both() {
            adc.cr().modify(|w| w.set_adstart(true));
        }
    }

    /// Ends sampling, and switches both off until the next run: a converter that was only stopped takes channel 0
    /// first (ES0430, "ADC channel 0 converted instead of the required ADC channel"). Drops the conversion under way,
    /// and also a word that the DMA has not fetched: the request for that word would outlive the stop and put the word
    /// ahead of the next run's words.
    pub fn stop(&mut self) -> Result<(), Unresponsive> {
        let mut outcome = Ok(());
        for adc in both() {
            if adc.cr().read().adstart() {
                adc.cr().modify(|w| w.set_adstp(Adstp::STOP));
                outcome = outcome.and(wait(PATIENCE, || !adc.cr().read().adstart()));
            }
            if adc.cr().read().aden() {
                adc.cr().modify(|w| w.set_addis(true));
                outcome = outcome.and(wait(PATIENCE, || !adc.cr().read().aden()));
            }
            adc.cfgr().modify(|w| w.set_dmaen(Dmaen::DISABLE));
            let _ = adc.dr().read();
            clear_flags(adc);
        }
        outcome
    }

    /// Whether a word of either converter was overwritten before the DMA fetched it.
    pub fn has_overrun(&self) -> bool {
        both().into_iter().any(|adc| adc.isr().read().ovr())
    }
}

/// Powers converters up that have just been reset (RM0440, ADC): regulator and calibration; each step is waited for.
#[inline(never)]
pub fn power_up(converters: &[Adc], common: AdcCommon) -> Result<(), Unresponsive> {
    // A quarter of the bus clock for all converters of the MCU: clocks of their own would disturb each other
    // (ES0430, converters at work at the same time). Slots of whole periods of this clock have no jitter of the
    // trigger, other slots have up to one period.
    common.ccr().modify(|w| w.set_ckmode(Ckmode::SYNC_DIV4));
    for adc in converters {
        adc.cr().modify(|w| w.set_deeppwd(false));
        adc.cr().modify(|w| w.set_advregen(true));
    }
    cortex_m::asm::delay(REGULATOR_CYCLES);
    for adc in converters {
        adc.cr().modify(|w| w.set_adcal(true));
        wait(CALIBRATION_PATIENCE, || !adc.cr().read().adcal())?;
    }
    // Four periods of the converters' clock between the end of calibration and enabling.
    cortex_m::asm::delay(32);
    Ok(())
}

/// Switches a converter on, after [`power_up`].
#[inline(never)]
pub fn enable(adc: Adc) -> Result<(), Unresponsive> {
    if adc.cr().read().aden() {
        return Ok(());
    }
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    wait(PATIENCE, || adc.isr().read().adrdy())
}

/// One conversion that nobody reads: the first one after a pause may be wrong (ES0430, see
/// [`slitpose_firmware::pcb::frame_plan`]).
fn convert_in_vain(adc: Adc) -> Result<(), Unresponsive> {
    adc.cfgr().write(|w| w.set_jqdis(true));
    adc.cfgr2().write(|_| {});
    adc.sqr1().write(|_| {});
    adc.cr().modify(|w| w.set_adstart(true));
    wait(PATIENCE, || !adc.cr().read().adstart())
}

#[inline(never)]
fn configure(adc: Adc, inputs: &[u8], plan: &FramePlan) {
    let sampling = SampleTime::from_bits(plan.sampling_code);
    let leading = inputs.iter().take(usize::from(plan.has_leading_word));
    let ranks = leading.chain(inputs).take(plan.ranks.into()).enumerate();
    adc.sqr1().write(|w| {
        w.set_l(plan.ranks - 1);
        for (rank, &input) in ranks.clone().take(4) {
            w.set_sq(rank, input);
        }
    });
    adc.sqr2().write(|w| {
        for (rank, &input) in ranks.clone().skip(4) {
            w.set_sq(rank - 4, input);
        }
    });
    adc.smpr().write(|w| {
        for (_, &input) in ranks.clone().filter(|&(_, &input)| input < 10) {
            w.set_smp(input.into(), sampling);
        }
    });
    adc.smpr2().write(|w| {
        for (_, &input) in ranks.filter(|&(_, &input)| input >= 10) {
            w.set_smp(usize::from(input) - 10, sampling);
        }
    });
    adc.cfgr2().write(|w| {
        // One trigger starts all conversions of a word, and the converter sums them.
        w.set_rovse(plan.oversampling_log2 > 0);
        w.set_ovsr(plan.oversampling_log2.saturating_sub(1));
        w.set_trovs(Trovs::AUTOMATIC);
        w.set_rovsm(Rovsm::CONTINUED);
    });
    adc.cfgr().write(|w| {
        w.set_dmaen(Dmaen::DISABLE);
        w.set_dmacfg(Dmacfg::CIRCULAR);
        w.set_extsel(TRIGGER);
        w.set_exten(Exten::RISING_EDGE);
        w.set_ovrmod(Ovrmod::PRESERVE);
        w.set_jqdis(true);
    });
    clear_flags(adc);
}

fn clear_flags(adc: Adc) {
    adc.isr().write(|w| {
        w.set_eoc(true);
        w.set_eos(true);
        w.set_eosmp(true);
        w.set_ovr(true);
    });
}
