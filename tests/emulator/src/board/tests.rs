//! The wires between the peripherals, driven through the bus as a program drives them.

use super::*;
use crate::cpu::Size;

const RCC: u32 = 0x4002_1000;
const FLASH_ACR: u32 = 0x4002_2000;
const TIM2: u32 = 0x4000_0000;
const PWR: u32 = 0x4000_7000;
const GPIOC: u32 = 0x4800_0800;

fn board() -> Board {
    let mut board = Board::new(FlashArray::erased(), None);
    put(&mut board, RCC + 0x48, 0x107);
    put(&mut board, RCC + 0x4C, 0x0003_607F);
    put(&mut board, RCC + 0x58, 0x1000_000F);
    put(&mut board, RCC + 0x60, 1);
    board
}

fn put(board: &mut Board, address: u32, value: u32) {
    board.write(address, Size::Word, value).unwrap();
}

fn get(board: &mut Board, address: u32) -> u32 {
    board.read(address, Size::Word).unwrap()
}

#[test]
fn an_unclocked_peripheral_neither_hears_nor_answers() {
    let mut board = Board::new(FlashArray::erased(), None);
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
