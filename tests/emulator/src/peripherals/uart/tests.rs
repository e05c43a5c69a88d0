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

fn asks(effects: &Effects, request: Request) -> bool {
    effects.pending_requests() & 1 << request.0 != 0
}

#[test]
fn bytes_leave_one_after_another_at_the_rate_of_the_divider() {
    let (mut lpuart, mut effects) = enabled();
    lpuart.write(CR3, CR3_DMAT, &mut effects);
    let begin = effects.now();
    for byte in [1, 2, 3] {
        assert!(asks(&effects, Request::LPUART1_TX));
        effects.withdraw(Request::LPUART1_TX);
        lpuart.write(TDR, byte, &mut effects);
        if lpuart.read(ISR, &mut effects) & ISR_TXE == 0 {
            assert!(!asks(&effects, Request::LPUART1_TX));
            let next = lpuart.next_event();
            run(&mut lpuart, &mut effects, next);
        }
    }
    assert_eq!(lpuart.read(ISR, &mut effects) & ISR_TC, 0);
    run(&mut lpuart, &mut effects, begin + 3 * FRAME);
    let sent: Vec<_> = lpuart.take_sent().iter().map(|sent| (sent.at - begin, sent.byte)).collect();
    assert_eq!(sent, [(FRAME, 1), (2 * FRAME, 2), (3 * FRAME, 3)]);
    assert_ne!(lpuart.read(ISR, &mut effects) & ISR_TC, 0);
    assert_eq!(effects.violation_count(), 0);
}

#[test]
fn a_burst_ends_with_one_idle_interrupt() {
    let (mut lpuart, mut effects) = enabled();
    lpuart.write(CR3, CR3_DMAR, &mut effects);
    lpuart.write(CR1, CR1_UE | CR1_RE | CR1_TE | CR1_IDLEIE, &mut effects);
    let begin = effects.now();
    lpuart.send(b"ab", &effects);
    for (count, &byte) in b"ab".iter().enumerate() {
        run(&mut lpuart, &mut effects, begin + (count as u64 + 1) * FRAME - 1);
        assert!(!asks(&effects, Request::LPUART1_RX));
        run(&mut lpuart, &mut effects, begin + (count as u64 + 1) * FRAME);
        assert!(asks(&effects, Request::LPUART1_RX));
        assert_eq!(lpuart.read(RDR, &mut effects), u32::from(byte));
        assert!(!asks(&effects, Request::LPUART1_RX));
    }
    assert!(!line(&effects));
    run(&mut lpuart, &mut effects, begin + 3 * FRAME);
    assert!(line(&effects));
    lpuart.write(ICR, ISR_IDLE, &mut effects);
    assert!(!line(&effects));
    run(&mut lpuart, &mut effects, begin + 100 * FRAME);
    assert!(!line(&effects));
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
fn usart1_divides_by_whole_periods_and_is_kept_only_when_heard() {
    let (mut usart, mut effects) = (Uart::usart1(), Effects::default());
    // 170 MHz / 34: 5 Mbaud, ten bits a byte.
    usart.write(BRR, 34, &mut effects);
    usart.write(CR1, CR1_UE | CR1_TE, &mut effects);
    run(&mut usart, &mut effects, 340);
    usart.write(TDR, 1, &mut effects);
    run(&mut usart, &mut effects, 680);
    assert_eq!((usart.next_event(), usart.take_sent()), (Ticks::MAX, vec![]));
    usart.listen();
    usart.write(CR3, CR3_DMAT, &mut effects);
    assert!(asks(&effects, Request::USART1_TX) && !asks(&effects, Request::LPUART1_TX));
    usart.write(TDR, 2, &mut effects);
    run(&mut usart, &mut effects, 1_020);
    assert_eq!(usart.take_sent(), [SentByte { at: 1_020, byte: 2 }]);
    assert_eq!((effects.violation_count(), effects.unmodelled_accesses().len()), (0, 0));
    usart.write(CR1, 0, &mut effects);
    usart.write(BRR, 15, &mut effects);
    usart.write(CR1, CR1_UE | CR1_OVER8, &mut effects);
    assert_eq!((effects.violation_count(), effects.unmodelled_accesses().len()), (1, 1), "divider; by 8");
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
