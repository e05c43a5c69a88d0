//! Registers of the private peripheral bus.

use super::*;

impl Board {
    fn poke(&mut self, address: u32, value: u32) {
        self.cpu.write_private(address, Size::Word, value).unwrap();
    }

    fn peek(&mut self, address: u32) -> u32 {
        self.cpu.read_private(address, Size::Word).unwrap()
    }
}

#[test]
fn interrupts_are_enabled_pended_and_given_priorities() {
    let mut board = Board::new(&[0xe7fe]);
    board.poke(0xe000_e108, 1 << 3); // ISER2: interrupt 67
    board.cpu.write_private(0xe000_e400 + 67, Size::Byte, 0x5f).unwrap();
    assert_eq!(board.peek(0xe000_e108), 1 << 3);
    assert_eq!(board.peek(0xe000_e400 + 64), 0x5000_0000, "four bits of priority");
    board.poke(0xe000_ef00, 67); // STIR
    assert_eq!(board.peek(0xe000_e208), 1 << 3);
    assert_eq!(board.peek(0xe000_ed04), 1 << 22 | 83 << 12 | 1 << 11); // ICSR
    board.poke(0xe000_e288, 1 << 3);
    board.poke(0xe000_e188, 1 << 3);
    assert_eq!((board.peek(0xe000_e208), board.peek(0xe000_e108)), (0, 0));
}

#[test]
fn pendsv_comes_when_nothing_is_more_urgent() {
    let mut board = Board::new(&[0xbf00, 0xbf00]);
    board.poke(0xe000_ed20, 0xf0 << 16);
    board.poke(0xe000_ed04, 1 << 28);
    board.run(1);
    assert_eq!((board.cpu.exception(), board.peek(0xe000_ed04) & 0x1ff), (14, 14));
}

#[test]
fn reset_needs_its_key() {
    let mut board = Board::new(&[0xe7fe]);
    board.poke(0xe000_ed0c, 4);
    board.run(1);
    board.poke(0xe000_ed0c, 0x05fa_0004);
    assert_eq!([board.step(), board.step()], [Step::ResetRequested; 2]);
    board.cpu.reset(&mut board.memory);
    board.run(1);
}

#[test]
fn the_cycle_counter_counts_executed_cycles() {
    let mut board = Board::new(&[0xbf00, 0xe7fd]); // nop; b back: four cycles
    board.poke(0xe000_edfc, 1 << 24);
    board.poke(0xe000_1004, 100);
    board.poke(0xe000_1000, 1);
    board.run(20);
    assert_eq!(board.peek(0xe000_1004), 140);
    board.poke(0xe000_1000, 0);
    board.run(20);
    assert_eq!(board.peek(0xe000_1004), 140);
}

#[test]
fn a_guarded_region_allows_no_data_access_but_to_a_hardfault() {
    let [store, load, push, svc] = [0x600a, 0x6808, 0xb401, 0xdf00]; // str r2, [r1]; ldr r0, [r1]; push {r0}; svc
    let end = RAM + 0x400;
    for (program, r1, sp, expected, status) in [
        (store, end - 4, STACK, Some(Fault::Guarded { address: end - 4 }), 0x82),
        (load, end - 0x200, STACK, Some(Fault::Guarded { address: end - 0x200 }), 0x82),
        // Its own fault's frame finds no place either.
        (push, 0, end, Some(Fault::StackingGuarded { address: end - 0x20 }), 0x92),
        (svc, 0, end + 0x10, Some(Fault::StackingGuarded { address: end - 0x10 }), 0x10),
        (store, end, STACK, None, 0),
        (store, end - 0x204, STACK, None, 0),
    ] {
        for control in [0, 0b101] {
            let mut board = Board::new(&[program]).with_handler(3, &[store]);
            board.poke(0xe000_ed9c, (end - 0x200) | 1 << 4);
            board.poke(0xe000_eda0, 1 << 28 | 8 << 1 | 1); // 512 bytes
            board.poke(0xe000_ed94, control);
            board.set(1, r1);
            board.set(13, sp);
            board.run(1);
            let (expected, status) = if control == 0 { (None, 0) } else { (expected, status) };
            assert_eq!((board.fault(), board.cpu.system.cfsr), (expected, status), "{program:#x}, {control}");
            if expected.is_some() {
                board.set(1, end - 4);
                board.run(1);
                assert_eq!((board.cpu.exception(), board.fault()), (3, expected));
            }
        }
    }
}

#[test]
fn unprivileged_code_has_no_access() {
    // msr control, r0 (nPRIV); ldr r0, [r1]
    let board = after(&[0xf380, 0x8814, 0x6808], [1, 0xe000_ed00, 0, 0, 0], 2);
    assert_eq!(board.fault(), Some(Fault::DataBus { address: 0xe000_ed00 }));
}

#[test]
fn identification_and_unmodelled_registers() {
    let mut board = Board::new(&[0xe7fe]);
    assert_eq!(board.peek(0xe000_ed00), 0x410f_c241);
    assert_eq!(board.peek(0xe00f_f000), 0);
    board.poke(0xe000_0e80, 1);
    assert_eq!(board.cpu.read_private(0xe000_ed02, Size::Half).unwrap(), 0x410f);
}
