//! Flash and RAM of an STM32G474RE, and the constants in its system memory (RM0440, "Memory
//! organization" and "Embedded flash memory").

use std::collections::BTreeSet;

use crate::st;
/// Where flash lies; also seen at address 0.
pub const FLASH_BASE: u32 = st::FLASH::BASE;
/// Flash in bytes: two banks of 256 KiB.
pub const FLASH_BYTES: usize = st::flash::size as usize;
/// One bank in bytes (option bit DBANK set, as delivered).
pub const BANK_BYTES: usize = FLASH_BYTES / 2;
pub const PAGE_BYTES: usize = st::FLASH::PAGE_SIZE as usize;
/// Flash is programmed and protected (ECC) in double words of this many bytes.
pub const DOUBLE_WORD_BYTES: usize = st::flash::double_word as usize;

/// SRAM1, SRAM2 and the upper alias of CCM SRAM, one after another.
pub const RAM_BASE: u32 = st::SRAM1::BASE;
/// RAM in bytes.
pub const RAM_BYTES: usize = st::sram::size as usize;
/// CCM SRAM, the last 32 KiB of RAM, at its own address.
pub const CCM_BASE: u32 = st::CCMSRAM::BASE;
/// CCM SRAM in bytes.
pub const CCM_BYTES: usize = st::ccm::size as usize;

/// System memory with the factory's boot loader.
pub const BOOT_LOADER_BASE: u32 = 0x1FFF_0000;
pub const BOOT_LOADER_END: u32 = 0x1FFF_7000;

/// The 96-bit device identifier, as three words.
pub const UNIQUE_ID: [u32; 3] = [0x0032_0045, 0x5848_500B, 0x2036_3152];
const UNIQUE_ID_ADDRESS: u32 = st::UID::BASE;

/// Code of the temperature sensor at 30 °C and 3.0 V (data sheet, TS_CAL1; a typical device).
pub const TS_CAL1: u16 = 1_037;
/// Code of the temperature sensor at 130 °C and 3.0 V (TS_CAL2).
pub const TS_CAL2: u16 = 1_379;
/// Code of the internal reference during the factory's calibration (VREFINT_CAL).
pub const VREFINT_CAL: u16 = (4_095.0 * st::V::REFINT / st::calibration::supply + 0.5) as u16;

/// The aligned word of system memory at `address`; erased where nothing is known.
pub fn system_word(address: u32) -> u32 {
    let halves = [address & !3, (address & !3) + 2].map(system_half);
    u32::from(halves[0]) | u32::from(halves[1]) << 16
}

fn system_half(address: u32) -> u16 {
    match address {
        // Vector table of the boot loader: a stack and an entry in system memory.
        BOOT_LOADER_BASE..=0x1FFF_0007 => [0x3000, 0x2000, 0x0101, 0x1FFF][(address % 8 / 2) as usize],
        UNIQUE_ID_ADDRESS..=0x1FFF_759B => {
            let offset = address - UNIQUE_ID_ADDRESS;
            (UNIQUE_ID[(offset / 4) as usize] >> (8 * (offset % 4))) as u16
        }
        // LQFP64.
        st::PACKAGE::BASE => 0b00010,
        st::FLASHSIZE::BASE => (FLASH_BYTES / 1024) as u16,
        st::TEMPSENSOR::CAL1_ADDR => TS_CAL1,
        st::VREFINT::CAL_ADDR => VREFINT_CAL,
        st::TEMPSENSOR::CAL2_ADDR => TS_CAL2,
        _ => 0xFFFF,
    }
}

/// Reads 1, 2 or 4 bytes of `bytes`, little-endian, low byte first.
#[inline]
pub(crate) fn load(bytes: &[u8], offset: usize, width: u32) -> Option<u32> {
    match width {
        4 => bytes.get(offset..offset + 4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])),
        2 => bytes.get(offset..offset + 2).map(|half| u32::from(u16::from_le_bytes([half[0], half[1]]))),
        _ => bytes.get(offset).map(|&byte| u32::from(byte)),
    }
}

/// Writes the low 1, 2 or 4 bytes of `value` into `bytes`.
#[inline]
pub(crate) fn store(bytes: &mut [u8], offset: usize, width: u32, value: u32) -> Option<()> {
    let target = bytes.get_mut(offset..offset + width as usize)?;
    match width {
        4 => target.copy_from_slice(&value.to_le_bytes()),
        2 => target.copy_from_slice(&(value as u16).to_le_bytes()),
        _ => target[0] = value as u8,
    }
    Some(())
}

/// The cells of the flash memory. They outlive every reset and power cycle.
#[derive(Clone, Debug)]
pub struct FlashArray {
    bytes: Box<[u8]>,
    /// Offsets of double words whose ECC does not fit: a program or erase was cut short.
    pub torn: BTreeSet<usize>,
    /// Offsets of double words that read as erased and refuse to be programmed: see [`crate::faults::Fault::FlashTornOnes`].
    pub refusing: BTreeSet<usize>,
}

impl FlashArray {
    pub fn erased() -> Self {
        Self { bytes: vec![0xFF; FLASH_BYTES].into_boxed_slice(), torn: BTreeSet::new(), refusing: BTreeSet::new() }
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Puts `data` at `offset`, as a programmer's tool does.
    pub fn load(&mut self, offset: usize, data: &[u8]) {
        self.bytes[offset..offset + data.len()].copy_from_slice(data);
        self.torn.retain(|torn| !(offset..offset + data.len()).contains(torn));
    }

    /// Where the stack of the program begins: the first word of its vector table, behind the page of the boot stub.
    pub fn stack_start(&self) -> u32 {
        self.double_word(PAGE_BYTES) as u32
    }

    /// The double word at `offset` (a multiple of 8).
    pub fn double_word(&self, offset: usize) -> u64 {
        let bytes: [u8; 8] = self.bytes[offset..offset + DOUBLE_WORD_BYTES].try_into().expect("a slice of eight bytes");
        u64::from_le_bytes(bytes)
    }

    /// Programs a double word: zeros are written, ones leave a bit as it is. `complete`: how
    /// much of the programming time was granted, 1 for all; less leaves the word torn.
    pub fn program(&mut self, offset: usize, data: u64, complete: f64) {
        let before = self.double_word(offset);
        let mut bits = Bits::seeded(offset as u64 ^ data);
        let unreached = if complete >= 1.0 { 0 } else { bits.with_density(1.0 - complete) };
        let after = before & (data | unreached);
        self.bytes[offset..offset + DOUBLE_WORD_BYTES].copy_from_slice(&after.to_le_bytes());
        if complete < 1.0 {
            self.torn.insert(offset);
        } else {
            self.torn.remove(&offset);
        }
    }

    /// Erases `length` bytes from `offset` on. `complete` as in [`FlashArray::program`]: cells
    /// cut short read as a mixture of old and erased bits.
    pub fn erase(&mut self, offset: usize, length: usize, complete: f64) {
        if complete >= 1.0 {
            self.refusing.retain(|refusing| !(offset..offset + length).contains(refusing));
            self.bytes[offset..offset + length].fill(0xFF);
            self.torn.retain(|torn| !(offset..offset + length).contains(torn));
            return;
        }
        for at in (offset..offset + length).step_by(DOUBLE_WORD_BYTES) {
            let before = self.double_word(at);
            let after = before | Bits::seeded(at as u64).with_density(complete);
            self.bytes[at..at + DOUBLE_WORD_BYTES].copy_from_slice(&after.to_le_bytes());
            // One that has not changed yet still fits its ECC.
            if after != before {
                self.torn.insert(at);
            }
        }
    }
}

/// Reproducible random bits (xorshift; Marsaglia, 2003, "Xorshift RNGs", triple 13, 7, 17), to
/// decide which cells a cut operation has reached, and what RAM holds after power-on.
#[derive(Clone, Debug)]
pub struct Bits(u64);

impl Default for Bits {
    fn default() -> Self {
        Self::seeded(1)
    }
}

impl Bits {
    pub(crate) fn within(&mut self, range: std::ops::RangeInclusive<u64>) -> u64 {
        range.start() + (self.next() >> 16) % (range.end() - range.start() + 1)
    }

    pub(crate) fn seeded(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// 64 bits of which a fraction `density` is set on average.
    fn with_density(&mut self, density: f64) -> u64 {
        let threshold = (density.clamp(0.0, 1.0) * 65_536.0) as u64;
        (0..64).fold(0, |word, bit| word | u64::from(self.next() >> 32 & 0xFFFF < threshold) << bit)
    }
}
