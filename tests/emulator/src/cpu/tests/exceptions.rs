//! Entry and return, priorities, faults, sleep; registers of the private peripheral bus.

use super::*;

/// bx lr, nop, sev, wfe, cpsid i
const BX_LR: u16 = 0x4770;
const NOP: u16 = 0xbf00;
const SEV: u16 = 0xbf40;
const WFE: u16 = 0xbf20;
const CPSID_I: u16 = 0xb672;
const CPSIE_I: u16 = 0xb662;
/// b to itself
const STAY: u16 = 0xe7fe;

impl Board {
    fn enable(&mut self, interrupt: u8, priority: u8) {
        self.cpu.nvic.enabled |= 1 << (16 + interrupt);
        self.cpu.nvic.set_priority(16 + interrupt, priority);
    }

    /// Takes interrupt 0, number 16; gives the cycles.
    fn interrupt(&mut self) -> u32 {
        self.enable(0, 0);
        self.lines(&[0]);
        let cycles = self.run(1);
        self.lines(&[]);
        cycles
    }

    fn lines(&mut self, interrupts: &[u32]) {
        let mut lines = [0; 4];
        for interrupt in interrupts {
            lines[*interrupt as usize / 32] |= 1 << (interrupt % 32);
        }
        self.cpu.set_lines(&lines);
    }
}

#[test]
fn entry_stacks_eight_words_aligned_and_return_restores_them() {
    let mut board = Board::new(&[NOP]).with_handler(16, &[0x2000, BX_LR]); // movs r0, #0; bx lr
    for (number, value) in [(0, 10), (1, 11), (2, 12), (3, 13), (12, 22), (13, STACK - 4), (14, 0x0800_0555)] {
        board.set(number, value);
    }
    assert_eq!(board.interrupt(), 12);
    // 0x7fc − 0x20 = 0x7dc, aligned down to 0x7d8, and bit 9 of the stacked xPSR says so.
    let frame = STACK - 0x28;
    assert_eq!(board.r(13), frame);
    let stacked: Vec<u32> = (0..8).map(|n| board.word(frame + 4 * n)).collect();
    assert_eq!(stacked, [10, 11, 12, 13, 22, 0x0800_0555, PROGRAM, 0x0100_0200]);
    assert_eq!((board.r(14), board.r(15), board.cpu.exception()), (0xffff_fff9, HANDLERS + 16 * 64, 16));
    board.run(1);
    assert_eq!(board.r(0), 0);
    assert_eq!(board.run(1), 1 + 10);
    assert_eq!((board.r(0), board.r(13), board.r(14), board.r(15)), (10, STACK - 4, 0x0800_0555, PROGRAM));
    assert_eq!(board.cpu.exception(), 0);
}

#[test]
fn the_float_frame_follows_the_basic_one() {
    // msr control, r1 (FPCA)
    let mut board = Board::new(&[0xf381, 0x8814]).with_float();
    (board.cpu.float.s[0], board.cpu.float.s[15]) = (0x1111, 0x2222);
    board.set(1, 4);
    board.run(1);
    board.interrupt();
    let frame = STACK - 0x68;
    assert_eq!((board.r(13), board.r(14)), (frame, 0xffff_ffe9));
    assert_eq!((board.word(frame + 0x20), board.word(frame + 0x5c)), (0x1111, 0x2222));
    assert!(!board.cpu.registers.float_active);
    board.cpu.float.s[0] = 0x3333;
    board.run(1);
    assert_eq!((board.r(13), board.cpu.state().s[0]), (STACK, 0x1111));
    assert!(board.cpu.registers.float_active);
}

#[test]
fn lazy_stacking_is_paid_on_first_use() {
    // The handler: vmov.f32 s0, s1; bx lr.
    let mut board = Board::new(&[NOP]).with_handler(16, &[0xeeb0, 0x0a60, BX_LR]).with_float();
    board.cpu.registers.float_active = true;
    assert_eq!([board.interrupt(), board.run(1), board.run(1)], [12, 1 + 17, 1 + 10 + 17]);
    let mut board = Board::new(&[NOP]).with_float();
    board.cpu.registers.float_active = true;
    assert_eq!([board.interrupt(), board.run(1)], [12, 11]);
}

#[test]
fn urgent_interrupts_preempt_and_equal_ones_follow() {
    let mut board = Board::new(&[STAY]);
    board.enable(1, 0x80);
    board.enable(2, 0x40);
    board.enable(3, 0x80);
    board.lines(&[1]);
    board.run(1);
    assert_eq!(board.cpu.exception(), 17);
    board.lines(&[2, 3]); // the line of 1 has fallen; 2 preempts, 3 waits
    assert_eq!(board.run(1), 12);
    assert_eq!(board.cpu.exception(), 18);
    board.lines(&[3]);
    board.run(1); // return from 2 into 1
    assert_eq!(board.cpu.exception(), 17);
    assert_eq!(board.run(1), 1 + 6, "3 is tail-chained");
    assert_eq!((board.cpu.exception(), board.r(14)), (19, 0xffff_fff9));
    board.lines(&[]);
    board.run(1);
    assert_eq!((board.cpu.exception(), board.r(13)), (0, STACK));
}

#[test]
fn a_line_that_stays_high_comes_again() {
    let mut board = Board::new(&[STAY]);
    board.enable(0, 0);
    board.lines(&[0]);
    board.run(2);
    assert_eq!(board.cpu.exception(), 16, "tail-chained into itself");
}

#[test]
fn masks_delay_interrupts() {
    let mut board = Board::new(&[CPSID_I, NOP, CPSIE_I, NOP]);
    board.enable(0, 0);
    board.run(1);
    board.lines(&[0]);
    board.run(2);
    assert_eq!(board.cpu.exception(), 0);
    board.run(1);
    assert_eq!(board.cpu.exception(), 16);
    // NMI does not care.
    let mut board = Board::new(&[CPSID_I, NOP]);
    board.run(1);
    board.cpu.raise_nmi();
    board.run(1);
    assert_eq!(board.cpu.exception(), 2);
}

#[test]
fn faults_escalate_to_hardfault() {
    let mut board = Board::new(&[0xde00]); // udf
    board.run(1);
    assert_eq!(board.cpu.exception(), 3);
    assert_eq!(board.fault(), Some(Fault::Undefined { first: 0xde00, second: 0 }));
    assert_eq!(board.cpu.system.cfsr, 1 << 16);
    assert_eq!(board.word(STACK - 8), PROGRAM, "the stacked address is that of the instruction");
}

#[test]
fn bus_faults_are_told_and_lock_up_in_a_hardfault() {
    let mut board = after(&[0x6808], [0, 0x5000_0000, 0, 0, 0], 1); // ldr r0, [r1]
    assert_eq!(board.fault(), Some(Fault::DataBus { address: 0x5000_0000 }));
    assert_eq!(board.cpu.system.cfsr, 1 << 9);
    board.place(HANDLERS + 3 * 64, &[0x6808]);
    board.cpu.invalidate_code();
    assert!(matches!(board.step(), Step::Lockup(_)), "a fault in HardFault");
    assert!(matches!(board.step(), Step::Lockup(_)), "for good");
}

#[test]
fn kinds_of_faults() {
    let fault = |program: &[u16], r1| after(program, [0, r1, 0, 0, 0], 1).fault();
    assert_eq!(fault(&[0xe9d1, 0x0200], RAM + 2), Some(Fault::Unaligned { address: RAM + 2 })); // ldrd
    assert_eq!(fault(&[0xf8d1, 0x0001], 0x4000_0000), Some(Fault::Unaligned { address: 0x4000_0001 })); // ldr
    assert_eq!(fault(&[0xee10, 0x0f10], 0), Some(Fault::NoCoprocessor)); // mrc p15
    // bx r1 to an even address faults at the target.
    let mut board = after(&[0x4708], [0, RAM, 0, 0, 0], 2);
    assert_eq!((board.fault(), board.word(STACK - 8)), (Some(Fault::InvalidState), RAM));
    // bx r1 into the peripherals.
    let board = after(&[0x4708], [0, 0x4000_0001, 0, 0, 0], 2);
    assert_eq!(board.fault(), Some(Fault::FetchNeverExecute { address: 0x4000_0000 }));
}

#[test]
fn a_stack_that_is_not_there_is_a_hardfault() {
    let mut board = Board::new(&[NOP]);
    board.set(13, 0x3000_0000);
    board.interrupt();
    assert_eq!(board.cpu.exception(), 3);
    assert_eq!(board.fault(), Some(Fault::Stacking { address: 0x2fff_ffe0 }));
}

#[test]
fn returns_are_checked() {
    // A handler that returns to handler mode though nothing is below it: bx r0.
    let mut board = Board::new(&[NOP]).with_handler(16, &[0x4700]);
    board.set(0, 0xffff_fff1);
    board.interrupt();
    board.run(1);
    assert_eq!(board.fault(), Some(Fault::InvalidReturn { value: 0xffff_fff1 }));
    assert_eq!((board.cpu.exception(), board.r(14)), (3, 0xffff_fff1));
}

#[test]
fn events_wake_once() {
    let mut board = Board::new(&[SEV, WFE, WFE, NOP]);
    board.run(3); // the first WFE takes the event of SEV
    assert_eq!([board.step(), board.step()], [Step::Asleep; 2]);
    board.enable(0, 0);
    board.lines(&[0]);
    board.run(1);
    assert_eq!(board.cpu.exception(), 16);
    board.lines(&[]);
    board.run(2);
    assert_eq!(board.r(15), PROGRAM + 8);
}

impl Board {
    fn poke(&mut self, address: u32, value: u32) {
        self.cpu.write_private(address, Size::Word, value);
    }

    fn peek(&mut self, address: u32) -> u32 {
        self.cpu.read_private(address, Size::Word)
    }
}

#[test]
fn interrupts_are_enabled_pended_and_given_priorities() {
    let mut board = Board::new(&[0xe7fe]);
    board.poke(0xe000_e108, 1 << 3); // ISER2: interrupt 67
    board.cpu.write_private(0xe000_e400 + 67, Size::Byte, 0x5f);
    assert_eq!(board.peek(0xe000_e108), 1 << 3);
    assert_eq!(board.peek(0xe000_e400 + 64), 0x5000_0000, "four bits of priority");
    board.poke(0xe000_e208, 1 << 3);
    assert_eq!(board.peek(0xe000_e208), 1 << 3);
    board.poke(0xe000_e288, 1 << 3);
    board.poke(0xe000_e188, 1 << 3);
    assert_eq!((board.peek(0xe000_e208), board.peek(0xe000_e108)), (0, 0));
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
    let [store, load, push] = [0x600a, 0x6808, 0xb401]; // str r2, [r1]; ldr r0, [r1]; push {r0}
    let end = RAM + 0x400;
    for (program, r1, sp, expected, status) in [
        (store, end - 4, STACK, Some(Fault::Guarded { address: end - 4 }), 0x02),
        (load, end - 0x200, STACK, Some(Fault::Guarded { address: end - 0x200 }), 0x02),
        // Its own fault's frame finds no place either.
        (push, 0, end, Some(Fault::StackingGuarded { address: end - 0x20 }), 0x12),
        // The frame of an interrupt.
        (NOP, 0, end + 0x10, Some(Fault::StackingGuarded { address: end - 0x10 }), 0x10),
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
            if program == NOP {
                board.interrupt();
            } else {
                board.run(1);
            }
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
fn unprivileged_code_and_the_process_stack_are_not_modelled() {
    for control in [1, 2] {
        let board = after(&[0xf380, 0x8814], [control, 0, 0, 0, 0], 1); // msr control, r0
        assert_eq!(board.fault(), Some(Fault::Undefined { first: 0xf380, second: 0x8814 }));
    }
}
