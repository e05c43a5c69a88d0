//! The wires between the peripherals, driven through the bus as a program drives them.

use super::*;
use crate::cpu::{Bus, BusFault, Size};
use crate::facts;
use crate::memory::{CCM_BASE, RAM_BASE};
use crate::peripherals::TICKS_PER_SECOND;

const RCC: u32 = 0x4002_1000;
const FLASH_ACR: u32 = 0x4002_2000;
const TIM2: u32 = 0x4000_0000;
const PWR: u32 = 0x4000_7000;
const GPIOC: u32 = 0x4800_0800;
const DAC1_DHR12R1: u32 = 0x5000_0808;
/// Remembers what it is asked and told.
#[derive(Debug, Default)]
struct Recorder {
    drives: Vec<(Ticks, u8, [u16; 2])>,
    samples: u64,
    last_sample: Ticks,
}

impl World for Recorder {
    fn drive(&mut self, now: Ticks, gates: u8, level_codes: [u16; 2]) {
        assert!(now >= self.last_sample);
        self.drives.push((now, gates, level_codes));
    }

    fn sample(&mut self, now: Ticks, adc: u8, channel: u8) -> u16 {
        assert!(now >= self.last_sample && self.drives.last().is_none_or(|drive| drive.0 <= now));
        self.last_sample = now;
        self.samples += 1;
        100 * u16::from(adc) + u16::from(channel)
    }
}

fn board() -> Board<Recorder> {
    let mut board = Board::new(FlashArray::erased(), Recorder::default());
    put(&mut board, RCC + 0x48, 0x107);
    put(&mut board, RCC + 0x4C, 0x0003_607F);
    put(&mut board, RCC + 0x58, 0x1000_000F);
    put(&mut board, RCC + 0x60, 1);
    board
}

fn put(board: &mut Board<Recorder>, address: u32, value: u32) {
    board.write(address, Size::Word, value).unwrap();
}

fn get(board: &mut Board<Recorder>, address: u32) -> u32 {
    board.read(address, Size::Word).unwrap()
}

fn wait(board: &mut Board<Recorder>, ticks: Ticks) {
    let end = board.now() + ticks;
    board.advance_to(end);
}

#[test]
fn a_narrow_write_fills_all_lanes_and_a_narrow_read_takes_one() {
    let mut board = board();
    board.write(DAC1_DHR12R1, Size::Half, 0x0ABC).unwrap();
    assert_eq!(get(&mut board, DAC1_DHR12R1), 0xABC);
    assert_eq!(board.read(0x1FFF_75CA, Size::Half), Ok(u32::from(TS_CAL2)));
    board.write(GPIOC + 0x14, Size::Byte, 0x81).unwrap();
    assert_eq!(board.read(GPIOC + 0x15, Size::Byte), Ok(0x81));
}

#[test]
fn memories_have_their_aliases_and_ends() {
    let mut board = board();
    put(&mut board, CCM_BASE + 4, 77);
    assert_eq!(get(&mut board, RAM_BASE + 0x1_8004), 77);
    assert_eq!(get(&mut board, 0), u32::MAX);
    assert_eq!(board.read(RAM_BASE + RAM_BYTES as u32, Size::Word), Err(BusFault));
    assert_eq!(board.read(RAM_BASE + RAM_BYTES as u32 - 2, Size::Word), Err(BusFault));
    assert_eq!(board.write(0x6000_0000, Size::Word, 0), Err(BusFault));
    assert_eq!(board.write(0x1FFF_7590, Size::Word, 0), Err(BusFault));
}

#[test]
fn an_unclocked_peripheral_neither_hears_nor_answers() {
    let mut board = Board::new(FlashArray::erased(), Recorder::default());
    put(&mut board, GPIOC + 0x14, 1);
    assert_eq!(get(&mut board, GPIOC), 0);
    assert_eq!(
        board.effects.violations.iter().map(|violation| violation.address).collect::<Vec<_>>(),
        [GPIOC + 0x14, GPIOC]
    );
    put(&mut board, 0x4000_6800, 1);
    assert_eq!(board.effects.unmodelled.get(&0x4000_6800), Some(&1));
}

#[test]
fn a_reset_bit_resets_its_peripheral_once() {
    let mut board = board();
    put(&mut board, TIM2 + 0x2C, 99);
    put(&mut board, TIM2 + 0x400 + 0x2C, 99);
    put(&mut board, RCC + 0x38, 1);
    put(&mut board, RCC + 0x38, 0);
    assert_eq!(get(&mut board, TIM2 + 0x2C), u32::MAX);
    assert_eq!(get(&mut board, TIM2 + 0x400 + 0x2C), 99);
}

#[test]
fn the_pll_needs_boost_and_wait_states() {
    let pll = 2 | 3 << 4 | 85 << 8 | 1 << 24;
    let select = |prepared: bool| {
        let mut board = board();
        put(&mut board, RCC + 0x0C, pll);
        put(&mut board, RCC, 1 << 8 | 1 << 24);
        if prepared {
            put(&mut board, PWR + 0x80, 0);
            put(&mut board, FLASH_ACR, 4);
        }
        put(&mut board, RCC + 8, 8 << 4 | 3);
        board.effects.now += 170;
        put(&mut board, RCC + 8, 3);
        board.effects.violation_count
    };
    assert_eq!((select(true), select(false)), (0, 2));
}

#[test]
fn supply_clock_and_sensors_are_those_of_the_data_sheet() {
    assert_eq!(BROWN_OUT_V, facts::number("V_BOR0_falling"));
    assert_eq!(BACKUP_V, facts::number("V_BAT_least"));
    assert_eq!(LATENCY_AT_170_MHZ, facts::bits("wait_states_170_MHz"));
    assert_eq!(TICKS_PER_SECOND as f64, 1e6 * facts::number("f_HCLK"));
    assert_eq!(CALIBRATION_V, facts::number("calibration_supply"));
    let at_calibration = ["TS_CAL1", "TS_CAL2"].map(|name| {
        let temperature_c = facts::number(&format!("{name}_temperature"));
        let sensor = facts::bits("LL_ADC_CHANNEL_TEMPSENSOR_ADC5") as u8;
        internal_code(sensor, CALIBRATION_V, temperature_c)
    });
    assert_eq!(at_calibration, [TS_CAL1, TS_CAL2]);
    let reference = facts::bits("LL_ADC_CHANNEL_VREFINT") as u8;
    assert_eq!(internal_code(reference, CALIBRATION_V, 0.0), VREFINT_CAL);
}

#[test]
fn a_debugger_halts_the_timers_of_st_s_bits() {
    for (name, index) in [("TIM2", 0), ("TIM5", 3)] {
        let mut board = board();
        for base in ["TIM2_BASE", "TIM5_BASE"] {
            put(&mut board, facts::bits(base), 1);
        }
        wait(&mut board, 100);
        board.halt_timers(facts::bits(&format!("DBGMCU_APB1FZR1_DBG_{name}_STOP")));
        let before = [0, 3].map(|timer| get(&mut board, facts::bits("TIM2_BASE") + 0x400 * timer + 0x24));
        wait(&mut board, 100);
        let after = [0, 3].map(|timer| get(&mut board, facts::bits("TIM2_BASE") + 0x400 * timer + 0x24));
        let stands = [before[0] == after[0], before[1] == after[1]];
        assert_eq!(stands, [index == 0, index == 3], "{name}");
    }
}
