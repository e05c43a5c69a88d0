//! The bus: what answers at which address, and how.

use super::Board;
use crate::cpu::{BusFault, Size};
use crate::memory::{
    BOOT_LOADER_BASE, BOOT_LOADER_END, CCM_BASE, CCM_BYTES, FLASH_BASE, FLASH_BYTES, RAM_BASE, RAM_BYTES, load, store,
    system_word,
};
use crate::peripherals::plain::write_backup;
use crate::peripherals::rcc::Gate;
use crate::st;

/// Start of system memory, and behind its end.
const SYSTEM_MEMORY: std::ops::Range<u32> = 0x1FFF_0000..0x2000_0000;
/// Peripherals on APB and AHB.
const PERIPHERALS: std::ops::Range<u32> = 0x4000_0000..0x6000_0000;
/// Every unit has a kilobyte of the address map; this much counts from its base.
const OFFSET_MASK: u32 = 0x3FF;
/// Extra cycles of an access through the AHB-APB bridge: an estimate, not in the manual.
const APB_WAIT: u32 = 2;
/// Extra cycles of an access to a peripheral on AHB: an estimate, not in the manual.
const AHB_WAIT: u32 = 1;
/// The gate of registers and packet memory.
const USB: Gate = Gate { register: st::RCC::APB1ENR1, bit: st::RCC::APB1ENR1_USBEN };

impl Board {
    /// Reads `width` bytes; the lane of the word for peripherals.
    #[inline]
    pub fn access_read(&mut self, address: u32, width: u32) -> Result<u32, BusFault> {
        if let Some(offset) = ram_offset(address) {
            if self.loses_writes {
                self.loses_access(offset, None);
            }
            return load(&self.ram, offset, width).ok_or(BusFault);
        }
        self.effects.address = address;
        let in_flash = address & !FLASH_BASE;
        if in_flash < FLASH_BYTES as u32 {
            return self.flash.load(in_flash as usize, width, &mut self.effects).ok_or(BusFault);
        }
        self.access_read_beyond(address, width)
    }

    /// Reads what is neither RAM nor flash.
    fn access_read_beyond(&mut self, address: u32, width: u32) -> Result<u32, BusFault> {
        let word = if PERIPHERALS.contains(&address) {
            if let Some(place) = packet_memory(address, width) {
                return Ok(if self.is_clocked(USB, 0) { self.usb.memory.read(place) } else { 0 });
            }
            self.read_peripheral(address & !3)
        } else if SYSTEM_MEMORY.contains(&address) {
            system_word(address)
        } else {
            return Err(BusFault);
        };
        let lane = word >> (8 * (address % 4));
        Ok(lane & (u32::MAX >> (32 - 8 * width)))
    }

    #[inline]
    pub fn access_write(&mut self, address: u32, width: u32, value: u32) -> Result<(), BusFault> {
        if let Some(offset) = ram_offset(address) {
            if self.loses_writes && self.loses_access(offset, Some(value)) {
                return Ok(());
            }
            return store(&mut self.ram, offset, width, value).ok_or(BusFault);
        }
        self.effects.address = address;
        self.access_write_beyond(address, width, value)
    }

    /// Writes what is not RAM.
    fn access_write_beyond(&mut self, address: u32, width: u32, value: u32) -> Result<(), BusFault> {
        let in_flash = address & !FLASH_BASE;
        if in_flash < FLASH_BYTES as u32 {
            self.flash.store(in_flash as usize, width, value, &mut self.effects);
            Ok(())
        } else if PERIPHERALS.contains(&address) {
            match packet_memory(address, width) {
                Some(place) if self.is_clocked(USB, value) => self.usb.memory.write(place, value),
                Some(_) => {}
                None => self.write_peripheral(address & !3, repeat(value, width)),
            }
            Ok(())
        } else {
            Err(BusFault)
        }
    }

    /// Whether the clock behind `gate` is on; if not, the access breaks a rule.
    #[inline]
    fn is_clocked(&mut self, gate: Gate, value: u32) -> bool {
        let on = self.rcc.is_on(gate);
        if !on {
            self.effects.violation(value, "a peripheral is accessed only while its clock is enabled in RCC");
        }
        on
    }

    fn read_peripheral(&mut self, address: u32) -> u32 {
        let Some((unit, gate)) = unit_at(address).filter(|_| !BEHIND_SYSCFG.contains(&address)) else {
            self.effects.unmodelled();
            return 0;
        };
        if gate.is_some_and(|gate| !self.is_clocked(gate, 0)) {
            return 0;
        }
        let offset = address & OFFSET_MASK;
        let effects = &mut self.effects;
        match unit {
            Unit::Timer(index) => self.timers[index].read(offset, effects),
            Unit::FrameTimer => self.frame_timer.read(offset, effects),
            Unit::Adc12 => self.adc12.read(offset, effects),
            Unit::Adc345 => self.adc345.read(offset, effects),
            Unit::Dma(controller) => self.dma.read(controller, offset, effects),
            Unit::Dmamux => self.dma.read_multiplexer(offset, effects),
            Unit::Gpio(index) => self.ports[index].read(offset, effects),
            Unit::Dac(index) => self.dacs[index].read(offset, effects),
            Unit::Usb => self.usb.read(offset, effects),
            Unit::Lpuart => self.lpuart.read(offset, effects),
            Unit::Usart => self.usart.read(offset, effects),
            Unit::Rcc => self.rcc.read(offset, effects),
            Unit::Flash => self.flash.read(offset, effects),
            Unit::Power => self.power.read(offset, effects),
            Unit::Exti => self.exti.read(offset, effects),
            Unit::Syscfg => self.syscfg.read(offset, effects),
            Unit::Backup => self.backup.read(offset, effects),
            Unit::Watchdog => self.watchdog.read(offset, effects),
            Unit::Crs => self.crs.read(offset, effects),
            Unit::Crc => self.crc.read(offset, effects),
        }
    }

    fn write_peripheral(&mut self, address: u32, value: u32) {
        let Some((unit, gate)) = unit_at(address).filter(|_| !BEHIND_SYSCFG.contains(&address)) else {
            self.effects.unmodelled();
            return;
        };
        if gate.is_some_and(|gate| !self.is_clocked(gate, value)) {
            return;
        }
        let offset = address & OFFSET_MASK;
        let effects = &mut self.effects;
        match unit {
            Unit::Timer(index) => self.timers[index].write(offset, value, effects),
            Unit::FrameTimer => self.frame_timer.write(offset, value, effects),
            Unit::Adc12 => self.adc12.write(offset, value, effects),
            Unit::Adc345 => self.adc345.write(offset, value, effects),
            Unit::Dma(controller) => self.dma.write(controller, offset, value, effects),
            Unit::Dmamux => self.dma.write_multiplexer(offset, value, effects),
            Unit::Gpio(index) => {
                self.ports[index].write(offset, value, effects);
                self.update_drive();
            }
            Unit::Dac(index) => {
                self.dacs[index].write(offset, value, effects);
                self.update_drive();
            }
            Unit::Usb => self.usb.write(offset, value, effects),
            Unit::Lpuart => self.lpuart.write(offset, value, effects),
            Unit::Usart => self.usart.write(offset, value, effects),
            Unit::Rcc => self.write_rcc(offset, value),
            Unit::Flash => self.flash.write(offset, value, effects),
            Unit::Power => {
                self.power.write(offset, value, effects);
                self.update_pvd();
            }
            Unit::Exti => self.exti.write(offset, value, effects),
            Unit::Syscfg => self.syscfg.write(offset, value, effects),
            Unit::Backup => write_backup(&mut self.backup, offset, value, self.power.backup_access(), effects),
            Unit::Watchdog => self.watchdog.write(offset, value, effects),
            Unit::Crs => self.crs.write(offset, value, effects),
            Unit::Crc => self.crc.write(offset, value, effects),
        }
    }

    /// The halfword of code at `address`.
    #[inline]
    pub fn fetch(&mut self, address: u32) -> Result<u16, BusFault> {
        if (BOOT_LOADER_BASE..BOOT_LOADER_END).contains(&address) {
            self.effects.enter_boot_loader();
            // Branch to itself: the factory's code is not executed.
            return Ok(0xE7FE);
        }
        self.access_read(address, 2).map(|half| half as u16)
    }

    /// A read by the core. Every access is aligned to its size; values are in the low bits.
    #[inline]
    pub fn read(&mut self, address: u32, size: Size) -> Result<u32, BusFault> {
        let value = self.access_read(address, size.bytes())?;
        // Reading can have effects too: it takes a byte from a receiver.
        if PERIPHERALS.contains(&address) {
            self.settle();
        }
        Ok(value)
    }

    #[inline]
    pub fn write(&mut self, address: u32, size: Size, value: u32) -> Result<(), BusFault> {
        self.access_write(address, size.bytes(), value)?;
        if !(RAM_BASE..PERIPHERALS.start).contains(&address) {
            self.settle();
        }
        Ok(())
    }

    /// Extra cycles of one access to `address`: of flash when its line is in no cache, of peripherals always.
    #[inline]
    pub fn wait_states(&self, address: u32) -> u32 {
        match address {
            0x4000_0000..=0x4001_FFFF => APB_WAIT,
            0x4002_0000..=0x5FFF_FFFF => AHB_WAIT,
            _ if address & !FLASH_BASE < FLASH_BYTES as u32 => self.flash.latency(),
            _ => 0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    Timer(usize),
    FrameTimer,
    Adc12,
    Adc345,
    Dma(usize),
    Dmamux,
    Gpio(usize),
    Dac(usize),
    Usb,
    Lpuart,
    Usart,
    Rcc,
    Flash,
    Power,
    Exti,
    Syscfg,
    Backup,
    Watchdog,
    Crs,
    Crc,
}

/// The address map and the gates of RCC: each unit with its base and the clock it needs, by ST's names.
macro_rules! units {
    ($($unit:ident $(($index:literal))? = $base:ident::$at:ident $(, $register:ident $gate:ident)?;)+) => {
        fn unit_at(address: u32) -> Option<(Unit, Option<Gate>)> {
            Some(match address & !OFFSET_MASK {
                $(st::$base::$at => (Unit::$unit$(($index))?, gate!($($register $gate)?)),)+
                _ => return None,
            })
        }

        /// All units with their gates.
        pub const UNITS: &[(Unit, Option<Gate>)] = &[$((Unit::$unit$(($index))?, gate!($($register $gate)?))),+];
    };
}

macro_rules! gate {
    () => {
        None
    };
    ($register:ident $gate:ident) => {
        Some(Gate { register: st::RCC::$register, bit: st::RCC::$gate })
    };
}

units! {
    Timer(0) = TIM2::BASE, APB1ENR1 APB1ENR1_TIM2EN;
    Timer(1) = TIM3::BASE, APB1ENR1 APB1ENR1_TIM3EN;
    Timer(2) = TIM4::BASE, APB1ENR1 APB1ENR1_TIM4EN;
    Timer(3) = TIM5::BASE, APB1ENR1 APB1ENR1_TIM5EN;
    FrameTimer = TIM1::BASE, APB2ENR APB2ENR_TIM1EN;
    Crs = CRS::BASE, APB1ENR1 APB1ENR1_CRSEN;
    Backup = TAMP::BASE, APB1ENR1 APB1ENR1_RTCAPBEN;
    Watchdog = IWDG::BASE;
    Usb = USB::BASE, APB1ENR1 APB1ENR1_USBEN;
    Power = PWR::BASE, APB1ENR1 APB1ENR1_PWREN;
    Lpuart = LPUART1::BASE, APB1ENR2 APB1ENR2_LPUART1EN;
    Syscfg = SYSCFG::BASE, APB2ENR APB2ENR_SYSCFGEN;
    Exti = EXTI::BASE;
    Usart = USART1::BASE, APB2ENR APB2ENR_USART1EN;
    Dma(0) = DMA1::BASE, AHB1ENR AHB1ENR_DMA1EN;
    Dma(1) = DMA2::BASE, AHB1ENR AHB1ENR_DMA2EN;
    Dmamux = DMAMUX1::BASE, AHB1ENR AHB1ENR_DMAMUX1EN;
    Rcc = RCC::BASE;
    Flash = FLASH::R_BASE, AHB1ENR AHB1ENR_FLASHEN;
    Crc = CRC::BASE, AHB1ENR AHB1ENR_CRCEN;
    Gpio(0) = GPIOA::BASE, AHB2ENR AHB2ENR_GPIOAEN;
    Gpio(1) = GPIOB::BASE, AHB2ENR AHB2ENR_GPIOBEN;
    Gpio(2) = GPIOC::BASE, AHB2ENR AHB2ENR_GPIOCEN;
    Gpio(3) = GPIOD::BASE, AHB2ENR AHB2ENR_GPIODEN;
    Gpio(4) = GPIOE::BASE, AHB2ENR AHB2ENR_GPIOEEN;
    Gpio(5) = GPIOF::BASE, AHB2ENR AHB2ENR_GPIOFEN;
    Gpio(6) = GPIOG::BASE, AHB2ENR AHB2ENR_GPIOGEN;
    Adc12 = ADC1::BASE, AHB2ENR AHB2ENR_ADC12EN;
    Adc345 = ADC3::BASE, AHB2ENR AHB2ENR_ADC345EN;
    Dac(0) = DAC1::BASE, AHB2ENR AHB2ENR_DAC1EN;
    Dac(1) = DAC2::BASE, AHB2ENR AHB2ENR_DAC2EN;
}

/// VREFBUF, comparators and amplifiers share the kilobyte with SYSCFG.
const BEHIND_SYSCFG: std::ops::Range<u32> = st::VREFBUF::BASE..st::EXTI::BASE;

/// The place in RAM, of which CCM SRAM is the last part, that `address` shows.
#[inline]
fn ram_offset(address: u32) -> Option<usize> {
    let [in_ram, in_ccm] = [RAM_BASE, CCM_BASE].map(|base| address.wrapping_sub(base) as usize);
    if in_ram < RAM_BYTES {
        return Some(in_ram);
    }
    (in_ccm < CCM_BYTES).then_some(RAM_BYTES - CCM_BYTES + in_ccm)
}

/// The place in USB's packet memory that an access goes to.
fn packet_memory(address: u32, width: u32) -> Option<std::ops::Range<usize>> {
    let offset = address.wrapping_sub(st::USB::PMAADDR) as usize;
    (offset < 1_024).then_some(offset..offset + width as usize)
}

/// A narrow value written to a peripheral appears in all lanes (RM0440, "AHB/APB bridges").
fn repeat(value: u32, width: u32) -> u32 {
    match width {
        1 => (value & 0xFF) * 0x0101_0101,
        2 => (value & 0xFFFF) * 0x0001_0001,
        _ => value,
    }
}
