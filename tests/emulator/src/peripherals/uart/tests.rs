use super::*;
use crate::facts::assert_facts;

/// 3 Mbaud: 170 MHz · 256 / 3 MHz.
const BRR_3M: u32 = 14_507;
/// Ten bits of it, rounded up.
const FRAME: Ticks = 567;

fn enabled() -> (Uart, Effects) {
    let (mut lpuart, mut effects) = (Uart::lpuart1(), Effects::default());
    lpuart.write(BRR, BRR_3M, &mut effects);
    lpuart.write(CR1, CR1_UE | CR1_RE | CR1_TE, &mut effects);
    run(&mut lpuart, &mut effects, FRAME);
    assert_eq!(lpuart.next_event(), Ticks::MAX);
    (lpuart, effects)
}

/// Lets time pass until `until`.
fn run(uart: &mut Uart, effects: &mut Effects, until: Ticks) {
    while uart.next_event() <= until {
        effects.now = uart.next_event();
        uart.advance(effects);
    }
    effects.now = until;
}

fn line(effects: &Effects) -> bool {
    effects.lines()[2] & 1 << (interrupt::LPUART1 - 64) != 0
}

#[test]
fn what_is_not_fetched_in_time_is_lost_and_told() {
    let (mut lpuart, mut effects) = enabled();
    lpuart.write(CR3, CR3_EIE, &mut effects);
    let begin = effects.now();
    lpuart.send(b"xyz", &effects);
    run(&mut lpuart, &mut effects, begin + FRAME);
    assert!(!line(&effects));
    run(&mut lpuart, &mut effects, begin + 3 * FRAME);
    assert!(line(&effects));
    assert_eq!(lpuart.read(RDR, &mut effects), u32::from(b'x'));
    assert_ne!(lpuart.read(ISR, &mut effects) & ISR_ORE, 0);
    assert_eq!(lpuart.read(ISR, &mut effects) & ISR_RXNE, 0);
    lpuart.write(ICR, ISR_ORE, &mut effects);
    assert!(!line(&effects));
}

#[test]
fn rules_are_watched() {
    let (mut lpuart, mut effects) = enabled();
    lpuart.write(BRR, BRR_3M, &mut effects);
    assert_eq!(effects.violation_count(), 1, "divider while enabled");
    lpuart.write(CR1, CR1_UE | CR1_RE | CR1_TE | 1 << 12, &mut effects);
    assert_eq!(effects.violation_count(), 2, "word length while enabled");
    lpuart.write(TDR, 1, &mut effects);
    lpuart.write(TDR, 2, &mut effects);
    assert_eq!(effects.violation_count(), 2, "one byte on the line, one waiting");
    lpuart.write(TDR, 3, &mut effects);
    assert_eq!(effects.violation_count(), 3, "no room");
    lpuart.write(CR1, 0, &mut effects);
    assert_eq!(effects.violation_count(), 4, "disabled while sending");
    lpuart.write(BRR, 0x2ff, &mut effects);
    lpuart.write(CR1, CR1_UE, &mut effects);
    assert_eq!(effects.violation_count(), 5, "divider too small");
}

#[test]
fn registers_are_those_of_st() {
    assert_facts!("USART_TypeDef."; CR1, CR2, CR3, BRR, RQR, ISR, ICR, RDR, TDR, PRESC);
    assert_facts!("USART_"; CR1_UE, CR1_RE, CR1_TE, CR1_IDLEIE, CR1_RXNEIE = "CR1_RXNEIE_RXFNEIE", CR1_TCIE);
    assert_facts!("USART_"; CR1_TXEIE = "CR1_TXEIE_TXFNFIE", CR1_FIFOEN, CR1_OVER8, CR2_STOP, CR2_TWO_STOP_BITS = "CR2_STOP_1");
    assert_facts!("USART_"; CR3_EIE, CR3_DMAR, CR3_DMAT, CR3_OVRDIS, RQR_RXFRQ, ISR_ORE, ISR_IDLE);
    assert_facts!("USART_"; ISR_RXNE = "ISR_RXNE_RXFNE", ISR_TC, ISR_TXE = "ISR_TXE_TXFNF", ISR_BUSY);
    assert_facts!("USART_"; ISR_TEACK, ISR_REACK);
    let kinds = [("LPUART", LPUART1), ("USART", USART1)];
    for (name, kind) in kinds {
        let least = crate::facts::bits(&format!("{name}_BRR_least"));
        let parts = crate::facts::number(&format!("{name}_BRR_factor"));
        assert_eq!((kind.least_divider, kind.divider_parts as f64), (least, parts), "{name}");
    }
    let masks = ["USART_BRR_LPUART", "USART_BRR_BRR"].map(crate::facts::bits);
    assert_eq!([LPUART1.divider_mask, USART1.divider_mask], masks);
}
