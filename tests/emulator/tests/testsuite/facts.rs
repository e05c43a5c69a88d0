//! What the image writes into the registers, against numbers from outside the project
//! (`tests/data/stm32g474/facts.csv`): an error of reading that image and emulator share would show here.

use crate::common::pins::level_code;
use crate::common::silicon;
use crate::common::talk::Talk;
use crate::common::{is_for_poses, port_and_number, register, scene};
use slitpose_emulator::facts::{bits, number};
use slitpose_emulator::faults::Fault;
use slitpose_emulator::peripherals::TICKS_PER_SECOND;
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::frame_plan::FramePlan;
use slitpose_firmware::pcb::pins::{Row, rows};
use slitpose_firmware::pcb::wiring::highest_level;
use slitpose_firmware::pcb::{TICK_HZ, default_configuration};
use slitpose_protocol::{Command, Hashes};

/// A board whose registers are read as by a debugger.
struct Probe(Talk);

impl Probe {
    /// A board that acquires, in the idle rest of a frame.
    fn acquiring() -> Self {
        let mut talk = Talk::at_usb();
        assert_eq!(talk.ask(Command::Start), Ok(()));
        talk.run_ms(5.0);
        let schedule = default_configuration().schedule;
        let rest = u64::from(schedule.slots.len() as u32 * schedule.slot_ticks + 1_000);
        let last = talk.origin() + talk.ear.scans.last().expect("scans come").tick;
        talk.run_until(last + 8 * u64::from(schedule.frame_ticks) + rest);
        Self(talk)
    }

    /// The register at `offset` from `base`, both facts, and `more`.
    fn at(&mut self, base: &str, offset: &str, more: u32) -> u32 {
        register(&mut self.0.rig.machine.board, base, offset, more)
    }

    fn get(&mut self, base: &str, offset: &str) -> u32 {
        self.at(base, offset, 0)
    }

    /// The pin's field of `width` bits in a register of its port, or of two registers.
    fn of_pin(&mut self, pin: &str, offset: &str, width: u32) -> u32 {
        let (port, number) = port_and_number(pin);
        let span = bits("GPIOB_BASE") - bits("GPIOA_BASE");
        let bit = number * width;
        let word = self.at("GPIOA_BASE", offset, port * span + bit / 32 * 4);
        word >> (bit % 32) & ((1 << width) - 1)
    }
}

/// The bits `names` together.
fn all(prefix: &str, names: &[&str]) -> u32 {
    names.iter().map(|name| bits(&format!("{prefix}{name}"))).fold(0, |all, bits| all | bits)
}

fn field(name: &str, value: u32) -> u32 {
    value << bits(name).trailing_zeros()
}

/// Periods of the converters' clock in ticks.
const CLOCK_TICKS: u32 = 4;

fn ticks_of_us(name: &str) -> f64 {
    number(name) * 1e-6 * f64::from(TICK_HZ)
}

#[test]
fn the_clock_is_that_of_the_crystal_times_what_the_registers_say() {
    let mut probe = Probe::acquiring();
    // A board whose crystal does not start makes the same of its own oscillator.
    let has_crystal = !silicon().has(Fault::HseDead);
    let (source, source_mhz) = if has_crystal { ("HSE", "HSE_nucleo") } else { ("HSI", "HSI16") };
    let mut on = all("RCC_CR_", &["PLLON", "PLLRDY"]) | all(&format!("RCC_CR_{source}"), &["ON", "RDY"]);
    on |= if has_crystal { bits("RCC_CR_CSSON") } else { 0 };
    assert_eq!(probe.get("RCC_BASE", "RCC_TypeDef.CR") & on, on);
    let cfgr = probe.get("RCC_BASE", "RCC_TypeDef.CFGR");
    assert_eq!(cfgr & bits("RCC_CFGR_SWS"), bits("RCC_CFGR_SWS_PLL"));
    assert_eq!(cfgr & all("RCC_CFGR_", &["HPRE", "PPRE1", "PPRE2"]), bits("RCC_CFGR_HPRE_DIV1"));
    let pll = probe.get("RCC_BASE", "RCC_TypeDef.PLLCFGR");
    let of = |name: &str| {
        let mask = bits(&format!("RCC_PLLCFGR_{name}"));
        f64::from((pll & mask) >> mask.trailing_zeros())
    };
    assert_eq!(pll & bits("RCC_PLLCFGR_PLLSRC"), bits(&format!("RCC_PLLCFGR_PLLSRC_{source}")));
    assert_ne!(pll & bits("RCC_PLLCFGR_PLLREN"), 0);
    let into_loop = number(source_mhz) / (of("PLLM") + 1.0);
    assert!((number("f_PLL_IN_least")..=number("f_PLL_IN_most")).contains(&into_loop), "{into_loop} MHz");
    let oscillator = into_loop * of("PLLN");
    assert!(oscillator <= number("f_VCO_most"), "{oscillator} MHz");
    let clock = oscillator / (2.0 * (of("PLLR") + 1.0));
    assert_eq!((clock, clock * 1e6), (number("f_HCLK"), f64::from(TICK_HZ)));
    assert_eq!(TICKS_PER_SECOND, u64::from(TICK_HZ));
    assert!(clock > number("half_speed_above"), "the emulator then asks for the way of half the bus clock");

    let selected = probe.get("RCC_BASE", "RCC_TypeDef.CCIPR");
    assert_eq!(selected & bits("RCC_CCIPR_CLK48SEL"), 0, "HSI48");
    assert_eq!(selected & bits("RCC_CCIPR_LPUART1SEL"), field("RCC_CCIPR_LPUART1SEL", 1), "system clock");
    let ready = all("RCC_CRRCR_", &["HSI48ON", "HSI48RDY"]);
    assert_eq!(probe.get("RCC_BASE", "RCC_TypeDef.CRRCR") & ready, ready);
}

#[test]
fn core_voltage_wait_states_and_supply_detector_are_set_for_170_mhz() {
    let mut probe = Probe::acquiring();
    assert_eq!(probe.get("PWR_BASE", "PWR_TypeDef.CR5") & bits("PWR_CR5_R1MODE"), 0, "range 1 boost mode");
    let latency = probe.get("FLASH_R_BASE", "FLASH_TypeDef.ACR") & bits("FLASH_ACR_LATENCY");
    assert_eq!(latency, bits("wait_states_170_MHz"));
    let detector = probe.get("PWR_BASE", "PWR_TypeDef.CR2") & all("PWR_CR2_", &["PVDE", "PLS"]);
    assert_eq!(detector, bits("PWR_CR2_PVDE") | bits("LL_PWR_PVDLEVEL_6"));
    assert_eq!(number("V_PVD6_falling"), 2.9, "what the documents of the board promise");
    let line = bits("LL_EXTI_LINE_16");
    let registers = ["IMR1", "RTSR1", "FTSR1"].map(|name| probe.get("EXTI_BASE", &format!("EXTI_TypeDef.{name}")));
    assert_eq!(registers.map(|register| register & line), [line, line, 0]);
    let frozen = probe.0.rig.machine.cpu.frozen_in_halt();
    assert_eq!(
        frozen,
        bits("DBGMCU_APB1FZR1_DBG_TIM2_STOP") | bits("DBGMCU_APB1FZR1_DBG_TIM4_STOP"),
        "frame timer and embassy's clock"
    );
}

/// Whatever else is set shows in instants and words of a run.
#[test]
fn converters_are_single_ended_and_within_their_clock() {
    let mut probe = Probe::acquiring();
    for converter in ["ADC1_BASE", "ADC2_BASE"] {
        assert_eq!(probe.get(converter, "ADC_TypeDef.DIFSEL"), 0, "{converter}");
    }
    for common in ["ADC12_COMMON_BASE", "ADC345_COMMON_BASE"] {
        let mode = probe.get(common, "ADC_Common_TypeDef.CCR") & all("ADC_CCR_", &["CKMODE", "PRESC"]);
        assert_eq!(mode, bits("LL_ADC_CLOCK_SYNC_PCLK_DIV4"), "{common}");
    }
    assert!(number("f_HCLK") / f64::from(CLOCK_TICKS) <= number("f_ADC_all"));
    // So that all samples are late by one and the same phase of that clock.
    let schedule = default_configuration().schedule;
    assert_eq!([schedule.frame_ticks, schedule.slot_ticks].map(|ticks| ticks % CLOCK_TICKS), [0, 0]);
    // The circuit at a pin is far below what the data sheet allows.
    assert!(220.0 < number("R_AIN_slow_24.5_clocks"));
}

#[test]
fn every_wired_pin_has_the_mode_of_its_signal() {
    let mut probe = Probe::acquiring();
    let mut of_poses = Probe(Talk::solving(&scene(), NoiseSource::Off));
    let [output, alternate, analog] =
        ["OUTPUT", "ALTERNATE", "ANALOG"].map(|mode| bits(&format!("LL_GPIO_MODE_{mode}")));
    for row in rows("signal") {
        let probe = if is_for_poses(&row) { &mut of_poses } else { &mut probe };
        let Row { name: signal, pin, function, .. } = row;
        let mode = probe.of_pin(pin, "GPIO_TypeDef.MODER", 2);
        let functions = ["AF12_LPUART1", "AF7_USART1", "AF1_TIM5", "AF6_TIM1"];
        let alternate_function =
            functions.into_iter().find(|name| name.split_once('_').is_some_and(|(_, of)| function.starts_with(of)));
        let expected = if function.starts_with("output") {
            assert_eq!(probe.of_pin(pin, "GPIO_TypeDef.OTYPER", 1), 0, "{signal}: push and pull");
            output
        } else if let Some(name) = alternate_function {
            assert_eq!(probe.of_pin(pin, "GPIO_TypeDef.AFR", 4), bits(&format!("GPIO_{name}")), "{signal}");
            alternate
        } else if function.starts_with("ADC") || function.starts_with("DAC") {
            analog
        } else {
            // USB takes its pins by itself; the debugger's are as after reset.
            continue;
        };
        assert_eq!(mode, expected, "{signal}, {pin}");
    }
    assert_eq!(of_poses.get("RCC_BASE", "RCC_TypeDef.CCIPR") & bits("RCC_CCIPR_USART1SEL"), 0, "PCLK2");
    for dac in ["DAC1_BASE", "DAC2_BASE"] {
        assert_eq!(probe.get(dac, "DAC_TypeDef.CR"), bits("DAC_CR_EN1"), "{dac}");
        assert_eq!(probe.get(dac, "DAC_TypeDef.MCR"), bits("LL_DAC_HIGH_FREQ_MODE_ABOVE_160MHZ"), "{dac}, buffered");
        let nominal = 1 << (bits("DAC_bits") - 1);
        assert_eq!(probe.get(dac, "DAC_TypeDef.DHR12R1"), nominal, "{dac}: the middle of its range");
    }
}

#[test]
fn serial_port_and_watchdog_are_set_by_their_clocks() {
    let mut probe = Probe::acquiring();
    let divider = f64::from(probe.get("LPUART1_BASE", "USART_TypeDef.BRR"));
    let baud = number("LPUART_BRR_factor") * f64::from(TICK_HZ) / divider;
    assert!((baud / 3e6 - 1.0).abs() < 1e-4, "{baud}");
    // ES0430, "Possible LPUART transmitter issue when using low BRR value": dividers below four times the least.
    assert!(divider >= 4.0 / 3.0 * number("LPUART_BRR_least"), "{divider}");
    let [prescaler, reload] = ["PR", "RLR"].map(|name| probe.get("IWDG_BASE", &format!("IWDG_TypeDef.{name}")));
    let wait_ms = f64::from(reload + 1) * f64::from(4 << prescaler) / number("LSI");
    assert!((99.0..=100.5).contains(&wait_ms), "{wait_ms} ms");
}

#[test]
fn supply_and_temperature_are_read_by_the_factory_s_calibration() {
    for (temperature_c, supply_v) in [(30.0, 3.0), (-20.0, 3.3), (85.0, 3.1), (130.0, 3.3)] {
        let mut talk = Talk::at_usb();
        talk.rig.machine.set_supply_v(supply_v);
        talk.rig.machine.board.temperature_c = temperature_c;
        talk.next_status();
        let status = talk.next_status();
        // A code of the sensor is 0.3 K, one of the reference 2 mV.
        let read_c = f64::from(status.temperature_k) - 273.15;
        assert!((read_c - temperature_c).abs() < 0.6, "{read_c} °C of {temperature_c}");
        assert!((f64::from(status.supply_v) - supply_v).abs() < 3e-3, "{} V of {supply_v}", status.supply_v);
    }
    let mut probe = Probe::acquiring();
    let switches = all("ADC_CCR_", &["VREFEN", "VSENSESEL"]);
    assert_eq!(probe.get("ADC345_COMMON_BASE", "ADC_Common_TypeDef.CCR") & switches, switches);
    let sampling = ["SMPR1", "SMPR2"].map(|name| probe.get("ADC5_BASE", &format!("ADC_TypeDef.{name}")));
    for (channel, least) in [("TEMPSENSOR_ADC5", "t_S_temp"), ("VREFINT", "t_S_vrefint")] {
        let input = bits(&format!("LL_ADC_CHANNEL_{channel}")) as usize;
        let code = sampling[input / 10] >> (3 * (input % 10)) & 7;
        let ticks = number(&format!("sampling_clocks_{code}")) * f64::from(CLOCK_TICKS);
        assert!(ticks >= ticks_of_us(least), "{channel}: {ticks} ticks");
    }
}

/// What the image asks for, and what the hardware is asked to do, by the data sheet's sampling times.
#[test]
fn conversions_that_the_plan_accepts_are_those_of_the_data_sheet() {
    let accepted: Vec<_> = (0..8_u8)
        .filter(|code| {
            let clocks = number(&format!("sampling_clocks_{code}")) + number("approximation_clocks_12_bits");
            let mut configuration = default_configuration();
            let schedule = &mut configuration.schedule;
            schedule.conversion_ticks = (clocks * f64::from(CLOCK_TICKS)) as u32;
            schedule.settling_ticks = 20_000;
            schedule.slot_ticks = 100_000;
            schedule.frame_ticks = 500_000;
            FramePlan::new(&configuration).is_ok_and(|plan| {
                assert_eq!(plan.sampling_code, *code);
                true
            })
        })
        .collect();
    // From 24.5 clocks on the pins settle within the sampling time (firmware/README.md).
    assert_eq!(accepted, [3, 4, 5, 6, 7]);
}

#[test]
fn settings_lie_at_the_start_of_the_second_bank_and_the_image_in_the_first() {
    let mut talk = Talk::at_usb();
    let before = talk.rig.machine.board.flash.array.bytes().to_vec();
    assert_eq!(talk.ask(Command::Store(Hashes::default())), Ok(()));
    talk.run_ms(10.0 * (number("t_ERASE_most") + number("t_prog_most") / 1e3));
    let after = talk.rig.machine.board.flash.array.bytes();
    let changed: Vec<_> = (0..before.len()).filter(|&at| before[at] != after[at]).collect();
    let bank = bits("flash_bank_size") as usize;
    let pages = bank..bank + 2 * bits("FLASH_PAGE_SIZE") as usize;
    assert!(changed.len() > 20 && changed.iter().all(|at| pages.contains(at)), "{changed:?}");
    assert!(before[..bank].iter().any(|&byte| byte != 0xFF) && before[bank..].iter().all(|&byte| byte == 0xFF));
    assert_eq!(bits("FLASH_BASE") as usize + bank, 0x0804_0000, "as firmware/README.md says");
}

#[test]
fn the_highest_level_is_within_the_reach_of_the_dac_s_buffer() {
    let highest = level_code(highest_level(&default_configuration().schedule));
    let supply_v = 3.3;
    let output_v = supply_v * f64::from(highest) / f64::from(1 << bits("DAC_bits"));
    let margin_v = supply_v - number("V_DAC_headroom") - output_v;
    assert!((0.0..0.01).contains(&margin_v), "{margin_v} V");
}
