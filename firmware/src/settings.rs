//! Settings that outlive the supply: a log of records in two pages of flash memory.
//!
//! A record is written behind the last record of the page in use. When that page is full,
//! the other page is erased and used. The newest whole record counts. It stays readable
//! while the next one is written or a page is erased, so that a power cut costs at most the
//! record being written.
//!
//! ```text
//! record = magic u32 ‖ version u16 ‖ payload bytes u16 ‖ number u32 ‖ checksum u32 ‖ payload ‖ 0xff…
//! ```
//! little endian, padded to whole double words, the unit in which the memory is written.
//! The checksum is CRC-32/ISO-HDLC of version, length, number and payload. An empty
//! payload says that settings were forgotten.

use core::mem::size_of;
use core::num::NonZeroU32;

use heapless::Vec;
use slitpose_protocol::{Configuration, Hashes};

/// Bytes erased at once.
pub const PAGE_BYTES: usize = 2048;

/// Bytes written at once: a double word and its error-correcting code.
pub const WRITE_BYTES: usize = 8;

/// Content of the two pages.
pub type Pages = [[u8; PAGE_BYTES]; 2];

/// Largest record: a configuration of sixteen cells and the hashes.
const RECORD_BYTES: usize = 192;

const MAGIC: u32 = u32::from_le_bytes(*b"slit");

/// Raised when the payload changes; records of other versions are passed over.
const VERSION: u16 = 1;

const HEADER_BYTES: usize = 16;

/// Bytes of an area for a head: whole pages.
pub const HEAD_BYTES: usize = 2 * PAGE_BYTES;

const ERASED: u8 = 0xff;
const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Settings that a board starts with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Schedule, levels and exposure.
    pub configuration: Configuration,
    /// Hashes of the scene and the calibration that the board belongs to.
    pub hashes: Hashes,
    /// Which of the two [areas](head_offset) keeps the head that goes with them, if any: written first, so that one
    /// record puts both in force at once. Chosen by whoever writes them.
    pub head: Option<u8>,
    /// The full scale of the board's front end in picoamperes, if it is not the firmware's.
    pub full_scale_pa: Option<NonZeroU32>,
}

/// Place of an area for a head, in bytes from the start of the pages: behind them, one area behind the other.
pub fn head_offset(area: u8) -> usize {
    size_of::<Pages>() + usize::from(area & 1) * HEAD_BYTES
}

/// The area for the next head: that which the settings kept in `pages` do not name.
pub fn free_area(pages: &Pages) -> u8 {
    stored(pages).and_then(|settings| settings.head).map_or(0, |area| 1 - (area & 1))
}

/// Work that keeps settings: erase `page` if `erase`, then write `record` at `offset` of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Append {
    /// Index of the page.
    pub page: usize,
    /// Whether the page must be erased first.
    pub erase: bool,
    /// Place of the record, in bytes from the start of the page.
    pub offset: usize,
    /// Whole double words.
    pub record: Vec<u8, RECORD_BYTES>,
}

impl Append {
    /// Where to try again after this has failed: in the other page, or once more in the page that was erased, so that
    /// the newest whole record stays. A double word whose programming was cut short may read as erased and yet refuse
    /// to be programmed (RM0440, "Flash main memory programming sequences": an address is programmed only once).
    pub fn elsewhere(self) -> Self {
        let page = if self.erase { self.page } else { 1 - self.page };
        Self { page, erase: true, offset: 0, ..self }
    }
}

/// Settings stored in `pages`; `None` if there are none, if they were forgotten, or if
/// they are of another version than this firmware's.
pub fn stored(pages: &Pages) -> Option<Settings> {
    let newest = newest(pages)?;
    if newest.version != VERSION || newest.payload.is_empty() {
        return None;
    }
    // Records of boards that knew no head, or no full scale of their own, end before it: zeros behind them are none.
    let mut payload = [0; RECORD_BYTES];
    payload.get_mut(..newest.payload.len())?.copy_from_slice(newest.payload);
    let (configuration, hashes, head, full_scale_pa) = postcard::from_bytes(&payload).ok()?;
    Some(Settings { configuration, hashes, head, full_scale_pa })
}

/// Work that stores `settings` in `pages`; with `None` it marks the settings there as
/// forgotten.
pub fn append(pages: &Pages, settings: Option<&Settings>) -> Append {
    let newest = newest(pages);
    let number = newest.as_ref().map_or(0, |newest| newest.number.wrapping_add(1));
    let record = record(number, settings);
    let home = newest.map_or(0, |newest| newest.page);
    match Records::of(&pages[home], home).free_from() {
        Some(offset) if offset + record.len() <= PAGE_BYTES => Append { page: home, erase: false, offset, record },
        _ => {
            let page = if number == 0 { home } else { 1 - home };
            Append { page, erase: true, offset: 0, record }
        }
    }
}

fn record(number: u32, settings: Option<&Settings>) -> Vec<u8, RECORD_BYTES> {
    let mut payload = [0; RECORD_BYTES - HEADER_BYTES];
    let payload: &[u8] = match settings {
        // The largest settings fit; see the test below.
        Some(Settings { configuration, hashes, head, full_scale_pa }) => {
            postcard::to_slice(&(configuration, hashes, head, full_scale_pa), &mut payload).map_or(&[], |bytes| bytes)
        }
        None => &[],
    };
    record_of(VERSION, number, payload)
}

fn record_of(version: u16, number: u32, payload: &[u8]) -> Vec<u8, RECORD_BYTES> {
    let length = payload.len() as u16;
    let mut record = Vec::new();
    for part in [
        &MAGIC.to_le_bytes()[..],
        &version.to_le_bytes(),
        &length.to_le_bytes(),
        &number.to_le_bytes(),
        &checksum(version, number, payload).to_le_bytes(),
        payload,
    ] {
        // Header and payload fit by the size of the payload's buffer.
        let _ = record.extend_from_slice(part);
    }
    let padded = record.len().next_multiple_of(WRITE_BYTES);
    let _ = record.resize(padded, ERASED);
    record
}

fn checksum(version: u16, number: u32, payload: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&version.to_le_bytes());
    digest.update(&(payload.len() as u16).to_le_bytes());
    digest.update(&number.to_le_bytes());
    digest.update(payload);
    digest.finalize()
}

/// A whole record.
#[derive(Debug, Clone, Copy)]
struct Record<'a> {
    page: usize,
    number: u32,
    version: u16,
    payload: &'a [u8],
}

fn newest(pages: &Pages) -> Option<Record<'_>> {
    let records = pages.iter().enumerate().flat_map(|(page, bytes)| Records::of(bytes, page));
    records.max_by_key(|record| record.number)
}

/// The whole records of a page, up to the first record that is damaged.
#[derive(Debug)]
struct Records<'a> {
    page: usize,
    rest: &'a [u8],
}

impl<'a> Records<'a> {
    fn of(bytes: &'a [u8; PAGE_BYTES], page: usize) -> Self {
        Self { page, rest: bytes }
    }

    /// Offset at which the next record can be written; `None` if the bytes behind the last
    /// whole record are not erased, because a write was interrupted there.
    fn free_from(mut self) -> Option<usize> {
        while self.next().is_some() {}
        self.rest.iter().all(|&byte| byte == ERASED).then_some(PAGE_BYTES - self.rest.len())
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = Record<'a>;

    fn next(&mut self) -> Option<Record<'a>> {
        let (header, rest) = self.rest.split_first_chunk::<HEADER_BYTES>()?;
        let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let half = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let (magic, version, length, number, sum) = (word(0), half(4), usize::from(half(6)), word(8), word(12));
        let payload = rest.get(..length)?;
        if magic != MAGIC || sum != checksum(version, number, payload) {
            return None;
        }
        self.rest = rest.get(length.next_multiple_of(WRITE_BYTES)..)?;
        Some(Record { page: self.page, number, version, payload })
    }
}

const _: () = assert!(HEADER_BYTES.is_multiple_of(WRITE_BYTES) && size_of::<Pages>() == 2 * PAGE_BYTES);

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use slitpose_protocol::{EmitterSet, Exposure, Level, Schedule};

    use super::*;
    use crate::pcb::default_configuration;

    const BLANK: Pages = [[ERASED; PAGE_BYTES]; 2];

    fn settings(scene: u64) -> Settings {
        let hashes = Hashes { scene: Some(scene), calibration: None };
        Settings {
            configuration: default_configuration(),
            hashes,
            head: (scene % 3).try_into().ok().filter(|&area| area < 2),
            full_scale_pa: NonZeroU32::new(scene as u32),
        }
    }

    /// Carries out the first `steps` pieces of an append, until the power is cut: an erased
    /// page is one piece, a double word another. The piece under way at the cut leaves
    /// `debris`.
    fn carry_out(pages: &mut Pages, append: &Append, steps: usize, debris: u8) {
        let page = &mut pages[append.page];
        let mut steps = steps;
        if append.erase {
            if steps == 0 {
                for byte in page.iter_mut().skip(usize::from(debris)) {
                    *byte |= debris;
                }
                return;
            }
            page.fill(ERASED);
            steps -= 1;
        }
        for (n, piece) in append.record.chunks(WRITE_BYTES).enumerate() {
            let place = &mut page[append.offset + n * WRITE_BYTES..][..WRITE_BYTES];
            assert!(place.iter().all(|&byte| byte == ERASED), "written twice");
            match n.cmp(&steps) {
                core::cmp::Ordering::Less => place.copy_from_slice(piece),
                core::cmp::Ordering::Equal => {
                    place.iter_mut().zip(piece).for_each(|(byte, new)| *byte = new | debris);
                    return;
                }
                core::cmp::Ordering::Greater => return,
            }
        }
    }

    #[test]
    fn damaged_records_and_records_of_other_versions_are_passed_over() {
        let mut pages = [[0; PAGE_BYTES]; 2];
        assert_eq!(stored(&pages), None);
        let first = append(&pages, Some(&settings(1)));
        assert!(first.erase);
        carry_out(&mut pages, &first, usize::MAX, 0);
        assert_eq!(stored(&pages), Some(settings(1)));
        let record = record_of(2, 9, &[1, 2, 3]);
        pages[1][..record.len()].copy_from_slice(&record);
        assert_eq!(stored(&pages), None, "a newer firmware's settings are not read as ours");
    }

    #[test]
    fn settings_of_boards_that_knew_no_heads_or_no_full_scale_are_read() {
        for head in [None, Some(1)] {
            let kept = Settings { head, full_scale_pa: None, ..settings(5) };
            let old = (&kept.configuration, &kept.hashes);
            let mut payload = [0; 128];
            let payload = match head {
                None => postcard::to_slice(&old, &mut payload),
                head => postcard::to_slice(&(old, head), &mut payload),
            };
            let record = record_of(VERSION, 3, payload.expect("room"));
            let mut pages = BLANK;
            pages[0][..record.len()].copy_from_slice(&record);
            assert_eq!(stored(&pages), Some(kept));
        }
    }

    /// A record as it is in flash memory, by the layout above and CRC-32 of zlib, not by this program's writer.
    #[test]
    fn a_record_of_these_bytes_is_read() {
        let parts: [&[u8]; 7] = [
            // Magic; version 1, 60 bytes of payload, number 7; checksum.
            b"slit\x01\0\x3c\0\x07\0\0\0\x96\xc7\xf8\x60",
            // In varints: 170 MHz, a frame of 42 500 ticks; four slots with emitters 0 and 3, 1 and 4, 2 and 5, none.
            b"\x80\xfd\x87\x51\x84\xcc\x02\x04\x09\x12\x24\0",
            // A slot of 5800 ticks, settling 2210, conversion 148; four conversions a word, six cells.
            b"\xa8\x2d\xa2\x11\x94\x01\x04\x06",
            // Six levels of 0x8000; fixed exposure.
            b"\x06\x80\x80\x02\x80\x80\x02\x80\x80\x02\x80\x80\x02\x80\x80\x02\x80\x80\x02\0",
            // Some scene 0x0123456789abcdef, some calibration 300.
            b"\x01\xef\x9b\xaf\xcd\xf8\xac\xd1\x91\x01\x01\xac\x02",
            // Some head in area 1; some full scale of 10 000 000 pA; nothing written behind them.
            b"\x01\x01\x01\x80\xad\xe2\x04",
            &[ERASED; 4],
        ];
        let mut pages = BLANK;
        pages[0][..80].copy_from_slice(&parts.concat());
        let hashes = Hashes { scene: Some(0x0123_4567_89ab_cdef), calibration: Some(300) };
        let full_scale_pa = NonZeroU32::new(10_000_000);
        let kept = Settings { configuration: default_configuration(), hashes, head: Some(1), full_scale_pa };
        assert_eq!(stored(&pages), Some(kept.clone()));
        assert_eq!(pages[0][..80], record(7, Some(&kept)), "today's writer writes the same");
    }

    /// The checksum covers the number too, by which the newest record is found.
    #[test]
    fn a_flipped_bit_costs_its_record_and_no_other() {
        let records = [record(8, Some(&settings(8))), record(9, Some(&settings(9)))];
        let whole = HEADER_BYTES + usize::from(records[0][6]);
        for damaged in 0..2 {
            for bit in 0..8 * whole {
                let mut pages = BLANK;
                for (page, record) in pages.iter_mut().zip(&records) {
                    page[..record.len()].copy_from_slice(record);
                }
                assert_eq!(stored(&pages), Some(settings(9)));
                pages[damaged][bit / 8] ^= 1 << (bit % 8);
                let other = [settings(9), settings(8)][damaged].clone();
                assert_eq!(stored(&pages), Some(other), "bit {bit} of record {damaged}");
            }
        }
    }

    #[test]
    fn a_store_that_failed_is_tried_where_the_newest_record_is_not() {
        let mut pages = BLANK;
        let first = append(&pages, Some(&settings(1)));
        assert_eq!((first.page, first.erase), (0, false));
        // A page that was erased for it is erased once more: the newest record is in the other.
        let failed = Append { page: 1, erase: true, ..first.clone() };
        assert_eq!(failed.clone().elsewhere(), failed);
        carry_out(&mut pages, &first, usize::MAX, 0);
        let second = append(&pages, Some(&settings(2)));
        assert!(!second.erase);
        let elsewhere = second.elsewhere();
        assert_eq!((elsewhere.page, elsewhere.erase, elsewhere.offset), (1, true, 0));
        carry_out(&mut pages, &elsewhere, usize::MAX, 0);
        assert_eq!(stored(&pages), Some(settings(2)));
        // From then on the other page is in use.
        assert_eq!(append(&pages, None).page, 1);
    }

    #[test]
    fn the_largest_settings_fit_a_record() {
        let largest = Settings {
            configuration: Configuration {
                schedule: Schedule {
                    tick_hz: u32::MAX,
                    frame_ticks: u32::MAX,
                    slots: (0..17).map(|_| EmitterSet(u16::MAX)).collect(),
                    slot_ticks: u32::MAX,
                    settling_ticks: u32::MAX,
                    conversion_ticks: u32::MAX,
                    oversampling: u16::MAX,
                    cells: u8::MAX,
                },
                levels: (0..16).map(|_| Level(u16::MAX)).collect(),
                exposure: Exposure::Automatic,
            },
            hashes: Hashes { scene: Some(u64::MAX), calibration: Some(u64::MAX) },
            head: Some(1),
            full_scale_pa: Some(NonZeroU32::MAX),
        };
        let mut pages = BLANK;
        let append = append(&pages, Some(&largest));
        carry_out(&mut pages, &append, usize::MAX, 0);
        assert_eq!(stored(&pages), Some(largest));
    }

    proptest! {
        /// After each of many power cuts, either the settings stored before the cut or the
        /// settings being stored are read.
        #[test]
        fn a_power_cut_costs_at_most_the_record_being_written(
            cuts in prop::collection::vec((0_usize..30, any::<u8>(), any::<bool>()), 1..120),
        ) {
            let mut pages = BLANK;
            let mut before = None;
            for (n, (steps, debris, forget)) in cuts.into_iter().enumerate() {
                let new = (!forget).then(|| settings(n as u64));
                let append = append(&pages, new.as_ref());
                carry_out(&mut pages, &append, steps, debris);
                let found = stored(&pages);
                prop_assert!(found == before || found == new, "{n}: {found:?}");
                if steps > append.record.len() / WRITE_BYTES {
                    prop_assert_eq!(&found, &new);
                }
                before = found;
            }
        }
    }
}
