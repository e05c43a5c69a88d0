//! The two converters: I_X1 of every cell on the first, I_X2 on the second, both started
//! by the same edge, so that the two currents of a cell are held at the same instant.

use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::vals::{Adstp, Dmacfg, Dmaen, Exten, Ovrmod, Rovsm, SampleTime, Trovs};
use embassy_stm32::pac::adccommon::vals::Ckmode;
use embassy_stm32::peripherals::{ADC1, ADC2};
use embassy_stm32::{Peri, pac, rcc};
use slitpose_firmware::TICK_HZ;
use slitpose_firmware::timing::FramePlan;
use slitpose_firmware::wiring::CHANNELS;

/// Inputs of the converters by rank (RM0440 and data sheet, ADC channels): PA0 PA1 PC0 PC1
/// PC2 PC3, and PA7 PC4 PC5 PB2 PB11 PB15.
const INPUTS: [[u8; CHANNELS as usize]; 2] = [[1, 2, 6, 7, 8, 9], [4, 5, 11, 12, 14, 15]];

/// The line of the frame timer's output among the converters' triggers (RM0440, ADC1/2
/// external triggers).
const TRIGGER: u8 = 11;

/// Core cycles the converters' regulator takes to come up: 20 µs (data sheet, t_ADCVREG).
const REGULATOR_CYCLES: u32 = TICK_HZ / 1_000_000 * 20;

/// Core cycles between the last change at the trigger's input and listening to it: several
/// periods of the converters' clock.
const TRIGGER_CYCLES: u32 = 64;

/// How often a flag is looked at before it is given up: some 60 µs, several times what
/// any of them takes but calibration.
const PATIENCE: u32 = 1_000;

/// Calibration takes 116 periods of the converters' clock; looked at with more patience.
const CALIBRATION_PATIENCE: u32 = 10_000;

/// Something did not happen in time.
#[derive(Debug, Clone, Copy)]
pub struct Unresponsive;

/// Both converters.
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
    /// Both, not yet powered.
    pub fn new(_first: Peri<'static, ADC1>, _second: Peri<'static, ADC2>) -> Self {
        // One clock and one reset for both.
        rcc::enable_and_reset::<ADC1>();
        Self { is_up: false }
    }

    /// Addresses of the data registers, for transfers.
    pub fn data() -> [*mut (); 2] {
        both().map(|adc| adc.dr().as_ptr().cast())
    }

    /// Readies both for scans of `plan`, with no word and no request left of earlier ones.
    pub fn prepare(&mut self, plan: &FramePlan) -> Result<(), Unresponsive> {
        if !self.is_up {
            power_up()?;
            self.is_up = true;
        }
        for (adc, inputs) in both().into_iter().zip(&INPUTS) {
            configure(adc, inputs, plan);
        }
        Ok(())
    }

    /// From now on each edge of the trigger starts a scan. Whoever takes the words is ready.
    pub fn start(&mut self) {
        for adc in both() {
            adc.cfgr().modify(|w| w.set_dmaen(Dmaen::ENABLE));
        }
        cortex_m::asm::delay(TRIGGER_CYCLES);
        for adc in both() {
            adc.cr().modify(|w| w.set_adstart(true));
        }
    }

    /// Ends sampling; a conversion under way is dropped, and so is a word that has not been
    /// fetched: its request would outlive the stop and put it ahead of the next run's words.
    pub fn stop(&mut self) -> Result<(), Unresponsive> {
        let mut outcome = Ok(());
        for adc in both() {
            if adc.cr().read().adstart() {
                adc.cr().modify(|w| w.set_adstp(Adstp::STOP));
                outcome = outcome.and(wait(PATIENCE, || !adc.cr().read().adstart()));
            }
            adc.cfgr().modify(|w| w.set_dmaen(Dmaen::DISABLE));
            let _ = adc.dr().read();
            forget(adc);
        }
        outcome
    }

    /// Whether a word of either was overwritten before it was fetched.
    pub fn has_overrun(&self) -> bool {
        both().into_iter().any(|adc| adc.isr().read().ovr())
    }
}

/// RM0440, ADC: regulator, calibration, enable, in this order, each waited for.
fn power_up() -> Result<(), Unresponsive> {
    // From the beginning, also if an earlier attempt got half-way.
    pac::RCC.ahb2rstr().modify(|w| w.set_adc12rst(true));
    pac::RCC.ahb2rstr().modify(|w| w.set_adc12rst(false));
    // A quarter of the bus clock: with slots of whole periods of it the trigger has no
    // jitter, with others up to one period.
    pac::ADC12_COMMON.ccr().modify(|w| w.set_ckmode(Ckmode::SYNC_DIV4));
    for adc in both() {
        adc.cr().modify(|w| w.set_deeppwd(false));
        adc.cr().modify(|w| w.set_advregen(true));
    }
    cortex_m::asm::delay(REGULATOR_CYCLES);
    for adc in both() {
        adc.cr().modify(|w| w.set_adcal(true));
        wait(CALIBRATION_PATIENCE, || !adc.cr().read().adcal())?;
    }
    // Four periods of the converters' clock between the end of calibration and enabling.
    cortex_m::asm::delay(32);
    for adc in both() {
        adc.isr().write(|w| w.set_adrdy(true));
        adc.cr().modify(|w| w.set_aden(true));
        wait(PATIENCE, || adc.isr().read().adrdy())?;
    }
    Ok(())
}

fn configure(adc: Adc, inputs: &[u8], plan: &FramePlan) {
    let sampling = SampleTime::from_bits(plan.sampling_code);
    let ranks = inputs.iter().take(plan.ranks.into()).enumerate();
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
        // All conversions of a word follow one another behind one trigger, and are summed.
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
    forget(adc);
}

/// Clears the flags of what has been converted.
fn forget(adc: Adc) {
    adc.isr().write(|w| {
        w.set_eoc(true);
        w.set_eos(true);
        w.set_eosmp(true);
        w.set_ovr(true);
    });
}
