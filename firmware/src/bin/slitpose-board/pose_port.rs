//! Poses for a motor controller: a pin that toggles with each, and a [frame](slitpose_firmware::pose::frame) of each
//! over a serial port of its own: 5 Mbaud, eight bits, no parity, one stop bit; it only sends.
//!
//! The DMA sends the frame while the next scan is solved, 128 µs. To solve a pose takes longer, so that the line is free
//! for the next one; scans without a pose may follow one another faster. A frame that finds the line busy is not sent,
//! and the next one says so: nothing waits for the line.

use core::sync::atomic::{AtomicU32, Ordering, fence};

use embassy_stm32::crc::{Config as CrcConfig, Crc, InputReverseConfig, PolySize};
use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{CRC, DMA2_CH3, PA9, USART1};
use embassy_stm32::usart::{Config, UartTx};
use embassy_stm32::{Peri, pac};
use slitpose_firmware::SolvedPose;
use slitpose_firmware::pose::frame::{CHECKED_WORDS, FRAME_BYTES, FRAME_WORDS, frame};

use crate::clock::believed_baud;
use crate::dma::{Channel, Table};

/// 170 MHz / 34, without a rest; a byte takes 2 µs.
const BAUD: u32 = 5_000_000;

/// Request line of USART1_TX: RM0440, DMAMUX, assignment of multiplexer inputs.
const FRAME_DMA: Channel<true> = Channel::new(2, 25);

/// CRC-32/ISO-HDLC: bits of each word from the lowest on, all ones before the first and turned over at the end.
const POLYNOMIAL: u32 = 0x04c1_1db7;

static FRAME: [AtomicU32; FRAME_WORDS] = [const { AtomicU32::new(0) }; FRAME_WORDS];

pub struct PosePort {
    ready: Output<'static>,
    sender: Option<Sender>,
}

impl PosePort {
    /// The pin low and the line idle. If the port cannot be set up there is only the pin.
    pub fn new(
        ready: Output<'static>,
        port: Peri<'static, USART1>,
        tx: Peri<'static, PA9>,
        dma: Peri<'static, DMA2_CH3>,
        crc: Peri<'static, CRC>,
    ) -> Self {
        Self { ready, sender: Sender::new(port, tx, dma, crc) }
    }

    /// Toggles the pin and begins to send the frame of `pose`.
    #[inline]
    pub fn tell(&mut self, pose: &SolvedPose) {
        self.ready.toggle();
        if let Some(sender) = &mut self.sender {
            sender.send(pose);
        }
    }
}

struct Sender {
    _port: UartTx<'static, Blocking>,
    crc: Crc<'static>,
    /// Frames not sent or cut short since reset.
    unsent: u16,
}

impl Sender {
    /// `None` if the port or the checksum's unit refuses what it is asked for.
    fn new(
        port: Peri<'static, USART1>,
        tx: Peri<'static, PA9>,
        _dma: Peri<'static, DMA2_CH3>,
        crc: Peri<'static, CRC>,
    ) -> Option<Self> {
        let mut config = Config::default();
        config.baudrate = believed_baud(BAUD);
        let port = UartTx::new_blocking(port, tx, config).ok()?;
        let crc_config =
            CrcConfig::new(InputReverseConfig::Word, true, PolySize::Width32, u32::MAX, POLYNOMIAL).ok()?;
        pac::USART1.cr3().modify(|w| w.set_dmat(true));
        FRAME_DMA.prepare_once(pac::USART1.tdr().as_ptr().cast(), Table::of_bytes(&FRAME));
        Some(Self { _port: port, crc: Crc::new(crc, crc_config), unsent: 0 })
    }

    fn send(&mut self, pose: &SolvedPose) {
        let was_cut_short = FRAME_DMA.has_failed();
        // What the DMA has moved may still be in the port's FIFO, and leaves ahead of the next frame.
        let is_busy = FRAME_DMA.remaining() > 0;
        if is_busy {
            self.unsent = self.unsent.wrapping_add(1);
        }
        if is_busy && !was_cut_short {
            return;
        }
        let words = frame(pose, self.unsent, |words| self.checksum(words));
        for (place, word) in FRAME.iter().zip(words) {
            place.store(word, Ordering::Relaxed);
        }
        // The DMA reads what has been stored.
        fence(Ordering::Release);
        FRAME_DMA.run_once(FRAME_BYTES as u16);
    }

    fn checksum(&mut self, words: &[u32; CHECKED_WORDS]) -> u32 {
        self.crc.reset();
        self.crc.feed_words(words);
        !self.crc.read()
    }
}
