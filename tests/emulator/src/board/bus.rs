//! The bus: what answers at which address, and how.

use super::Board;
use crate::cpu::{Bus, BusFault, Size};
use crate::memory::{
    BOOT_LOADER_BASE, BOOT_LOADER_END, CCM_BASE, CCM_BYTES, FLASH_BASE, FLASH_BYTES, RAM_BASE, RAM_BYTES, load, store,
    system_word,
};
use crate::peripherals::rcc::Gate;
use crate::world::World;

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

impl<W: World> Board<W> {
    /// Reads `width` bytes; the lane of the word for peripherals.
    #[inline]
    pub(super) fn access_read(&mut self, address: u32, width: u32) -> Result<u32, BusFault> {
        let in_ram = address.wrapping_sub(RAM_BASE);
        if (in_ram as usize) < self.ram.len() {
            if self.loses_writes {
                self.loses_access(in_ram as usize, None);
            }
            return load(&self.ram, in_ram as usize, width).ok_or(BusFault);
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
        let in_ccm = address.wrapping_sub(CCM_BASE) as usize;
        if in_ccm < CCM_BYTES {
            if self.loses_writes {
                self.loses_access(RAM_BYTES - CCM_BYTES + in_ccm, None);
            }
            return load(&self.ram, RAM_BYTES - CCM_BYTES + in_ccm, width).ok_or(BusFault);
        }
        let word = if PERIPHERALS.contains(&address) {
            if let Some(offset) = packet_memory_offset(address) {
                return Ok(self.read_packet_memory(offset, width));
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

    /// Writes `width` bytes.
    #[inline]
    pub(super) fn access_write(&mut self, address: u32, width: u32, value: u32) -> Result<(), BusFault> {
        let in_ram = address.wrapping_sub(RAM_BASE);
        if (in_ram as usize) < self.ram.len() {
            if self.loses_writes && self.loses_access(in_ram as usize, Some(value)) {
                return Ok(());
            }
            return store(&mut self.ram, in_ram as usize, width, value).ok_or(BusFault);
        }
        self.effects.address = address;
        self.access_write_beyond(address, width, value)
    }

    /// Writes what is not RAM.
    fn access_write_beyond(&mut self, address: u32, width: u32, value: u32) -> Result<(), BusFault> {
        let in_ccm = address.wrapping_sub(CCM_BASE) as usize;
        let in_flash = address & !FLASH_BASE;
        if in_ccm < CCM_BYTES {
            if self.loses_writes && self.loses_access(RAM_BYTES - CCM_BYTES + in_ccm, Some(value)) {
                return Ok(());
            }
            store(&mut self.ram, RAM_BYTES - CCM_BYTES + in_ccm, width, value).ok_or(BusFault)
        } else if in_flash < FLASH_BYTES as u32 {
            self.flash.store(in_flash as usize, width, value, &mut self.effects);
            Ok(())
        } else if PERIPHERALS.contains(&address) {
            if let Some(offset) = packet_memory_offset(address) {
                self.write_packet_memory(offset, width, value);
            } else {
                self.write_peripheral(address & !3, repeat(value, width));
            }
            Ok(())
        } else {
            Err(BusFault)
        }
    }

    fn read_packet_memory(&mut self, offset: u32, width: u32) -> u32 {
        if self.is_clocked(Gate::USB, 0) { self.usb.read_memory(offset, width as usize, &mut self.effects) } else { 0 }
    }

    fn write_packet_memory(&mut self, offset: u32, width: u32, value: u32) {
        if self.is_clocked(Gate::USB, value) {
            self.usb.write_memory(offset, width as usize, value, &mut self.effects);
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
        let Some((unit, gate)) = unit_at(address) else {
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
        let Some((unit, gate)) = unit_at(address) else {
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
            Unit::Backup => self.backup.write(offset, value, self.power.backup_access(), effects),
            Unit::Watchdog => self.watchdog.write(offset, value, effects),
            Unit::Crs => self.crs.write(offset, value, effects),
            Unit::Crc => self.crc.write(offset, value, effects),
        }
    }
}

impl<W: World> Bus for Board<W> {
    #[inline]
    fn fetch(&mut self, address: u32) -> Result<u16, BusFault> {
        if (BOOT_LOADER_BASE..BOOT_LOADER_END).contains(&address) {
            self.effects.enter_boot_loader();
            // Branch to itself: the factory's code is not executed.
            return Ok(0xE7FE);
        }
        self.access_read(address, 2).map(|half| half as u16)
    }

    #[inline]
    fn read(&mut self, address: u32, size: Size) -> Result<u32, BusFault> {
        let value = self.access_read(address, size.bytes())?;
        // Reading can have effects too: it takes a byte from a receiver.
        if PERIPHERALS.contains(&address) {
            self.settle();
        }
        Ok(value)
    }

    #[inline]
    fn write(&mut self, address: u32, size: Size, value: u32) -> Result<(), BusFault> {
        self.access_write(address, size.bytes(), value)?;
        if !(RAM_BASE..PERIPHERALS.start).contains(&address) {
            self.settle();
        }
        Ok(())
    }

    #[inline]
    fn wait_states(&self, address: u32) -> u32 {
        match address {
            0x4000_0000..=0x4001_FFFF => APB_WAIT,
            0x4002_0000..=0x5FFF_FFFF => AHB_WAIT,
            _ if address & !FLASH_BASE < FLASH_BYTES as u32 => self.flash.latency(),
            _ => 0,
        }
    }
}

/// What answers at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    Timer(usize),
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

/// The address map (RM0440, "Memory map and peripheral register boundary addresses").
#[inline]
fn unit_at(address: u32) -> Option<(Unit, Option<Gate>)> {
    let block = address & !OFFSET_MASK;
    let index = block >> 10 & 7;
    let (unit, gate) = match block {
        0x4000_0000 | 0x4000_0400 | 0x4000_0800 | 0x4000_0C00 => (Unit::Timer(index as usize), Gate::timer(index)),
        0x4000_2000 => (Unit::Crs, Gate::CRS),
        0x4000_2400 => (Unit::Backup, Gate::RTC_APB),
        0x4000_3000 => return Some((Unit::Watchdog, None)),
        0x4000_5C00 => (Unit::Usb, Gate::USB),
        0x4000_7000 => (Unit::Power, Gate::PWR),
        0x4000_8000 => (Unit::Lpuart, Gate::LPUART1),
        // VREFBUF, comparators and amplifiers share the kilobyte with SYSCFG.
        0x4001_0000 if address < 0x4001_0030 => (Unit::Syscfg, Gate::SYSCFG),
        0x4001_3800 => (Unit::Usart, Gate::USART1),
        0x4001_0400 => return Some((Unit::Exti, None)),
        0x4002_0000 => (Unit::Dma(0), Gate::DMA1),
        0x4002_0400 => (Unit::Dma(1), Gate::DMA2),
        0x4002_0800 => (Unit::Dmamux, Gate::DMAMUX1),
        0x4002_1000 => return Some((Unit::Rcc, None)),
        0x4002_2000 => (Unit::Flash, Gate::FLASH),
        0x4002_3000 => (Unit::Crc, Gate::CRC),
        0x4800_0000..=0x4800_1800 => (Unit::Gpio(index as usize), Gate::gpio(index)),
        0x5000_0000 => (Unit::Adc12, Gate::ADC12),
        0x5000_0400 => (Unit::Adc345, Gate::ADC345),
        0x5000_0800 => (Unit::Dac(0), Gate::dac(0)),
        0x5000_0C00 => (Unit::Dac(1), Gate::dac(1)),
        _ => return None,
    };
    Some((unit, Some(gate)))
}

fn packet_memory_offset(address: u32) -> Option<u32> {
    Some(address.wrapping_sub(0x4000_6000)).filter(|&offset| offset < 1_024)
}

/// A narrow value written to a peripheral appears in all lanes (RM0440, "AHB/APB bridges").
fn repeat(value: u32, width: u32) -> u32 {
    match width {
        1 => (value & 0xFF) * 0x0101_0101,
        2 => (value & 0xFFFF) * 0x0001_0001,
        _ => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts;

    #[test]
    fn units_answer_at_st_s_addresses() {
        let units = [
            ("TIM2_BASE", Unit::Timer(0)),
            ("TIM3_BASE", Unit::Timer(1)),
            ("TIM4_BASE", Unit::Timer(2)),
            ("TIM5_BASE", Unit::Timer(3)),
            ("CRS_BASE", Unit::Crs),
            ("TAMP_BASE", Unit::Backup),
            ("IWDG_BASE", Unit::Watchdog),
            ("USB_BASE", Unit::Usb),
            ("PWR_BASE", Unit::Power),
            ("LPUART1_BASE", Unit::Lpuart),
            ("USART1_BASE", Unit::Usart),
            ("CRC_BASE", Unit::Crc),
            ("SYSCFG_BASE", Unit::Syscfg),
            ("EXTI_BASE", Unit::Exti),
            ("DMA1_BASE", Unit::Dma(0)),
            ("DMA2_BASE", Unit::Dma(1)),
            ("DMAMUX1_BASE", Unit::Dmamux),
            ("RCC_BASE", Unit::Rcc),
            ("FLASH_R_BASE", Unit::Flash),
            ("GPIOA_BASE", Unit::Gpio(0)),
            ("GPIOB_BASE", Unit::Gpio(1)),
            ("GPIOC_BASE", Unit::Gpio(2)),
            ("GPIOG_BASE", Unit::Gpio(6)),
            ("ADC1_BASE", Unit::Adc12),
            ("ADC2_BASE", Unit::Adc12),
            ("ADC12_COMMON_BASE", Unit::Adc12),
            ("ADC3_BASE", Unit::Adc345),
            ("ADC5_BASE", Unit::Adc345),
            ("ADC345_COMMON_BASE", Unit::Adc345),
            ("DAC1_BASE", Unit::Dac(0)),
            ("DAC2_BASE", Unit::Dac(1)),
        ];
        for (base, unit) in units {
            assert_eq!(unit_at(facts::bits(base)).map(|(unit, _)| unit), Some(unit), "{base}");
        }
        assert!(unit_at(facts::bits("VREFBUF_BASE")).is_none());
        assert_eq!(packet_memory_offset(facts::bits("USB_PMAADDR")), Some(0));
    }
}
