//! What a process takes, as Linux tells it in /proc.

use std::fs;
use std::ops::AddAssign;

/// Linux counts processor time in hundredths of a second, whatever its kernel's own rate is (proc(5)).
const TICKS_A_SECOND: f64 = 100.0;

/// What a process takes at some moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// Memory in RAM.
    pub resident_bytes: u64,
    /// The most it ever was.
    pub peak_bytes: u64,
    /// Threads.
    pub threads: u64,
    /// Open files, sockets, and whatever else has a descriptor.
    pub descriptors: u64,
    /// Processor time taken so far, of all its threads, in user and system mode.
    pub cpu_s: f64,
}

impl Usage {
    /// That of the process `id`; `None` if it has ended.
    pub fn of(id: u32) -> Option<Self> {
        let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
        let field = |name: &str| -> Option<u64> {
            let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
            line.split_whitespace().next()?.parse().ok()
        };
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        // Behind its name, which may hold anything, come the fields from the third on; 14 and 15 are times.
        let (_, stat) = stat.rsplit_once(')')?;
        let ticks = stat.split_whitespace().skip(11).take(2).map(str::parse::<f64>);
        let descriptors = fs::read_dir(format!("/proc/{id}/fd")).ok()?.count() as u64;
        Some(Self {
            resident_bytes: field("VmRSS")? * 1024,
            peak_bytes: field("VmHWM")? * 1024,
            threads: field("Threads")?,
            descriptors,
            cpu_s: ticks.sum::<Result<f64, _>>().ok()? / TICKS_A_SECOND,
        })
    }
}

/// A mean being formed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Mean {
    sum: f64,
    count: f64,
}

impl AddAssign<f64> for Mean {
    fn add_assign(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }
}

impl Mean {
    /// The mean; NaN of nothing.
    fn value(self) -> f64 {
        self.sum / self.count
    }
}

/// The mean of the memory over the second quarter of the samples, and over the last, bytes: what a program
/// uses for the first time it uses in the first.
pub fn resident_in_quarters(samples: &[Usage]) -> [f64; 2] {
    let mut quarters = [Mean::default(); 4];
    for (number, usage) in samples.iter().enumerate() {
        quarters[number * 4 / samples.len()] += usage.resident_bytes as f64;
    }
    [quarters[1].value(), quarters[3].value()]
}
