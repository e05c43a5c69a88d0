//! The link over the debugger's serial port: 3 Mbaud, eight bits, no parity, one stop bit.
//!
//! No line of the port shows whether a host listens. The link is open while commands come,
//! at least one within [`SILENCE`]; noise and probes of other host programs are no commands.

use embassy_executor::Spawner;
use embassy_stm32::Peri;
use embassy_stm32::gpio::Pull;
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA2_CH1, DMA2_CH2, LPUART1, PA2, PA3};
use embassy_stm32::usart::{Config, RingBufferedUartRx, Uart, UartTx};
use embassy_time::{Duration, Instant, with_deadline};
use slitpose_firmware::TRANSMIT_BYTES;
use slitpose_protocol::{Decoder, FrameError, MAX_REQUEST_BYTES, Request};
use static_cell::StaticCell;

use super::{Links, Port, start};
use crate::Interrupts;
use crate::clock::believed_baud;

/// 4 000 frames of 60 bytes a second take 2.4 Mbaud.
const BAUD: u32 = 3_000_000;

/// A host that sends no command for this long has gone.
const SILENCE: Duration = Duration::from_secs(2);

/// Bytes that may arrive between two reads: more than the longest command.
const RING_BYTES: usize = 512;

/// Sets the port up and starts its tasks. If that fails, the board has one link fewer.
pub fn spawn(
    spawner: Spawner,
    links: &'static Links,
    port: Peri<'static, LPUART1>,
    rx: Peri<'static, PA3>,
    tx: Peri<'static, PA2>,
    tx_dma: Peri<'static, DMA2_CH1>,
    rx_dma: Peri<'static, DMA2_CH2>,
) {
    let mut config = Config::default();
    config.baudrate = believed_baud(BAUD);
    // The pull-up keeps the line idle while the debugger is not powered.
    config.rx_pull = Pull::Up;
    let Ok(uart) = Uart::new(port, rx, tx, tx_dma, rx_dma, Interrupts, config) else {
        return;
    };
    let (sender, receiver) = uart.split();
    static RING: StaticCell<[u8; RING_BYTES]> = StaticCell::new();
    let receiver = receiver.into_ring_buffered(RING.init([0; RING_BYTES]));
    start(spawner, send(links, sender));
    start(spawner, receive(links, receiver));
}

#[embassy_executor::task]
async fn send(links: &'static Links, mut sender: UartTx<'static, Async>) {
    let mut buffer = [0; TRANSMIT_BYTES];
    loop {
        let bytes = links.transmit(Port::Uart, &mut buffer).await;
        // Fails only for a wrong configuration, which `spawn` has refused.
        let _ = sender.write(bytes).await;
    }
}

/// Whether a command ends in `bytes`, known to this firmware or not.
fn holds_command(probe: &mut Decoder<MAX_REQUEST_BYTES>, mut bytes: &[u8]) -> bool {
    let mut found = false;
    while let Some(packet) = probe.next::<Request>(&mut bytes) {
        found |= matches!(packet, Ok(_) | Err(FrameError::Payload(_)));
    }
    found
}

#[embassy_executor::task]
async fn receive(links: &'static Links, mut receiver: RingBufferedUartRx<'static>) {
    let mut bytes = [0; 64];
    let mut deadline = Instant::now() + SILENCE;
    let mut probe = Decoder::new();
    loop {
        match with_deadline(deadline, receiver.read(&mut bytes)).await {
            Ok(Ok(length)) => {
                let bytes = &bytes[..length];
                // The first command opens the link. If it is not whole in these bytes it is
                // lost, and the host asks again.
                if !links.owns(Port::Uart) && holds_command(&mut probe, bytes) {
                    links.claim(Port::Uart);
                }
                if links.receive(Port::Uart, bytes) {
                    deadline = Instant::now() + SILENCE;
                }
            }
            // Noise or an overrun of the ring: damaged commands fail by their checksum.
            Ok(Err(_)) => {}
            Err(_) => {
                links.release(Port::Uart);
                deadline = Instant::now() + SILENCE;
            }
        }
    }
}
