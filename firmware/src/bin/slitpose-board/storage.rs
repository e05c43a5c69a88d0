//! Settings in the flash memory's second bank, written while the firmware runs from the
//! first.

#[cfg(feature = "pose")]
use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::flash::{Async, Bank2Region, Flash};
use embassy_stm32::peripherals::FLASH;
use embassy_stm32::{Peri, pac};
#[cfg(feature = "pose")]
use embassy_sync::blocking_mutex::Mutex as BlockingMutex;
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_sync::signal::Signal;
#[cfg(feature = "pose")]
use heapless::Vec;
use slitpose_firmware::StorageError;
#[cfg(feature = "pose")]
use slitpose_firmware::settings::HEAD_BYTES;
use slitpose_firmware::settings::{self, Append, PAGE_BYTES, Pages, Settings};
use static_cell::ConstStaticCell;

use crate::Interrupts;

type Bank = Bank2Region<'static, Async>;

/// Bytes of a head that are written at once.
#[cfg(feature = "pose")]
const PIECE_BYTES: usize = 256;

/// The head to keep next, or that was kept; empty: none.
#[cfg(feature = "pose")]
static HEAD: BlockingMutex<ThreadModeRawMutex, RefCell<Vec<u8, HEAD_BYTES>>> =
    BlockingMutex::new(RefCell::new(Vec::new()));

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
    #[cfg(feature = "pose")]
    if let Some(area) = settings.as_ref().and_then(|settings| settings.head) {
        store.load_head(area);
    }
    Some((store, settings))
}

/// Whether the pages are being read, so that an error of the flash memory is one of the settings.
pub fn is_reading() -> bool {
    IS_READING.load(Ordering::SeqCst)
}

/// Begins to keep `settings` and `head`, or with `None` to forget the settings kept.
#[cfg_attr(not(feature = "pose"), expect(unused_variables, reason = "there is none"))]
pub fn begin(settings: Option<Settings>, head: &[u8]) {
    DONE.reset();
    #[cfg(feature = "pose")]
    HEAD.lock(|place| {
        let mut place = place.borrow_mut();
        place.clear();
        // No head is longer.
        let _ = place.extend_from_slice(head);
    });
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
        DONE.signal(store.keep(settings).await);
    }
}

impl Store {
    fn load(&mut self) -> bool {
        let Self { bank, pages } = self;
        let mut offsets = (0_u32..).step_by(PAGE_BYTES);
        pages.iter_mut().all(|page| offsets.next().is_some_and(|offset| read(bank, offset, page)))
    }

    async fn keep(
        &mut self,
        #[cfg_attr(not(feature = "pose"), expect(unused_mut, reason = "there is no head"))] mut settings: Option<
            Settings,
        >,
    ) -> Result<(), StorageError> {
        if !self.load() {
            return Err(StorageError);
        }
        #[cfg(feature = "pose")]
        if let Some(settings) = &mut settings {
            settings.head = self.keep_head().await?;
        }
        let settings = settings.as_ref();
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

    /// Writes the head to the area that is free, and gives the area; `None` without a head. The area in force stays as
    /// it is.
    #[cfg(feature = "pose")]
    async fn keep_head(&mut self) -> Result<Option<u8>, StorageError> {
        let length = HEAD.lock(|head| head.borrow().len());
        if length == 0 {
            return Ok(None);
        }
        let area = settings::free_area(self.pages);
        let start = settings::head_offset(area) as u32;
        for _ in 0..ATTEMPTS {
            let _ = self.bank.erase(start, start + HEAD_BYTES as u32).await;
            for offset in (0..length).step_by(PIECE_BYTES) {
                let piece = Self::piece(offset);
                let _ = self.bank.write(start + offset as u32, &piece).await;
            }
            if self.has_kept(start, length) {
                return Ok(Some(area));
            }
        }
        Err(StorageError)
    }

    /// A piece of the head, filled up with what erased memory holds.
    #[cfg(feature = "pose")]
    fn piece(offset: usize) -> [u8; PIECE_BYTES] {
        let mut piece = [0xff; PIECE_BYTES];
        HEAD.lock(|head| {
            let head = head.borrow();
            let rest = head.get(offset..).unwrap_or_default();
            piece.iter_mut().zip(rest).for_each(|(place, &byte)| *place = byte);
        });
        piece
    }

    /// Whether the head stands in the memory from `start` on.
    #[cfg(feature = "pose")]
    fn has_kept(&mut self, start: u32, length: usize) -> bool {
        (0..length).step_by(PIECE_BYTES).all(|offset| {
            let mut piece = [0; PIECE_BYTES];
            read(&mut self.bank, start + offset as u32, &mut piece) && piece == Self::piece(offset)
        })
    }

    #[cfg(feature = "pose")]
    fn load_head(&mut self, area: u8) {
        HEAD.lock(|head| {
            let mut head = head.borrow_mut();
            // As long as an area: there is room.
            let _ = head.resize(HEAD_BYTES, 0);
            // What is damaged shows when it is put in force.
            let _ = read(&mut self.bank, settings::head_offset(area) as u32, &mut head);
        });
    }
}

/// Reads the memory, of which a power cut may have torn a part.
fn read(bank: &mut Bank, offset: u32, bytes: &mut [u8]) -> bool {
    IS_READING.store(true, Ordering::SeqCst);
    let is_read = bank.blocking_read(offset, bytes).is_ok();
    // An error of the last words is reported before the mark is taken away.
    cortex_m::asm::dsb();
    IS_READING.store(false, Ordering::SeqCst);
    is_read
}

/// Gives the head that was kept to `take`, if there is one.
#[cfg(feature = "pose")]
pub fn with_head(take: impl FnOnce(&[u8])) {
    HEAD.lock(|head| {
        let head = head.borrow();
        if !head.is_empty() {
            take(&head);
        }
    });
}
