//! Supply voltage and temperature, by the MCU's own reference and sensor on ADC5.

use embassy_stm32::adc::{Adc, AdcConfig, SampleTime, Temperature, VrefInt};
use embassy_stm32::peripherals::ADC5;
use embassy_stm32::{Peri, pac};

/// Sampling time: the sensor needs 5 µs (data sheet, t_S_temp).
const SAMPLING: SampleTime = SampleTime::CYCLES640_5;

/// Supply in volts at which the factory measured reference and sensor (data sheet,
/// temperature sensor calibration).
const FACTORY_V: f32 = 3.0;

/// Temperatures in kelvin at which the factory measured the sensor (same place).
const FACTORY_K: [f32; 2] = [303.15, 403.15];

/// Addresses of the two sensor values in system memory.
const FACTORY_SENSOR: [*const u16; 2] = [0x1fff_75a8 as *const u16, 0x1fff_75ca as *const u16];

/// ADC5, its internal channels, and the factory's values.
pub struct Sensors {
    adc: Adc<'static, ADC5>,
    reference: VrefInt,
    sensor: Temperature,
    factory_reference: f32,
    factory_sensor: [f32; 2],
}

/// Readings of both sensors.
#[derive(Debug, Clone, Copy)]
pub struct Readings {
    /// Supply voltage in volts.
    pub supply_v: f32,
    /// Temperature of the MCU in kelvin.
    pub temperature_k: f32,
}

impl Sensors {
    /// Powers ADC5 up.
    pub fn new(adc: Peri<'static, ADC5>) -> Self {
        let adc = Adc::new(adc, AdcConfig::default());
        let reference = adc.enable_vrefint();
        let sensor = adc.enable_temperature();
        // SAFETY: both are aligned addresses in the MCU's read-only system memory.
        #[allow(unsafe_code)]
        let factory_sensor = FACTORY_SENSOR.map(|value| f32::from(unsafe { value.read_volatile() }));
        Self { adc, reference, sensor, factory_reference: f32::from(pac::VREFINTCAL.data().read()), factory_sensor }
    }

    /// Measures both; takes some 40 µs.
    pub fn read(&mut self) -> Readings {
        let reference = f32::from(self.adc.blocking_read(&mut self.reference, SAMPLING)).max(1.0);
        let sensor = f32::from(self.adc.blocking_read(&mut self.sensor, SAMPLING));
        let supply_v = FACTORY_V * self.factory_reference / reference;
        // The sensor does not follow the supply, the converter does.
        let at_factory_supply = sensor * supply_v / FACTORY_V;
        let [low, high] = self.factory_sensor;
        let share = (at_factory_supply - low) / (high - low);
        Readings { supply_v, temperature_k: FACTORY_K[0] + share * (FACTORY_K[1] - FACTORY_K[0]) }
    }
}
