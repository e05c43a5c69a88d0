//! The image: the board's core over the parts of an STM32G474.
//!
//! Tasks share the core, and no task waits while it holds the core:
//!
//! * *polling* (the main task) collects when a batch is due, at least every millisecond,
//!   and feeds the watchdog;
//! * the *links* hand the bytes of the host to the core, and the bytes of the core to the
//!   host;
//! * *storage* writes the settings that the core keeps.
//!
//! Timers, converters and DMA meet all deadlines shorter than a millisecond: see
//! [`acquisition`].

#![no_std]
#![no_main]

mod acquisition;
mod boot_stub;
mod clock;
mod converters;
mod dma;
mod emitters;
mod faults;
mod guard;
mod hardware;
mod link;
mod memory;
#[cfg(feature = "pose")]
mod pose_port;
mod pulse;
#[cfg(feature = "sensors")]
mod sensors;
#[cfg(feature = "storage")]
mod storage;
mod trigger;

use core::cell::RefCell;

use embassy_executor::{Spawner, raw};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::rcc::{Hsi48Config, mux};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Config, bind_interrupts};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_time::{Duration, Instant, Timer};
use slitpose_firmware::pcb::{QUEUE_BYTES, can_run, default_configuration, default_scaling};
use slitpose_firmware::{Board, Identity, Poser, pin};
use slitpose_protocol::{BoardKind, Configuration, Hashes, SettingsSource};
use static_cell::{ConstStaticCell, StaticCell};

use crate::acquisition::Sampler;
use crate::hardware::BoardHardware;
use crate::link::Links;

#[cfg(feature = "defmt")]
use defmt_rtt as _;

#[cfg(not(any(feature = "usb", feature = "uart")))]
compile_error!("an image needs a link to its host: add the feature `usb` or `uart`");

bind_interrupts!(struct Interrupts {
    #[cfg(feature = "usb")]
    USB_LP => embassy_stm32::usb::InterruptHandler<embassy_stm32::peripherals::USB>;
    #[cfg(feature = "uart")]
    LPUART1 => embassy_stm32::usart::InterruptHandler<embassy_stm32::peripherals::LPUART1>;
    #[cfg(feature = "uart")]
    DMA2_CHANNEL1 => embassy_stm32::dma::InterruptHandler<embassy_stm32::peripherals::DMA2_CH1>;
    #[cfg(feature = "uart")]
    DMA2_CHANNEL2 => embassy_stm32::dma::InterruptHandler<embassy_stm32::peripherals::DMA2_CH2>;
    #[cfg(feature = "storage")]
    FLASH => embassy_stm32::flash::InterruptHandler;
});

/// The board's core, shared by the tasks.
type Core = Mutex<ThreadModeRawMutex, RefCell<Board<BoardHardware, &'static mut [u8], &'static mut Poser>>>;

/// The board that the image is for.
const BOARD: &str = "NUCLEO-G474RE";

/// The watchdog resets the board when it has not been polled for this long.
const WATCHDOG_US: u32 = 100_000;

/// Failed starts in a row after which stored settings are passed over.
const PATIENCE_STARTS: u32 = 3;

/// A start has gone well when the core has been polled for this long.
const STARTED: Duration = Duration::from_secs(1);

/// The core is polled at least this often.
const POLL: Duration = Duration::from_millis(1);

#[cortex_m_rt::entry]
fn main() -> ! {
    static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
    // embassy's own executor of this core has this context, by which a task that wakes ends WFE; and no barrier.
    let executor = EXECUTOR.init(raw::Executor::new(usize::MAX as *mut ()));
    if let Ok(task) = run(executor.spawner()) {
        executor.spawner().spawn(task);
    }
    loop {
        // SAFETY: called nowhere else.
        #[allow(unsafe_code)]
        unsafe {
            executor.poll();
        }
        cortex_m::asm::wfe();
        // What is fetched behind WFE may be wrong if a debugger keeps the clocks on in sleep (ES0430, 2.2.8).
        cortex_m::asm::isb();
    }
}

#[embassy_executor::task]
async fn run(spawner: Spawner) {
    let reset_cause = faults::reset_cause();
    memory::guard_stack();
    let failed_starts = faults::failed_starts(reset_cause);
    let p = embassy_stm32::init(config());
    let clock = clock::raise();
    faults::running(failed_starts);
    let emitters = [
        Output::new(pin!(p.gate_of_emitter_0), Level::Low, Speed::Medium),
        Output::new(pin!(p.gate_of_emitter_1), Level::Low, Speed::Medium),
        Output::new(pin!(p.gate_of_emitter_2), Level::Low, Speed::Medium),
        Output::new(pin!(p.gate_of_emitter_3), Level::Low, Speed::Medium),
        Output::new(pin!(p.gate_of_emitter_4), Level::Low, Speed::Medium),
        Output::new(pin!(p.gate_of_emitter_5), Level::Low, Speed::Medium),
    ];
    guard::watch_supply();

    #[cfg(feature = "storage")]
    let (store, settings) = storage::open(p.FLASH).unzip();
    #[cfg(feature = "storage")]
    let stored = settings.flatten();
    #[cfg(not(feature = "storage"))]
    let stored: Option<slitpose_firmware::settings::Settings> = None;
    // Stored settings may be what keeps the board from starting.
    let is_passed_over = stored.is_some() && failed_starts >= PATIENCE_STARTS;
    let settings = stored.filter(|_| !is_passed_over);

    let hardware = BoardHardware::new(
        emitters::Emitters::new(emitters, Output::new(pin!(p.emitter_supply), Level::High, Speed::Low), p.DAC1, p.DAC2),
        Sampler::new(p.ADC1, p.ADC2, p.TIM2, p.TIM3, p.DMA1_CH1, pulse::FrameOutput::new(pin!(p.frame_output), p.TIM1)),
        clock::Clock::start(p.TIM5),
        trigger::Trigger::new(pin!(p.trigger_input)),
        Output::new(pin!(p.light_ld2), Level::Low, Speed::Low),
        #[cfg(feature = "sensors")]
        sensors::Sensors::new(p.ADC5),
        #[cfg(feature = "pose")]
        pose_port::PosePort::new(
            Output::new(pin!(p.pose_ready), Level::Low, Speed::Medium),
            p.USART1,
            pin!(p.pose_output),
            p.DMA2_CH3,
            p.CRC,
        ),
    );
    let full_scale_pa = settings.as_ref().and_then(|settings| settings.full_scale_pa);
    let hashes = settings.as_ref().map_or(Hashes::default(), |settings| settings.hashes);
    // Another firmware may have left settings that this board cannot run.
    let configuration = settings.map(|settings| settings.configuration).filter(can_run);
    let identity = Identity {
        device_id: embassy_stm32::uid::uid(),
        kind: BoardKind::Physical,
        board: BOARD,
        reset_cause,
        hashes,
        scaling: default_scaling(),
        full_scale_pa,
        clock,
        settings: match &configuration {
            _ if is_passed_over => SettingsSource::PassedOver,
            Some(_) => SettingsSource::Stored,
            None => SettingsSource::Defaults,
        },
    };
    let core = make_core(hardware, identity, configuration.unwrap_or_else(default_configuration));
    #[cfg(all(feature = "pose", feature = "storage"))]
    if !is_passed_over {
        storage::with_head(|head| core.lock(|core| core.borrow_mut().restore_head(head)));
    }
    static LINKS: StaticCell<Links> = StaticCell::new();
    let links: &'static Links = LINKS.init_with(|| Links::new(core));

    #[cfg(feature = "usb")]
    link::usb::spawn(spawner, links, p.USB, pin!(p.usb_dp), pin!(p.usb_dm));
    #[cfg(feature = "uart")]
    link::uart::spawn(spawner, links, p.LPUART1, pin!(p.serial_rx), pin!(p.serial_tx), p.DMA2_CH1, p.DMA2_CH2);
    #[cfg(feature = "storage")]
    if let Some(Ok(task)) = store.map(storage::keep) {
        spawner.spawn(task);
    }

    let mut watchdog = IndependentWatchdog::new(p.IWDG, WATCHDOG_US);
    watchdog.unleash();
    let started = Instant::now();
    let mut has_started_well = false;
    loop {
        let next = links.poll();
        watchdog.pet();
        if !has_started_well && started.elapsed() >= STARTED {
            has_started_well = true;
            faults::started_well();
        }
        Timer::after(next.min(POLL)).await;
    }
}

/// The core, where it stays. Apart, because its way there takes more stack than all that comes later.
#[inline(never)]
fn make_core(hardware: BoardHardware, identity: Identity, configuration: Configuration) -> &'static Core {
    static QUEUE: ConstStaticCell<[u8; QUEUE_BYTES]> = ConstStaticCell::new([0; QUEUE_BYTES]);
    static CORE: StaticCell<Core> = StaticCell::new();
    static POSER: StaticCell<Poser> = StaticCell::new();
    let queue: &'static mut [u8] = QUEUE.take();
    let poser = POSER.init_with(Poser::default);
    let Ok(board) = Board::with_poser(hardware, identity, configuration, queue, poser) else {
        faults::give_up();
    };
    CORE.init_with(|| Mutex::new(RefCell::new(board)))
}

/// Configuration for the start: the MCU runs at 16 MHz, and USB from an oscillator of its own, trimmed by the host's
/// frames.
fn config() -> Config {
    let mut config = Config::default();
    config.rcc.hsi48 = Some(Hsi48Config { sync_from_usb: true });
    config.rcc.mux.clk48sel = mux::Clk48sel::HSI48;
    config.rcc.mux.lpuart1sel = mux::Uartsel::SYS;
    // The processor's load is measured by its cycle counter, which stands still in sleep.
    // With a debugger attached the counter runs on and the load reads full.
    config.enable_debug_during_sleep = cfg!(feature = "defmt");
    config
}
