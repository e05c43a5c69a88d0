//! What befalls one packet on the wire.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::kinds::Effect;
use super::text::Fault;

#[derive(Clone, Debug)]
pub(super) struct WireFault {
    pub(super) fault: Fault,
    random: ChaCha8Rng,
    /// Bits to the next that is inverted.
    bits: Option<u64>,
    /// Bytes of a burst to come.
    burst: usize,
    /// Spans whose begin has been acted on.
    pub(super) begun: u64,
}

/// A packet on its way.
#[derive(Clone, Debug, Default)]
pub(super) struct Passage {
    /// Its bytes, delimiter included; empty if it is lost.
    pub(super) bytes: Vec<u8>,
    pub(super) is_double: bool,
    /// It is delivered behind the next.
    pub(super) is_late: bool,
    pub(super) is_held: bool,
}

impl WireFault {
    pub(super) fn new(fault: Fault, random: ChaCha8Rng) -> Self {
        Self { fault, random, bits: None, burst: 0, begun: 0 }
    }

    /// Does to the packet what the fault does at `time_s`.
    pub(super) fn act(&mut self, time_s: f64, packet: &mut Passage) {
        // A burst that has begun goes on.
        if !self.fault.window.is_open(time_s) && self.burst == 0 {
            return;
        }
        let ([rate, bytes], effect) = (self.fault.values, self.fault.kind.effect);
        match effect {
            Effect::Flip => self.flip(rate, &mut packet.bytes),
            Effect::Drop if self.happens(rate) => packet.bytes.clear(),
            Effect::Duplicate => packet.is_double |= self.happens(rate),
            Effect::Reorder => packet.is_late |= self.happens(rate),
            Effect::Truncate if self.happens(rate) => {
                let kept = self.random.random_range(0..packet.bytes.len().max(1));
                packet.bytes.truncate(kept);
            }
            Effect::Burst => {
                if self.burst == 0 && self.happens(rate) {
                    self.burst = bytes as usize;
                }
                let hit = self.burst.min(packet.bytes.len());
                packet.bytes[..hit].iter_mut().for_each(|byte| *byte = self.random.random());
                self.burst -= hit;
            }
            Effect::Stall => packet.is_held = true,
            // Of the clock, of the link as a whole, or of other layers.
            _ => {}
        }
    }

    fn happens(&mut self, rate: f64) -> bool {
        self.random.random::<f64>() < rate
    }

    /// Inverts bits; the distance between two has the geometric distribution.
    fn flip(&mut self, rate: f64, bytes: &mut [u8]) {
        let length = 8 * bytes.len() as u64;
        let mut next = self.bits.take().unwrap_or_else(|| self.gap(rate));
        while next < length {
            bytes[(next / 8) as usize] ^= 1 << (next % 8);
            next += 1 + self.gap(rate);
        }
        self.bits = Some(next - length);
    }

    fn gap(&mut self, rate: f64) -> u64 {
        let uniform: f64 = self.random.random();
        // Of `rate` 1 the logarithm is infinite, and the gap zero.
        ((1.0 - uniform).ln() / (-rate).ln_1p()).min(1e15) as u64
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn act(text: &str, packets: usize, length: usize) -> Vec<Passage> {
        let mut fault = WireFault::new(text.parse().unwrap(), ChaCha8Rng::seed_from_u64(5));
        let pass = |_| {
            let mut packet = Passage { bytes: vec![0; length], ..Passage::default() };
            fault.act(0.0, &mut packet);
            packet
        };
        (0..packets).map(pass).collect()
    }

    #[test]
    fn bits_are_inverted_as_often_as_asked_for() {
        for (rate, packets) in [(1e-4, 10_000), (0.01, 1_000), (1.0, 3)] {
            let flipped = act(&format!("flip:rate={rate}"), packets, 25);
            let ones: u32 = flipped.iter().flat_map(|packet| &packet.bytes).map(|byte| byte.count_ones()).sum();
            let expected = rate * (packets * 200) as f64;
            // Six standard deviations of a binomial number.
            let most = 6.0 * (expected * (1.0 - rate)).sqrt() + 1e-9;
            assert!((f64::from(ones) - expected).abs() <= most, "seed 5, rate {rate}: {ones} of {expected}");
        }
    }

    #[test]
    fn packets_are_hit_as_often_as_asked_for() {
        let share = |text: &str, is_hit: fn(&Passage) -> bool| {
            let hits = act(text, 10_000, 25).iter().filter(|packet| is_hit(packet)).count();
            // Six standard deviations of a binomial number.
            assert!((hits as f64 - 1000.0).abs() < 6.0 * 900.0_f64.sqrt(), "seed 5, {text}: {hits}");
        };
        share("drop:rate=0.1", |packet| packet.bytes.is_empty());
        share("duplicate:rate=0.1", |packet| packet.is_double);
        share("reorder:rate=0.1", |packet| packet.is_late);
        share("truncate:rate=0.1", |packet| packet.bytes.len() < 25);
        assert!(act("stall", 3, 25).iter().all(|packet| packet.is_held));
    }

    #[test]
    fn a_burst_goes_on_into_later_packets() {
        let packets = act("burst:rate=1,bytes=60,for=1ms", 3, 25);
        // Of 60 random bytes few are as they were.
        let hit: Vec<usize> =
            packets.iter().map(|packet| packet.bytes.iter().filter(|byte| **byte != 0).count()).collect();
        assert!(hit[0] > 20 && hit[1] > 20 && hit[2] > 5, "seed 5: {hit:?}");
    }
}
