//! Supply voltage and temperature, by the MCU's own reference and sensor on ADC5.
//!
//! A converter that works disturbs the others (ES0430, converters at work at the same time), so each conversion is
//! made in a pause of those that sample the cells. The first one after a pause of its own may be wrong
//! (see [`slitpose_firmware::pcb::frame_plan`]) and is not used.

use embassy_stm32::pac::adc::vals::SampleTime;
use embassy_stm32::peripherals::ADC5;
use embassy_stm32::{Peri, pac, rcc};
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_firmware::pcb::frame_plan::STALE_TICKS;

use crate::converters::{Unresponsive, enable, power_up};

/// Sampling time, 5.8 µs: the sensor needs 5 µs and the reference 4 µs (DS12288, t_S_temp and t_S_vrefint).
const SAMPLING: SampleTime = SampleTime::CYCLES247_5;

/// Ticks of a conversion: 2 periods of the converter's clock from the start, 260 to the end, and one in hand.
const CONVERSION_TICKS: u32 = 263 * 4;

/// Ticks from the look at the clock to the start of the conversion, at most: some eighty instructions from flash.
const LOOK_TICKS: u32 = 400;

/// Processor cycles until the sensor has started: 120 µs (DS12288, t_START of the temperature sensor).
const SENSOR_CYCLES: u32 = TICK_HZ / 1_000_000 * 120;

/// Ticks for which a pause is waited for: more than the default frame.
const PATIENCE_TICKS: u32 = TICK_HZ / 2_500;

/// Inputs of ADC5 (RM0440, ADC internal channels).
const SENSOR: u8 = 4;
const REFERENCE: u8 = 18;

/// Supply in volts at which the factory measured reference and sensor (DS12288, temperature sensor calibration).
const FACTORY_V: f32 = 3.0;

/// Temperatures in kelvin at which the factory measured the sensor (same place).
const FACTORY_K: [f32; 2] = [303.15, 403.15];

/// Addresses of the two sensor values in system memory.
const FACTORY_SENSOR: [*const u16; 2] = [0x1fff_75a8 as *const u16, 0x1fff_75ca as *const u16];

/// ADC5, its internal channels, and the factory's values.
pub struct Sensors {
    factory_reference: f32,
    factory_sensor: [f32; 2],
}

/// Readings of both sensors; NaN if they could not be read.
#[derive(Debug, Clone, Copy)]
pub struct Readings {
    pub supply_v: f32,
    /// Temperature of the MCU in kelvin.
    pub temperature_k: f32,
}

impl Sensors {
    /// Powers ADC5 up.
    pub fn new(_converter: Peri<'static, ADC5>) -> Self {
        rcc::enable_and_reset::<ADC5>();
        pac::ADC345_COMMON.ccr().modify(|w| {
            w.set_vrefen(true);
            w.set_vsenseen(true);
        });
        // A converter that does not come up gives no readings, and they say so.
        let _ = power_up(&[pac::ADC5], pac::ADC345_COMMON).and_then(|()| enable(pac::ADC5));
        pac::ADC5.smpr().write(|w| w.set_smp(SENSOR.into(), SAMPLING));
        pac::ADC5.smpr2().write(|w| w.set_smp(usize::from(REFERENCE) - 10, SAMPLING));
        cortex_m::asm::delay(SENSOR_CYCLES);
        // SAFETY: both are aligned addresses in the MCU's read-only system memory.
        #[allow(unsafe_code)]
        let factory_sensor = FACTORY_SENSOR.map(|value| f32::from(unsafe { value.read_volatile() }));
        Self { factory_reference: f32::from(pac::VREFINTCAL.data().read()), factory_sensor }
    }

    /// Measures both, each in a pause of the other converters: `pause_ticks` gives the ticks that are left of it.
    /// Takes some 20 µs while nothing else converts, and waits for each of three pauses for 0.4 ms at most; without one
    /// that is long enough by then there is no reading.
    pub fn read(&mut self, pause_ticks: impl FnMut() -> Option<u32>) -> Readings {
        let [supply_v, temperature_k] = self.try_read(pause_ticks).unwrap_or([f32::NAN; 2]);
        Readings { supply_v, temperature_k }
    }

    fn try_read(&mut self, mut pause_ticks: impl FnMut() -> Option<u32>) -> Option<[f32; 2]> {
        let mut last = None;
        let mut codes = [0.0; 3];
        for (code, input) in codes.iter_mut().zip([REFERENCE, REFERENCE, SENSOR]) {
            let started = start_in_pause(input, &mut pause_ticks)?;
            if last.is_some_and(|last| started.wrapping_sub(last) > STALE_TICKS) {
                return None;
            }
            last = Some(started);
            *code = f32::from(result().ok()?);
        }
        let [_, reference, sensor] = codes;
        let supply_v = FACTORY_V * self.factory_reference / reference.max(1.0);
        // The sensor does not follow the supply, the converter does.
        let at_factory_supply = sensor * supply_v / FACTORY_V;
        let [low, high] = self.factory_sensor;
        let share = (at_factory_supply - low) / (high - low);
        Some([supply_v, FACTORY_K[0] + share * (FACTORY_K[1] - FACTORY_K[0])])
    }
}

fn now() -> u32 {
    pac::TIM5.cnt().read()
}

/// Starts a conversion of `input` as soon as a pause is long enough; gives when.
fn start_in_pause(input: u8, pause_ticks: &mut impl FnMut() -> Option<u32>) -> Option<u32> {
    pac::ADC5.sqr1().write(|w| w.set_sq(0, input));
    let since = now();
    while now().wrapping_sub(since) < PATIENCE_TICKS {
        // No interrupt may come between the look and the start.
        let is_started = cortex_m::interrupt::free(|_| {
            let is_long_enough = pause_ticks().is_some_and(|left| left > CONVERSION_TICKS + LOOK_TICKS);
            if is_long_enough {
                pac::ADC5.cr().modify(|w| w.set_adstart(true));
            }
            is_long_enough
        });
        if is_started {
            return Some(now());
        }
    }
    None
}

fn result() -> Result<u16, Unresponsive> {
    let since = now();
    while !pac::ADC5.isr().read().eoc() {
        if now().wrapping_sub(since) > 2 * CONVERSION_TICKS {
            return Err(Unresponsive);
        }
    }
    Ok(pac::ADC5.dr().read().rdata())
}
