//! The first page of flash: starts the image, or the MCU's boot loader if the image is not whole.
//!
//! An update leaves this page alone, so that a board whose update was cut short can be updated again over the same cable. The
//! code may therefore never depend on the image behind it beyond [`image`](slitpose_firmware::image): it is the same in
//! every version.

use slitpose_firmware::image::{HEADER_BYTES, ImageHeader};

use crate::BOARD;

#[used]
#[allow(unsafe_code, reason = "a place for the linker, of which nothing else uses the name")]
#[unsafe(link_section = ".image_header")]
static HEADER: [u8; HEADER_BYTES] = ImageHeader::of_this_source(BOARD).encode();

// r4: the image. The block of SRAM that has the stack may lose its first access (ES0430, 2.2.7), so that it is read. A boot
// loader that jumps here leaves clocks and USB as it has used them (AN3156, "Leave DFU mode"), so that a reset comes first. A
// double word that a power cut has torn raises an NMI (RM0440, "ECC"), which returns to `boot_loader`.
#[allow(unsafe_code, reason = "code that runs ahead of the runtime, at an address of its own")]
mod stub {
    core::arch::global_asm!(
        ".syntax unified",
        ".section .boot_stub,\"ax\",%progbits",
        "    .word 0x20018000",
        "    .word boot_reset",
        "    .word boot_nmi",
        "    .word boot_nmi",
        ".type boot_reset,%function",
        ".thumb_func",
        "boot_reset:",
        "    ldr r0, =0x20014000",
        "    ldr r1, [r0]",
        // RCC_APB1ENR1.USBEN and RCC_CR.PLLON: not after a reset.
        "    ldr r0, =0x40021000",
        "    ldr r1, [r0, #0x58]",
        "    ldr r2, [r0]",
        "    lsrs r1, r1, #23",
        "    lsrs r2, r2, #24",
        "    orrs r1, r2",
        "    lsls r1, r1, #31",
        "    bne boot_again",
        "    ldr r4, =0x08000800",
        "    ldrd r5, r6, [r4]",
        "    ldr r0, [r4, #0x1f4]",
        // The end lies behind the header, and in the first bank.
        "    ldr r1, =0x08000a08",
        "    cmp r0, r1",
        "    blo boot_loader",
        "    ldr r1, =0x08040000",
        "    cmp r0, r1",
        "    bhi boot_loader",
        "    lsls r1, r0, #29",
        "    bne boot_loader",
        "    ldrd r2, r3, [r0, #-8]",
        "    dsb",
        "    isb",
        "    orrs r2, r3",
        "    bne boot_loader",
        // SCB_VTOR.
        "    ldr r0, =0xe000ed08",
        "    str r4, [r0]",
        "    dsb",
        "    mov sp, r5",
        "    bx r6",
        // SCB_AIRCR: SYSRESETREQ.
        "boot_again:",
        "    ldr r0, =0xe000ed0c",
        "    ldr r1, =0x05fa0004",
        "    str r1, [r0]",
        "    dsb",
        "    b .",
        // Clears the error (FLASH_ECCR), and returns to `boot_loader`.
        ".type boot_nmi,%function",
        ".thumb_func",
        "boot_nmi:",
        "    ldr r0, =0x40022018",
        "    ldr r1, [r0]",
        "    str r1, [r0]",
        "    ldr r1, [r0]",
        "    adr r0, boot_loader",
        "    str r0, [sp, #24]",
        "    dsb",
        "    bx lr",
        // The boot loader takes its vectors from address 0: system memory appears there (RM0440, SYSCFG_MEMRMP).
        "    .balign 4",
        "boot_loader:",
        "    ldr r0, =0x40021060",
        "    ldr r1, [r0]",
        "    orr r1, r1, #1",
        "    str r1, [r0]",
        "    ldr r1, [r0]",
        "    mov r0, #0x40000000",
        "    add r0, r0, #0x10000",
        "    movs r1, #1",
        "    str r1, [r0]",
        "    dsb",
        "    isb",
        "    ldr r0, =0x1fff0000",
        "    ldr r1, [r0]",
        "    mov sp, r1",
        "    ldr r0, [r0, #4]",
        "    bx r0",
        "    .ltorg",
        ".text",
    );
}
