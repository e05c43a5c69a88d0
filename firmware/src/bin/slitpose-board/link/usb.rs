//! The link over the MCU's own USB: a serial port (CDC-ACM) of full speed.
//!
//! The link is open while the host holds DTR, the device is configured and the bus is
//! awake. No line senses the cable; a bus without frames counts as asleep.

use core::cell::Cell;

use embassy_executor::Spawner;
use embassy_futures::select::{Either, select, select3};
use embassy_stm32::Peri;
use embassy_stm32::pac::USB as REGISTERS;
use embassy_stm32::peripherals::{PA11, PA12, USB};
use embassy_stm32::usb::Driver;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::{CriticalSectionRawMutex, ThreadModeRawMutex};
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::{Builder, Config, Handler, UsbDevice};
use slitpose_firmware::TRANSMIT_BYTES;
use static_cell::StaticCell;

use super::{Links, Port, start};
use crate::Interrupts;

/// Bytes of a packet at full speed.
const PACKET: usize = 64;

/// USB numbers for tests and private use (pid.codes, 0x1209/0x0001). Boards for sale need a
/// number of their own.
const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;

/// The driver sees within a few milliseconds what happens on the bus. After 2,048 ms frames have the same numbers again.
const LOOK_EVERY: Duration = Duration::from_millis(50);

type Bus = Driver<'static, USB>;

/// Whether the device is configured and the bus awake.
static IS_AWAKE: Mutex<CriticalSectionRawMutex, Cell<bool>> = Mutex::new(Cell::new(false));
static IS_SUSPENDED: Mutex<CriticalSectionRawMutex, Cell<bool>> = Mutex::new(Cell::new(false));
static WAKING: Signal<ThreadModeRawMutex, ()> = Signal::new();
static CLOSED: Signal<ThreadModeRawMutex, ()> = Signal::new();

/// Sets the device up and starts its tasks.
pub fn spawn(
    spawner: Spawner,
    links: &'static Links,
    usb: Peri<'static, USB>,
    plus: Peri<'static, PA12>,
    minus: Peri<'static, PA11>,
) {
    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("slitpose");
    config.product = Some("slitpose board");
    config.serial_number = Some(embassy_stm32::uid::uid_hex());
    // In milliamperes; the emitters have another supply.
    config.max_power = 100;

    static CONFIGURATION: StaticCell<[u8; 128]> = StaticCell::new();
    static OBJECTS: StaticCell<[u8; 16]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; PACKET]> = StaticCell::new();
    static STATE: StaticCell<State> = StaticCell::new();
    static WATCH: StaticCell<Watch> = StaticCell::new();
    let mut builder = Builder::new(
        Driver::new(usb, Interrupts, plus, minus),
        config,
        CONFIGURATION.init([0; 128]),
        OBJECTS.init([0; 16]),
        &mut [],
        CONTROL.init([0; PACKET]),
    );
    builder.handler(WATCH.init(Watch { is_configured: false, is_suspended: false }));
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let (sender, receiver, control) = class.split_with_control();
    start(spawner, device(builder.build()));
    start(spawner, open(links, control));
    start(spawner, send(links, sender));
    start(spawner, receive(links, receiver));
}

struct Watch {
    is_configured: bool,
    is_suspended: bool,
}

impl Watch {
    fn tell(&self) {
        let is_awake = self.is_configured && !self.is_suspended;
        IS_AWAKE.lock(|cell| cell.set(is_awake));
        IS_SUSPENDED.lock(|cell| cell.set(self.is_suspended));
        WAKING.signal(());
    }
}

impl Handler for Watch {
    fn enabled(&mut self, _enabled: bool) {
        self.is_suspended = false;
        self.tell();
    }

    fn reset(&mut self) {
        (self.is_configured, self.is_suspended) = (false, false);
        self.tell();
    }

    fn configured(&mut self, configured: bool) {
        self.is_configured = configured;
        self.tell();
    }

    fn suspended(&mut self, suspended: bool) {
        self.is_suspended = suspended;
        self.tell();
    }
}

/// Runs the device, anew where its driver has missed something: it waits without end for the rest of a control transfer
/// that the host has broken off, and looks at the bus no more. What the interrupts have noted meanwhile is seen then.
#[embassy_executor::task]
async fn device(mut device: UsbDevice<'static, Bus>) -> ! {
    loop {
        match select(device.run(), missed()).await {
            Either::First(never) => never,
            Either::Second(Missed::Rest) => {}
            // Leaves the suspension.
            Either::Second(Missed::Waking) => device.disable().await,
        }
    }
}

/// What the driver may have missed.
enum Missed {
    /// A reset of the bus, or that it is silent: nothing is under way on it, and to run the device anew does no harm.
    Rest,
    /// That the bus is awake: of a suspension, a resumption and a reset it sees the suspension last.
    Waking,
}

async fn missed() -> Missed {
    let frame = || REGISTERS.fnr().read().fn_();
    loop {
        let (before, was_suspended) = (frame(), IS_SUSPENDED.lock(Cell::get));
        Timer::after(LOOK_EVERY).await;
        // A reset switches the device off (RM0440, USB_DADDR), and the driver switches it on again.
        if frame() == before || !REGISTERS.daddr().read().ef() {
            return Missed::Rest;
        }
        if was_suspended && IS_SUSPENDED.lock(Cell::get) {
            return Missed::Waking;
        }
    }
}

#[embassy_executor::task]
async fn open(links: &'static Links, control: ControlChanged<'static>) {
    loop {
        if control.dtr() && IS_AWAKE.lock(Cell::get) {
            links.claim(Port::Usb);
            CLOSED.reset();
        } else {
            links.release(Port::Usb);
            CLOSED.signal(());
        }
        select3(control.control_changed(), WAKING.wait(), links.freed.wait()).await;
    }
}

#[embassy_executor::task]
async fn send(links: &'static Links, mut sender: Sender<'static, Bus>) {
    let mut buffer = [0; TRANSMIT_BYTES];
    loop {
        let bytes = links.transmit(Port::Usb, &mut buffer).await;
        // A full packet does not end a USB transfer: the host waits for a shorter one.
        let ends_full = bytes.len().is_multiple_of(PACKET);
        let end: &[&[u8]] = if ends_full { &[&[]] } else { &[] };
        for packet in bytes.chunks(PACKET).chain(end.iter().copied()) {
            // A host that has gone does not fetch the packet.
            match select(sender.write_packet(packet), CLOSED.wait()).await {
                Either::First(Ok(())) => {}
                Either::First(Err(_)) | Either::Second(()) => break,
            }
        }
    }
}

#[embassy_executor::task]
async fn receive(links: &'static Links, mut receiver: Receiver<'static, Bus>) {
    let mut packet = [0; PACKET];
    loop {
        match receiver.read_packet(&mut packet).await {
            // The first command may come before `open` has seen DTR.
            Ok(length) => {
                if receiver.dtr() && IS_AWAKE.lock(Cell::get) && links.claim(Port::Usb) {
                    links.receive(Port::Usb, &packet[..length]);
                }
            }
            Err(_) => receiver.wait_connection().await,
        }
    }
}
