use super::*;
use crate::facts::{self, assert_facts};
use crate::peripherals::request;

const CH3: u32 = FIRST_CHANNEL + 2 * CHANNEL_SPAN;

/// DMA1 channel 3 on request 5: 4 halfwords from 0x5000_0040 to 0x2000_0000.
fn ring(flags: u32) -> (Dma, Effects) {
    let (mut dma, mut effects) = (Dma::new(), Effects::default());
    dma.write_multiplexer(8, 5, &mut effects);
    dma.write(0, CH3 + CNDTR, 4, &mut effects);
    dma.write(0, CH3 + CPAR, 0x5000_0040, &mut effects);
    dma.write(0, CH3 + CMAR, 0x2000_0000, &mut effects);
    dma.write(0, CH3 + CCR, 1 << 8 | 1 << 10 | MINC | EN | flags, &mut effects);
    (dma, effects)
}

#[test]
fn priority_then_number_decides() {
    let (mut dma, mut effects) = ring(CIRC);
    dma.write_multiplexer(0, 36, &mut effects);
    dma.write(0, FIRST_CHANNEL + CNDTR, 1, &mut effects);
    dma.write(0, FIRST_CHANNEL + CCR, EN, &mut effects);
    assert_eq!(dma.select(1 << 5 | 1 << 36, 0..CHANNELS), Some((0, request::ADC2)));
    dma.write(0, CH3 + CCR, 0, &mut effects);
    dma.write(0, CH3 + CCR, EN | 2 << 12, &mut effects);
    assert_eq!(dma.select(1 << 5 | 1 << 36, 0..CHANNELS), Some((2, request::ADC1)));
}

#[test]
fn write_rules_are_watched() {
    let (mut dma, mut effects) = ring(CIRC);
    dma.write(0, CH3 + CMAR, 0x2000_0000, &mut effects);
    assert_eq!(effects.violation_count(), 0, "nothing was changed");
    dma.write(0, CH3 + CMAR, 0x2000_0010, &mut effects);
    dma.write_multiplexer(8, 36, &mut effects);
    assert_eq!(effects.violation_count(), 2);
    dma.write_multiplexer(0, 36, &mut effects);
    dma.write(0, FIRST_CHANNEL + CNDTR, 1, &mut effects);
    dma.write(0, FIRST_CHANNEL + CCR, EN, &mut effects);
    assert_eq!(effects.violation_count(), 3, "two channels share a request");
}

#[test]
fn registers_are_those_of_st() {
    assert_facts!("DMA_TypeDef."; ISR, IFCR);
    assert_facts!("DMA_Channel_TypeDef."; CCR, CNDTR, CPAR, CMAR);
    let [controller, first, second] = ["DMA1_BASE", "DMA1_Channel1_BASE", "DMA1_Channel2_BASE"].map(facts::bits);
    assert_eq!((FIRST_CHANNEL, CHANNEL_SPAN), (first - controller, second - first));
    assert_facts!("DMA_CCR_"; EN, TCIE, HTIE, TEIE, DIR, CIRC, PINC, MINC, MEM2MEM);
    assert_facts!("DMA_ISR_"; GIF = "GIF1", TCIF = "TCIF1", HTIF = "HTIF1", TEIF = "TEIF1");
    assert_facts!("DMAMUX_"; MUX_CSR = "ChannelStatus_TypeDef.CSR", MUX_CFR = "ChannelStatus_TypeDef.CFR");
    assert_facts!("DMAMUX_"; MUX_RGSR = "RequestGenStatus_TypeDef.RGSR");
    assert_facts!("DMAMUX_"; MUX_RGCFR = "RequestGenStatus_TypeDef.RGCFR", MUX_EVENTS = "CxCR_EGE");
    let wide = Channel {
        ccr: facts::bits("DMA_CCR_PSIZE_1") | facts::bits("DMA_CCR_MSIZE_0") | facts::bits("DMA_CCR_PL"),
        ..Channel::default()
    };
    let Transfer { source_width, destination_width, .. } = wide.transfer();
    assert_eq!((source_width, destination_width, wide.priority()), (4, 2, 3));
}
