//! Memory before anything runs, and the end of the stack; of images that solve poses also faster copies.

use cortex_m::peripheral::MPU;

/// Below RAM: the last 32 KiB of what is kept for system memory and option bytes, of which the firmware uses nothing.
const GUARD: u32 = 0x1fff_8000;
const GUARD_BYTES: u32 = 0x8000;

/// From now on a stack that leaves its place (`stack.x`) is a fault: below it all accesses are forbidden.
#[allow(unsafe_code, reason = "registers that nothing else uses; the firmware has nothing in the region")]
pub fn guard_stack() {
    // DDI0403, B3.5: VALID and region 0; XN, no access, 2^(SIZE + 1) bytes, on; PRIVDEFENA, on.
    // SAFETY: see above.
    unsafe {
        let mpu = &*MPU::PTR;
        mpu.rbar.write(GUARD | 1 << 4);
        mpu.rasr.write(1 << 28 | (GUARD_BYTES.trailing_zeros() - 1) << 1 | 1);
        mpu.ctrl.write(1 << 2 | 1);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

// The first access to a block of SRAM after a reset may be taken for a read, and a write be lost (ES0430, 2.2.7): each
// block has one here that may be. Blocks that may be checked for parity are written, twice, to a word whose content does
// not matter yet; the others are read. Then the solver's code goes to CCM SRAM (`ccm.x` says which, if any).
#[allow(unsafe_code, reason = "a symbol that the runtime calls; it keeps the rules of the ABI")]
mod start {
    core::arch::global_asm!(
        ".syntax unified",
        ".section .text.__pre_init,\"ax\",%progbits",
        ".global __pre_init",
        ".type __pre_init,%function",
        ".thumb_func",
        "__pre_init:",
        "    mov r1, #0x20000000",
        "    mov r2, #0x10000000",
        "    str r0, [r1]",
        "    str r0, [r2]",
        "    dsb",
        "    str r0, [r1]",
        "    str r0, [r2]",
        "    add r1, r1, #0x8000",
        "    ldr r0, [r1]",
        "    add r1, r1, #0x8000",
        "    ldr r0, [r1]",
        "    add r1, r1, #0x4000",
        "    ldr r0, [r1]",
        "    ldr r0, =__siccm",
        "    ldr r1, =__sccm",
        "    ldr r2, =__eccm",
        "1:  cmp r1, r2",
        "    bhs 2f",
        "    ldr r3, [r0], #4",
        "    str r3, [r1], #4",
        "    b 1b",
        "2:  dsb",
        "    isb",
        "    bx lr",
        "    .ltorg",
        ".text",
    );
}

// The runtime's own copies of memory take six cycles a word; a pose takes five kilobytes of them.
#[cfg(feature = "pose")]
#[allow(unsafe_code, reason = "symbols that the compiler calls; they keep the rules of the ABI")]
mod copies {
    core::arch::global_asm!(
        ".syntax unified",
        // (to, from, bytes), aligned or not: single loads and stores need no alignment.
        ".section .text.__aeabi_memcpy,\"ax\",%progbits",
        ".global __aeabi_memcpy",
        ".type __aeabi_memcpy,%function",
        ".thumb_func",
        "__aeabi_memcpy:",
        "    subs r2, r2, #8",
        "    blo 2f",
        "1:  ldr r3, [r1], #4",
        "    ldr r12, [r1], #4",
        "    str r3, [r0], #4",
        "    str r12, [r0], #4",
        "    subs r2, r2, #8",
        "    bhs 1b",
        "2:  adds r2, r2, #8",
        "    beq 4f",
        "3:  ldrb r3, [r1], #1",
        "    strb r3, [r0], #1",
        "    subs r2, r2, #1",
        "    bne 3b",
        "4:  bx lr",
        // (to, from, bytes), both aligned to words.
        ".section .text.__aeabi_memcpy4,\"ax\",%progbits",
        ".global __aeabi_memcpy4",
        ".global __aeabi_memcpy8",
        ".type __aeabi_memcpy4,%function",
        ".type __aeabi_memcpy8,%function",
        ".thumb_func",
        "__aeabi_memcpy4:",
        ".thumb_func",
        "__aeabi_memcpy8:",
        "    subs r2, r2, #32",
        "    blo 2f",
        "    push {{r4-r10}}",
        "1:  ldmia r1!, {{r3-r10}}",
        "    stmia r0!, {{r3-r10}}",
        "    subs r2, r2, #32",
        "    bhs 1b",
        "    pop {{r4-r10}}",
        "2:  adds r2, r2, #28",
        "    bmi 4f",
        "3:  ldr r3, [r1], #4",
        "    str r3, [r0], #4",
        "    subs r2, r2, #4",
        "    bpl 3b",
        "4:  adds r2, r2, #4",
        "    beq 6f",
        "5:  ldrb r3, [r1], #1",
        "    strb r3, [r0], #1",
        "    subs r2, r2, #1",
        "    bne 5b",
        "6:  bx lr",
        // (to, bytes), aligned to words.
        ".section .text.__aeabi_memclr4,\"ax\",%progbits",
        ".global __aeabi_memclr4",
        ".global __aeabi_memclr8",
        ".type __aeabi_memclr4,%function",
        ".type __aeabi_memclr8,%function",
        ".thumb_func",
        "__aeabi_memclr4:",
        ".thumb_func",
        "__aeabi_memclr8:",
        "    movs r2, #0",
        "    movs r3, #0",
        "    mov r12, r2",
        "    subs r1, r1, #16",
        "    blo 2f",
        "    push {{r4}}",
        "    mov r4, r2",
        "1:  stmia r0!, {{r2, r3, r4, r12}}",
        "    subs r1, r1, #16",
        "    bhs 1b",
        "    pop {{r4}}",
        "2:  adds r1, r1, #12",
        "    bmi 4f",
        "3:  str r2, [r0], #4",
        "    subs r1, r1, #4",
        "    bpl 3b",
        "4:  adds r1, r1, #4",
        "    beq 6f",
        "5:  strb r2, [r0], #1",
        "    subs r1, r1, #1",
        "    bne 5b",
        "6:  bx lr",
        ".text",
    );
}
