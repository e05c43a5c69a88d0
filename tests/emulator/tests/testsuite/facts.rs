//! What the image writes into the registers, against numbers from outside the project
//! (`tests/data/stm32g474/facts.csv`): an error of reading that image and emulator share would show here.

use crate::common::pins::level_code;
use crate::common::silicon;
use crate::common::talk::{MS, Talk};
use crate::common::wiring::{Wire, inputs, port_and_number, wires};
use crate::common::wiring::{channel_of, multiplexer, register};
use slitpose_emulator::facts::{bits, number};
use slitpose_emulator::faults::Fault;
use slitpose_emulator::peripherals::TICKS_PER_SECOND;
use slitpose_firmware::pcb::frame_plan::FramePlan;
use slitpose_firmware::pcb::wiring::highest_level;
use slitpose_firmware::pcb::{TICK_HZ, default_configuration};
use slitpose_protocol::{Command, Configuration, Hashes, Level};

/// A board whose registers are read as by a debugger.
struct Probe(Talk);

impl Probe {
    /// A board that acquires by `configuration`, in the idle rest of a frame.
    fn acquiring(configuration: &Configuration) -> Self {
        let mut talk = Talk::at_usb();
        assert_eq!(talk.ask(Command::Configure(configuration.clone())), Ok(()));
        assert_eq!(talk.ask(Command::Start), Ok(()));
        talk.run_ms(5.0);
        let origin = talk.rig.machine().device_clock_origin().expect("the clock runs");
        let schedule = &configuration.schedule;
        let rest = u64::from(schedule.slots.len() as u32 * schedule.slot_ticks + 1_000);
        let last = talk.ear.scans.last().expect("scans come").tick + origin;
        talk.run_until(last + 8 * u64::from(schedule.frame_ticks) + rest);
        Self(talk)
    }

    /// The register at `offset` from `base`, both facts, and `more`.
    fn at(&mut self, base: &str, offset: &str, more: u32) -> u32 {
        register(&mut self.0.rig.machine().board, base, offset, more)
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

    /// A register of a channel of DMA1.
    fn dma(&mut self, channel: usize, register: &str) -> u32 {
        let span = bits("DMA1_Channel2_BASE") - bits("DMA1_Channel1_BASE");
        self.at("DMA1_Channel1_BASE", &format!("DMA_Channel_TypeDef.{register}"), channel as u32 * span)
    }
}

/// The bits `names` together.
fn all(prefix: &str, names: &[&str]) -> u32 {
    names.iter().map(|name| bits(&format!("{prefix}{name}"))).fold(0, |all, bits| all | bits)
}

/// `value` in the field `name`.
fn field(name: &str, value: u32) -> u32 {
    value << bits(name).trailing_zeros()
}

fn default_probe() -> Probe {
    Probe::acquiring(&default_configuration())
}

/// Periods of the converters' clock in ticks.
const CLOCK_TICKS: u32 = 4;

fn ticks_of_us(name: &str) -> f64 {
    number(name) * 1e-6 * f64::from(TICK_HZ)
}

/// Levels that differ within both lines, so that their DMA is needed.
fn varied_levels() -> Configuration {
    let mut configuration = default_configuration();
    let levels = [0x8000, 0x7000, 0x6000, 0x8000, 0x7800, 0x7000].map(Level);
    configuration.levels = levels.into_iter().collect();
    configuration
}

#[test]
fn the_clock_is_that_of_the_crystal_times_what_the_registers_say() {
    let mut probe = default_probe();
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
    let mut probe = default_probe();
    assert_eq!(probe.get("PWR_BASE", "PWR_TypeDef.CR5") & bits("PWR_CR5_R1MODE"), 0, "range 1 boost mode");
    let latency = probe.get("FLASH_R_BASE", "FLASH_TypeDef.ACR") & bits("FLASH_ACR_LATENCY");
    assert_eq!(latency, bits("wait_states_170_MHz"));
    let detector = probe.get("PWR_BASE", "PWR_TypeDef.CR2") & all("PWR_CR2_", &["PVDE", "PLS"]);
    assert_eq!(detector, bits("PWR_CR2_PVDE") | bits("LL_PWR_PVDLEVEL_6"));
    assert_eq!(number("V_PVD6_falling"), 2.9, "what the documents of the board promise");
    let line = bits("LL_EXTI_LINE_16");
    let registers = ["IMR1", "RTSR1", "FTSR1"].map(|name| probe.get("EXTI_BASE", &format!("EXTI_TypeDef.{name}")));
    assert_eq!(registers.map(|register| register & line), [line, line, 0]);
    let frozen = probe.0.rig.machine().cpu.frozen_in_halt();
    assert_eq!(
        frozen,
        bits("DBGMCU_APB1FZR1_DBG_TIM2_STOP") | bits("DBGMCU_APB1FZR1_DBG_TIM4_STOP"),
        "frame timer and embassy's clock"
    );
}

#[test]
fn each_dma_channel_of_a_run_has_its_request_its_register_and_its_width() {
    let mut configuration = varied_levels();
    // A lit last slot, so that compare 4 has its channel, too.
    configuration.schedule.slots.pop();
    let mut probe = Probe::acquiring(&configuration);
    let at = |base: &str, offset: &str| bits(base) + bits(offset);
    let word = all("DMA_CCR_", &["PSIZE_1", "MSIZE_1"]);
    let half = all("DMA_CCR_", &["PSIZE_0", "MSIZE_0"]);
    let out = bits("DMA_CCR_DIR");
    let gates = at("GPIOC_BASE", "GPIO_TypeDef.BSRR");
    let channels = [
        ("ADC1", at("ADC1_BASE", "ADC_TypeDef.DR"), half),
        ("ADC2", at("ADC2_BASE", "ADC_TypeDef.DR"), half),
        ("TIM2_UP", gates, word | out),
        ("TIM2_CH4", gates, word | out),
        ("TIM2_CH2", at("TIM2_BASE", "TIM_TypeDef.ARR"), word | out),
        ("TIM2_CH1", at("DAC1_BASE", "DAC_TypeDef.DHR12R1"), word | out),
        ("TIM2_CH3", at("DAC2_BASE", "DAC_TypeDef.DHR12R1"), word | out),
        ("TIM3_UP", gates, word | out),
    ];
    let always = all("DMA_CCR_", &["EN", "CIRC", "MINC", "PL"]);
    for (request, register, mode) in channels {
        let channel = channel_of(&mut probe.0.rig.machine().board, request);
        assert_eq!(probe.dma(channel, "CPAR"), register, "{request}");
        assert_eq!(probe.dma(channel, "CCR"), always | mode, "{request}");
    }
    let requests = all("TIM_DIER_", &["UDE", "CC1DE", "CC2DE", "CC3DE", "CC4DE"]);
    assert_eq!(probe.get("TIM2_BASE", "TIM_TypeDef.DIER"), requests);
    probe.0.expect_no_faults();
}

#[test]
fn the_serial_port_has_its_requests() {
    let mut talk = Talk::at_uart();
    // On DMA2, whose first multiplexer channel is the ninth; receiving also gives events.
    let requests = [8, 9].map(|channel| multiplexer(&mut talk.rig.machine().board, channel) & !bits("DMAMUX_CxCR_EGE"));
    assert_eq!(requests, ["TX", "RX"].map(|name| bits(&format!("LL_DMAMUX_REQ_LPUART1_{name}"))));
}

#[test]
fn the_converters_are_set_for_the_wired_inputs_the_frame_timer_and_the_schedule() {
    let mut probe = default_probe();
    let schedule = default_configuration().schedule;
    let approximation = number("approximation_clocks_12_bits");
    for (converter, inputs) in ["ADC1_BASE", "ADC2_BASE"].into_iter().zip(inputs()) {
        let mut get = |register: &str| probe.get(converter, &format!("ADC_TypeDef.{register}"));
        let sequence = [get("SQR1"), get("SQR2")];
        let rank = |rank: usize| sequence[(rank + 1) / 5] >> (6 * ((rank + 1) % 5)) & 0x1F;
        assert_eq!([0, 1, 2, 3, 4, 5].map(rank), inputs.map(u32::from), "{converter}");
        assert_eq!(sequence[0] & 0xF, 5, "six ranks");
        let sampling = [get("SMPR1"), get("SMPR2")];
        for input in inputs.map(usize::from) {
            let code = sampling[input / 10] >> (3 * (input % 10)) & 7;
            let clocks = number(&format!("sampling_clocks_{code}")) + approximation;
            assert_eq!(clocks * f64::from(CLOCK_TICKS), f64::from(schedule.conversion_ticks), "{converter}, {input}");
        }
        let trigger = bits("LL_ADC_REG_TRIG_EXT_TIM2_TRGO") & bits("ADC_CFGR_EXTSEL");
        let expected = trigger | bits("LL_ADC_REG_TRIG_EXT_RISING") | all("ADC_CFGR_", &["DMAEN", "DMACFG", "JQDIS"]);
        assert_eq!(get("CFGR"), expected, "{converter}");
        assert_eq!(schedule.oversampling, 4);
        assert_eq!(get("CFGR2"), bits("ADC_CFGR2_ROVSE") | bits("LL_ADC_OVS_RATIO_4"), "{converter}, no shift");
        assert_eq!(get("DIFSEL"), 0, "{converter}, single ended");
    }
    for common in ["ADC12_COMMON_BASE", "ADC345_COMMON_BASE"] {
        let mode = probe.get(common, "ADC_Common_TypeDef.CCR") & all("ADC_CCR_", &["CKMODE", "PRESC"]);
        assert_eq!(mode, bits("LL_ADC_CLOCK_SYNC_PCLK_DIV4"), "{common}");
    }
    let clock_mhz = number("f_HCLK") / f64::from(CLOCK_TICKS);
    assert!(clock_mhz <= number("f_ADC_all"));
}

/// The default slots sample 24.5 periods of 42.5 MHz; the circuit at a pin is far below what the data sheet allows.
#[test]
fn the_trigger_comes_early_by_latency_and_sampling_time_in_whole_clocks() {
    let mut probe = default_probe();
    let schedule = default_configuration().schedule;
    let latency = number("t_LATR_ckmode_11").trunc() * f64::from(CLOCK_TICKS);
    let sampling = number("sampling_clocks_3") * f64::from(CLOCK_TICKS);
    let compare = probe.get("TIM2_BASE", "TIM_TypeDef.CCR2");
    assert_eq!(f64::from(compare), f64::from(schedule.settling_ticks) - latency - sampling);
    assert!(220.0 < number("R_AIN_slow_24.5_clocks"));
    let output = probe.get("TIM2_BASE", "TIM_TypeDef.CR2") & bits("TIM_CR2_MMS");
    assert_eq!(output, bits("LL_TIM_TRGO_OC2REF"));
    let shift = bits("TIM_CCMR1_OC2M_Pos") - bits("LL_TIM_OCMODE_PWM2").trailing_zeros();
    // Active from the compare on: the trigger rises there.
    assert_eq!(probe.get("TIM2_BASE", "TIM_TypeDef.CCMR1") & 0xFF00, bits("LL_TIM_OCMODE_PWM2") << shift);
    let running = all("TIM_CR1_", &["CEN", "ARPE"]);
    assert_eq!(probe.get("TIM2_BASE", "TIM_TypeDef.CR1") & running, running);
    assert_eq!(probe.get("TIM2_BASE", "TIM_TypeDef.PSC"), 0);
}

#[test]
fn device_clock_and_guard_count_the_same_ticks() {
    let mut probe = default_probe();
    let clock = ["CR1", "PSC", "ARR"].map(|name| probe.get("TIM5_BASE", &format!("TIM_TypeDef.{name}")));
    assert_eq!(clock, [bits("TIM_CR1_CEN"), 0, u32::MAX]);
    let guard = probe.get("TIM3_BASE", "TIM_TypeDef.SMCR");
    let by = bits("LL_TIM_SLAVEMODE_RESET") | bits("TIM3_by_TIM2_TRGO");
    assert_eq!(guard, by, "set to zero by TIM2's trigger");
    assert_eq!(probe.get("TIM3_BASE", "TIM_TypeDef.DIER"), bits("TIM_DIER_UDE"));
}

#[test]
fn every_wired_pin_has_the_mode_of_its_signal() {
    let mut probe = default_probe();
    let [output, alternate, analog] =
        ["OUTPUT", "ALTERNATE", "ANALOG"].map(|mode| bits(&format!("LL_GPIO_MODE_{mode}")));
    for Wire { signal, pin, function, .. } in wires().into_iter().filter(|wire| !wire.is_for_poses()) {
        let mode = probe.of_pin(pin, "GPIO_TypeDef.MODER", 2);
        let expected = if function.starts_with("output") {
            assert_eq!(probe.of_pin(pin, "GPIO_TypeDef.OTYPER", 1), 0, "{signal}: push and pull");
            output
        } else if function.starts_with("LPUART1") {
            assert_eq!(probe.of_pin(pin, "GPIO_TypeDef.AFR", 4), bits("GPIO_AF12_LPUART1"), "{signal}");
            alternate
        } else if function.starts_with("ADC") || function.starts_with("DAC") {
            analog
        } else {
            // USB takes its pins by itself; the debugger's are as after reset.
            continue;
        };
        assert_eq!(mode, expected, "{signal}, {pin}");
    }
    for dac in ["DAC1_BASE", "DAC2_BASE"] {
        assert_eq!(probe.get(dac, "DAC_TypeDef.CR"), bits("DAC_CR_EN1"), "{dac}");
        assert_eq!(probe.get(dac, "DAC_TypeDef.MCR"), bits("LL_DAC_HIGH_FREQ_MODE_ABOVE_160MHZ"), "{dac}, buffered");
        let nominal = 1 << (bits("DAC_bits") - 1);
        assert_eq!(probe.get(dac, "DAC_TypeDef.DHR12R1"), nominal, "{dac}: the middle of its range");
    }
}

#[test]
fn serial_port_and_watchdog_are_set_by_their_clocks() {
    let mut probe = default_probe();
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
        talk.rig.machine().set_supply_v(supply_v);
        talk.rig.machine().board.set_temperature_c(temperature_c);
        talk.next_status();
        let status = talk.next_status();
        // A code of the sensor is 0.3 K, one of the reference 2 mV.
        let read_c = f64::from(status.temperature_k) - 273.15;
        assert!((read_c - temperature_c).abs() < 0.6, "{read_c} °C of {temperature_c}");
        assert!((f64::from(status.supply_v) - supply_v).abs() < 3e-3, "{} V of {supply_v}", status.supply_v);
    }
    let mut probe = default_probe();
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
    let before = talk.rig.machine().board.flash_array().bytes().to_vec();
    assert_eq!(talk.ask(Command::Store(Hashes::default())), Ok(()));
    talk.run_ms(10.0 * (number("t_ERASE_most") + number("t_prog_most") / 1e3));
    let after = talk.rig.machine().board.flash_array().bytes();
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

/// A millisecond of the tests is one of the board.
#[test]
fn ticks_of_tests_are_those_of_the_data_sheet() {
    assert_eq!(MS as f64, number("f_HCLK") * 1e3);
    assert_eq!(u64::from(TICK_HZ), TICKS_PER_SECOND);
}
