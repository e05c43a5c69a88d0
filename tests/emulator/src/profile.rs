//! Where cycles go: instructions and their time, added up by function.

use std::collections::BTreeMap;

use crate::image::Image;
use crate::peripherals::Ticks;

/// Time spent at each instruction.
#[derive(Clone, Debug, Default)]
pub struct Profile {
    at: BTreeMap<u32, Spent>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Spent {
    times: u64,
    cycles: Ticks,
}

/// What a function took, without those it calls.
#[derive(Clone, Debug, PartialEq)]
pub struct FunctionCost {
    /// Its name, as in the source; what stands in no function has none.
    pub name: String,
    /// How often its first instruction was executed.
    pub calls: u64,
    /// Core cycles.
    pub cycles: Ticks,
}

impl Profile {
    /// Notes that the instruction at `pc` took `cycles`.
    pub fn add(&mut self, pc: u32, cycles: Ticks) {
        let spent = self.at.entry(pc).or_default();
        spent.times += 1;
        spent.cycles += cycles;
    }

    /// All cycles.
    pub fn total(&self) -> Ticks {
        self.at.values().map(|spent| spent.cycles).sum()
    }

    /// The functions of `image`, dearest first. What the compiler has inlined counts for where it
    /// was put.
    pub fn functions(&self, image: &Image) -> Vec<FunctionCost> {
        // A function's symbol has the lowest bit set: Thumb code.
        let functions: BTreeMap<u32, (u32, &str)> = image
            .symbols()
            .filter(|(_, symbol)| symbol.bytes > 0 && symbol.address & 1 == 1)
            .map(|(name, symbol)| (symbol.address & !1, (symbol.bytes, name)))
            .collect();
        let mut costs: BTreeMap<Option<u32>, FunctionCost> = BTreeMap::new();
        for (&pc, spent) in &self.at {
            let around = functions.range(..=pc).next_back().filter(|(start, (bytes, _))| pc - **start < *bytes);
            let cost = costs.entry(around.map(|(start, _)| *start)).or_insert_with(|| FunctionCost {
                name: around.map_or_else(String::new, |(_, (_, name))| format!("{:#}", rustc_demangle::demangle(name))),
                calls: 0,
                cycles: 0,
            });
            cost.cycles += spent.cycles;
            if around.is_some_and(|(start, _)| *start == pc) {
                cost.calls += spent.times;
            }
        }
        let mut costs: Vec<FunctionCost> = costs.into_values().collect();
        costs.sort_by_key(|cost| std::cmp::Reverse(cost.cycles));
        costs
    }
}
