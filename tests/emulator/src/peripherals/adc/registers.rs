//! Registers, their bits, and times in them.

use super::super::{TICKS_PER_SECOND, Ticks};

pub(super) const ISR: u32 = 0x00;
pub(super) const IER: u32 = 0x04;
pub(super) const CR: u32 = 0x08;
pub(super) const CFGR: u32 = 0x0C;
pub(super) const CFGR2: u32 = 0x10;
pub(super) const SMPR1: u32 = 0x14;
pub(super) const SMPR2: u32 = 0x18;
pub(super) const TR1: u32 = 0x20;
pub(super) const TR3: u32 = 0x28;
pub(super) const SQR1: u32 = 0x30;
pub(super) const SQR4: u32 = 0x3C;
pub(super) const DR: u32 = 0x40;
pub(super) const DIFSEL: u32 = 0xB0;
pub(super) const CALFACT: u32 = 0xB4;
/// Registers common to a group of converters, from the group's base.
pub(super) const COMMON: u32 = 0x300;
pub(super) const CSR: u32 = COMMON;
pub(super) const CCR: u32 = COMMON + 0x08;

pub(super) const ADRDY: u32 = 1;
pub(super) const EOSMP: u32 = 1 << 1;
pub(super) const EOC: u32 = 1 << 2;
pub(super) const EOS: u32 = 1 << 3;
pub(super) const OVR: u32 = 1 << 4;

pub(super) const ADEN: u32 = 1;
pub(super) const ADDIS: u32 = 1 << 1;
pub(super) const ADSTART: u32 = 1 << 2;
pub(super) const JADSTART: u32 = 1 << 3;
pub(super) const ADSTP: u32 = 1 << 4;
pub(super) const JADSTP: u32 = 1 << 5;
pub(super) const ADVREGEN: u32 = 1 << 28;
pub(super) const DEEPPWD: u32 = 1 << 29;
pub(super) const ADCALDIF: u32 = 1 << 30;
pub(super) const ADCAL: u32 = 1 << 31;
/// Bits of ADC_CR that software only sets and hardware clears.
pub(super) const CR_COMMANDS: u32 = ADEN | ADDIS | ADSTART | JADSTART | ADSTP | JADSTP | ADCAL;

pub(super) const DMAEN: u32 = 1;
pub(super) const OVRMOD: u32 = 1 << 12;
pub(super) const CONT: u32 = 1 << 13;
/// DMAEN, DMACFG, RES, EXTSEL, EXTEN, OVRMOD, CONT, and JQDIS (set after reset).
pub(super) const CFGR_MODELLED: u32 = 0x8000_3FFF & !(1 << 2);
pub(super) const ROVSE: u32 = 1;
/// ROVSE, OVSR, OVSS and ROVSM (without injected conversions both modes are the same).
pub(super) const CFGR2_MODELLED: u32 = ROVSE | 0b111 << 2 | 0b1111 << 5 | 1 << 10;
/// CKMODE, PRESC, and the switches of the internal channels.
pub(super) const CCR_MODELLED: u32 = 0b11 << 16 | 0b1111 << 18 | 0b111 << 22;
pub(super) const CCR_CLOCK: u32 = 0b11 << 16 | 0b1111 << 18;

/// Twice the sampling time in converter clocks, by SMP code.
pub(super) const SAMPLE_HALF_CLOCKS: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// Twice the duration of the successive approximation in clocks, by RES code.
pub(super) const APPROXIMATION_HALF_CLOCKS: [u64; 4] = [25, 21, 17, 13];
pub(super) const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
/// Trigger to start of sampling, in clocks.
pub(super) const TRIGGER_CLOCKS: u64 = 2;
/// Calibration, in clocks (STM32G474 data sheet, "ADC characteristics", t_CAL).
pub(super) const CALIBRATION_CLOCKS: u64 = 116;
/// From ADEN to ADRDY: one conversion (data sheet, t_STAB), in clocks.
pub(super) const STABILISATION_CLOCKS: u64 = 15;
/// From ADSTP or ADDIS to the end of the command, in clocks.
pub(super) const STOP_CLOCKS: u64 = 2;
/// Wait between ADCAL cleared and ADEN, in clocks (RM0440, "Software procedure to enable the ADC").
pub(super) const CALIBRATION_TO_ENABLE_CLOCKS: u64 = 4;
/// Start-up of the regulator: 20 µs (data sheet, t_ADCVREG_STUP).
pub(super) const REGULATOR_TICKS: Ticks = 3_400;
/// Fault adc-stale: a conversion this long after the one before is wrong.
pub(super) const STALE_TICKS: Ticks = TICKS_PER_SECOND / 1_000;
/// Fault adc-stale: by so many codes.
pub(super) const STALE_CODES: u16 = 700;
/// Fault adc-neighbour: the most codes that a conversion is off by.
pub(super) const NEIGHBOUR_CODES: u64 = 8;
/// Shortest clock period in ticks that the converter follows (60 MHz).
pub(super) const SHORTEST_CLOCK_TICKS: u64 = 3;
