//! Settings in the flash memory's second bank, written while the firmware runs from the
//! first.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::flash::{Async, Bank2Region, Flash};
use embassy_stm32::peripherals::FLASH;
use embassy_stm32::{Peri, pac};
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_sync::signal::Signal;
use slitpose_firmware::StorageError;
use slitpose_firmware::settings::{self, Append, PAGE_BYTES, Pages, Settings};
use static_cell::ConstStaticCell;

use crate::Interrupts;

type Bank = Bank2Region<'static, Async>;

/// The settings to keep next; `None`: forget.
static WANTED: Signal<ThreadModeRawMutex, Option<Settings>> = Signal::new();

/// How the last write ended.
static DONE: Signal<ThreadModeRawMutex, Result<(), StorageError>> = Signal::new();

/// Times that a record is written before the store has failed.
const ATTEMPTS: usize = 2;

/// The pages are being read: see [`is_reading`].
static IS_READING: AtomicBool = AtomicBool::new(false);

/// A copy of the two pages.
static PAGES: ConstStaticCell<Pages> = ConstStaticCell::new([[0; PAGE_BYTES]; 2]);

/// The memory, and the copy of its pages.
pub struct Store {
    bank: Bank,
    pages: &'static mut Pages,
}

/// Whether there is a second bank: without it the firmware itself occupies the pages.
static HAS_BANK: AtomicBool = AtomicBool::new(false);

/// Opens the memory and reads the settings kept there; `None` without a second bank.
pub fn open(flash: Peri<'static, FLASH>) -> Option<(Store, Option<Settings>)> {
    if !pac::FLASH.optr().read().dbank() {
        return None;
    }
    HAS_BANK.store(true, Ordering::Relaxed);
    let bank = Flash::new(flash, Interrupts).into_regions().bank2_region;
    let mut store = Store { bank, pages: PAGES.take() };
    let settings = if store.load() { settings::stored(store.pages) } else { None };
    Some((store, settings))
}

/// Whether the pages are being read, so that an error of the flash memory is one of the settings.
pub fn is_reading() -> bool {
    IS_READING.load(Ordering::SeqCst)
}

/// Begins to keep `settings`, or with `None` to forget the settings kept.
pub fn begin(settings: Option<Settings>) {
    DONE.reset();
    if HAS_BANK.load(Ordering::Relaxed) {
        WANTED.signal(settings);
    } else {
        DONE.signal(Err(StorageError));
    }
}

/// How the last write ended; `None` while it is under way.
pub fn poll() -> Option<Result<(), StorageError>> {
    DONE.try_take()
}

/// Keeps the settings given to [`begin`], one after the other.
#[embassy_executor::task]
pub async fn keep(mut store: Store) {
    loop {
        let settings = WANTED.wait().await;
        DONE.signal(store.keep(settings.as_ref()).await);
    }
}

impl Store {
    fn load(&mut self) -> bool {
        IS_READING.store(true, Ordering::SeqCst);
        let mut offset = 0;
        let is_read = self.pages.iter_mut().all(|page| {
            let read = self.bank.blocking_read(offset, page);
            offset += PAGE_BYTES as u32;
            read.is_ok()
        });
        // An error of the last words is reported before the mark is taken away.
        cortex_m::asm::dsb();
        IS_READING.store(false, Ordering::SeqCst);
        is_read
    }

    async fn keep(&mut self, settings: Option<&Settings>) -> Result<(), StorageError> {
        if !self.load() {
            return Err(StorageError);
        }
        let mut append = settings::append(self.pages, settings);
        for _ in 0..ATTEMPTS {
            self.carry_out(&append).await;
            // Only reading back proves the write: the driver's interrupt clears the error flags
            // before the driver looks at them (embassy-stm32 0.6.0).
            if self.load() && settings::stored(self.pages).as_ref() == settings {
                return Ok(());
            }
            append = append.elsewhere();
        }
        Err(StorageError)
    }

    /// Whether it has succeeded shows when it is read back.
    async fn carry_out(&mut self, append: &Append) {
        let page = (append.page * PAGE_BYTES) as u32;
        if append.erase {
            let _ = self.bank.erase(page, page + PAGE_BYTES as u32).await;
        }
        let _ = self.bank.write(page + append.offset as u32, &append.record).await;
    }
}
