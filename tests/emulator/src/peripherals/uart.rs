//! The serial ports LPUART1 and USART1, and the lines to their other ends (RM0440, "Low-power universal
//! asynchronous receiver transmitter", "Universal synchronous/asynchronous receiver transmitter").
//!
//! Eight data bits without parity, one stop bit, no flow control, oversampling by 16, no prescaler; the kernel clock runs at the
//! core's 170 MHz, as PCLK and SYSCLK do. The other end talks at the rate that BRR sets. FIFOs, when
//! they are on, are one byte deep here: a program that moves bytes by DMA cannot tell.

use crate::st::USART::{
    BRR, CR1, CR1_FIFOEN, CR1_IDLEIE, CR1_RE, CR1_RXNEIE_RXFNEIE as CR1_RXNEIE, CR1_TCIE, CR1_TE,
    CR1_TXEIE_TXFNFIE as CR1_TXEIE, CR1_UE, CR2, CR3, CR3_DMAR, CR3_DMAT, CR3_EIE, CR3_OVRDIS, ICR, ISR, ISR_BUSY,
    ISR_IDLE, ISR_REACK, ISR_RXNE_RXFNE as ISR_RXNE, ISR_TC, ISR_TEACK, ISR_TXE_TXFNF as ISR_TXE, PRESC, RDR, TDR,
};
use crate::st::{self, LL, LPUART, USART};
use std::collections::VecDeque;

use super::effects::{ALL, Bank, Register};
use super::{Effects, Ticks};

const CR1_MODELLED: u32 = CR1_UE | CR1_RE | CR1_TE | CR1_IDLEIE | CR1_RXNEIE | CR1_TCIE | CR1_TXEIE | CR1_FIFOEN;
const CR3_MODELLED: u32 = CR3_EIE | CR3_DMAR | CR3_DMAT | CR3_OVRDIS;

/// A start bit, eight data bits and a stop bit.
const FRAME_BITS: u64 = 10;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SentByte {
    /// The end of its last stop bit.
    pub at: Ticks,
    pub byte: u8,
}

/// What the two kinds of port do not share.
#[derive(Debug, PartialEq)]
struct Kind {
    /// Parts of a period of the divided clock in a unit of BRR.
    divider_parts: u64,
    divider_mask: u32,
    interrupt: u32,
    receive: u32,
    transmit: u32,
}

/// A bit is BRR/256 periods (RM0440, "LPUART baud rate generation").
const LPUART1: Kind = Kind {
    divider_parts: LPUART::BRR_factor as u64,
    divider_mask: USART::BRR_LPUART,
    interrupt: st::LPUART1::IRQn,
    receive: LL::DMAMUX_REQ_LPUART1_RX,
    transmit: LL::DMAMUX_REQ_LPUART1_TX,
};

/// A bit is BRR periods (RM0440, "USART baud rate generation").
const USART1: Kind = Kind {
    divider_parts: USART::BRR_factor as u64,
    divider_mask: USART::BRR_BRR,
    interrupt: st::USART1::IRQn,
    receive: LL::DMAMUX_REQ_USART1_RX,
    transmit: LL::DMAMUX_REQ_USART1_TX,
};

const REGISTERS: &[Register] = &[
    (CR1, 1, 0, CR1_MODELLED),
    (CR2, 1, 0, 0),
    (CR3, 1, 0, CR3_MODELLED),
    (BRR, 1, 0, ALL),
    (ICR, 1, 0, 0),
    (PRESC, 1, 0, 0),
];

#[derive(Debug)]
pub struct Uart {
    kind: &'static Kind,
    is_heard: bool,
    bank: Bank,
    /// IDLE and TC.
    flags: u32,
    /// TDR: waiting for the shift register.
    to_send: Option<u8>,
    /// What is on the line until when; no byte: the idle frame ahead of the first one.
    sending: Option<(Option<u8>, Ticks)>,
    sent: Vec<SentByte>,
    /// RDR.
    received: Option<u8>,
    last_received: u8,
    /// What the other end has still to send; the first is on the line.
    incoming: VecDeque<u8>,
    /// The end of the byte on the line.
    arrives_at: Option<Ticks>,
    /// The end of an idle frame behind the last byte.
    idle_at: Option<Ticks>,
}

impl Uart {
    /// LPUART1 after power-on, and somebody at its other end.
    pub fn lpuart1() -> Self {
        Self { is_heard: true, ..Self::new(&LPUART1) }
    }

    /// USART1 after power-on. What it sends is lost until somebody [listens](Self::listen).
    pub fn usart1() -> Self {
        Self::new(&USART1)
    }

    fn new(kind: &'static Kind) -> Self {
        Self {
            kind,
            is_heard: false,
            bank: Bank::new(REGISTERS),
            flags: ISR_TC,
            to_send: None,
            sending: None,
            sent: Vec::new(),
            received: None,
            last_received: 0,
            incoming: VecDeque::new(),
            arrives_at: None,
            idle_at: None,
        }
    }

    /// From now on what has left is kept until it is [taken](Self::take_sent).
    pub fn listen(&mut self) {
        self.is_heard = true;
    }

    /// State after reset. What has left stays with the other end.
    pub fn reset(&mut self, effects: &mut Effects) {
        *self = Self { sent: std::mem::take(&mut self.sent), is_heard: self.is_heard, ..Self::new(self.kind) };
        self.update(effects);
    }

    /// Lets the other end send `bytes`, behind those it is still sending. They are lost if the
    /// receiver is off.
    pub fn send(&mut self, bytes: &[u8], effects: &Effects) {
        if !self.receives() || bytes.is_empty() {
            return;
        }
        if self.incoming.is_empty() {
            self.arrives_at = Some(effects.now + self.frame_ticks());
            self.idle_at = None;
        }
        self.incoming.extend(bytes);
    }

    /// Bytes that have left the port since the last call, in order.
    pub fn take_sent(&mut self) -> Vec<SentByte> {
        std::mem::take(&mut self.sent)
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            ISR => self.status(),
            RDR => {
                if let Some(byte) = self.received.take() {
                    self.last_received = byte;
                    self.update(effects);
                }
                u32::from(self.last_received)
            }
            _ => self.bank.read(offset, effects),
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR1 => self.write_cr1(value, effects),
            BRR => self.bank[BRR] = value & self.kind.divider_mask,
            ICR => self.flags &= !value,
            TDR => {
                if self.to_send.is_some() {
                    effects.violation(value, "UART: TDR written while TXE is 0");
                }
                self.to_send = Some(value as u8);
                self.flags &= !ISR_TC;
                self.start_sending(effects.now);
            }
            _ => self.bank.write(offset, value, effects),
        }
        self.update(effects);
    }

    /// When a byte has left or arrived, or the line has been idle, for the next time.
    pub fn next_event(&self) -> Ticks {
        let sent = self.sending.map(|(_, end)| end);
        [sent, self.arrives_at, self.idle_at].into_iter().flatten().min().unwrap_or(Ticks::MAX)
    }

    pub fn advance(&mut self, effects: &mut Effects) {
        let now = effects.now;
        if let Some((byte, end)) = self.sending
            && end <= now
        {
            self.sending = None;
            if let Some(byte) = byte {
                if self.is_heard {
                    self.sent.push(SentByte { at: now, byte });
                }
                if self.to_send.is_none() {
                    self.flags |= ISR_TC;
                }
            }
            self.start_sending(now);
        }
        if self.arrives_at.is_some_and(|at| at <= now) {
            self.arrive(effects);
        }
        if self.idle_at.is_some_and(|at| at <= now) {
            self.idle_at = None;
            self.flags |= ISR_IDLE;
        }
        self.update(effects);
    }

    fn write_cr1(&mut self, value: u32, effects: &mut Effects) {
        let (sent, received) = (self.sends(), self.receives());
        self.bank.write(CR1, value, effects);
        if value & CR1_UE == 0 {
            self.flags = ISR_TC;
            self.to_send = None;
            self.received = None;
        }
        if !self.sends() {
            self.sending = None;
        } else if !sent {
            self.sending = Some((None, effects.now + self.frame_ticks()));
        }
        if received && !self.receives() {
            self.incoming.clear();
            (self.arrives_at, self.idle_at) = (None, None);
        }
    }

    fn sends(&self) -> bool {
        self.bank[CR1] & (CR1_UE | CR1_TE) == CR1_UE | CR1_TE
    }

    fn receives(&self) -> bool {
        self.bank[CR1] & (CR1_UE | CR1_RE) == CR1_UE | CR1_RE
    }

    /// Time of a byte with its start and stop bits.
    fn frame_ticks(&self) -> Ticks {
        (FRAME_BITS * u64::from(self.bank[BRR])).div_ceil(self.kind.divider_parts)
    }

    fn start_sending(&mut self, now: Ticks) {
        if self.sends()
            && self.sending.is_none()
            && let Some(byte) = self.to_send.take()
        {
            self.sending = Some((Some(byte), now + self.frame_ticks()));
        }
    }

    /// The byte on the line is complete.
    fn arrive(&mut self, effects: &mut Effects) {
        let Some(byte) = self.incoming.pop_front() else {
            return;
        };
        if self.received.is_none() || self.bank[CR3] & CR3_OVRDIS != 0 {
            self.received = Some(byte);
        } else {
            // The new byte is lost, the old one stays.
            effects.violation(byte.into(), "UART: a byte has come before the one ahead of it was fetched");
        }
        let next = effects.now + self.frame_ticks();
        let more = !self.incoming.is_empty();
        (self.arrives_at, self.idle_at) = if more { (Some(next), None) } else { (None, Some(next)) };
    }

    fn status(&self) -> u32 {
        let on = |bit: u32, is: bool| if is { bit } else { 0 };
        self.flags
            | on(ISR_TXE, self.to_send.is_none())
            | on(ISR_RXNE, self.received.is_some())
            | on(ISR_BUSY, self.arrives_at.is_some())
            | on(ISR_TEACK, self.sends())
            | on(ISR_REACK, self.receives())
    }

    /// Interrupt line and DMA requests follow from the flags.
    fn update(&self, effects: &mut Effects) {
        let status = self.status();
        let own = [(CR1_TXEIE, ISR_TXE), (CR1_TCIE, ISR_TC), (CR1_RXNEIE, ISR_RXNE), (CR1_IDLEIE, ISR_IDLE)];
        let raised = own.iter().any(|&(enable, flags)| self.bank[CR1] & enable != 0 && status & flags != 0);
        effects.set_line(self.kind.interrupt, raised);
        let mut ask = |request, wanted| if wanted { effects.request(request) } else { effects.withdraw(request) };
        ask(self.kind.transmit, self.sends() && self.bank[CR3] & CR3_DMAT != 0 && status & ISR_TXE != 0);
        ask(self.kind.receive, self.bank[CR3] & CR3_DMAR != 0 && status & ISR_RXNE != 0);
    }
}
