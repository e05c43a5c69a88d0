//! The cycle counter and SysTick. Neither is advanced cycle by cycle: both are kept as differences to the time.

/// DWT_CYCCNT: counts executed cycles while DEMCR.TRCENA and DWT_CTRL.CYCCNTENA are set.
#[derive(Clone, Debug, Default)]
pub(super) struct CycleCounter {
    /// DWT_CTRL.CYCCNTENA.
    pub enabled: bool,
    running: bool,
    /// Value minus executed cycles while running, value otherwise.
    base: u32,
}

impl CycleCounter {
    /// Value after `executed` cycles.
    pub fn value(&self, executed: u64) -> u32 {
        if self.running { self.base.wrapping_add(executed as u32) } else { self.base }
    }

    /// Counts on from `value`, or stands at it.
    pub fn set(&mut self, value: u32, running: bool, executed: u64) {
        self.running = running;
        self.base = if running { value.wrapping_sub(executed as u32) } else { value };
    }
}

/// SysTick (DDI0403, B3.3), as the time at which it next reaches zero.
#[derive(Clone, Debug, Default)]
pub(super) struct SysTick {
    control: u32,
    reload: u32,
    /// Reached zero since CTRL was last read.
    count_flag: bool,
    /// Time of the next zero while counting.
    due: Option<u64>,
}

impl SysTick {
    /// Time of the next zero; the reference clock of the STM32G4 is HCLK/8.
    pub fn due(&self) -> Option<u64> {
        self.due
    }

    /// [`Self::due`] for comparison with the time.
    #[inline(always)]
    pub fn deadline(&self) -> u64 {
        self.due.unwrap_or(u64::MAX)
    }

    fn divider(&self) -> u64 {
        if self.control & 4 != 0 { 1 } else { 8 }
    }

    fn period(&self) -> u64 {
        (u64::from(self.reload) + 1) * self.divider()
    }

    fn restart(&mut self, now: u64) {
        self.due = (self.control & 1 != 0 && self.reload != 0).then(|| now + self.period());
    }

    /// Passes the zeros up to `now`; whether the exception becomes pending.
    pub fn advance(&mut self, now: u64) -> bool {
        let period = self.period();
        let Some(due) = self.due.as_mut().filter(|due| **due <= now) else { return false };
        *due += ((now - *due) / period + 1) * period;
        self.count_flag = true;
        self.control & 2 != 0
    }

    fn value(&self, now: u64) -> u32 {
        let left = self.due.map_or(0, |due| due.saturating_sub(now).div_ceil(self.divider()));
        (left % (u64::from(self.reload) + 1)) as u32
    }

    /// The register at `offset` from SYST_CSR.
    pub fn read(&mut self, offset: u32, now: u64) -> u32 {
        match offset {
            0 => self.control | u32::from(std::mem::take(&mut self.count_flag)) << 16,
            4 => self.reload,
            _ => self.value(now),
        }
    }

    /// See [`Self::read`].
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0 => {
                let restart = (self.control ^ value) & 5 != 0;
                self.control = value & 7;
                if restart {
                    self.restart(now);
                }
            }
            4 => {
                self.reload = value & 0xff_ffff;
                if self.due.is_none() {
                    self.restart(now);
                }
            }
            _ => {
                self.count_flag = false;
                self.restart(now);
            }
        }
    }
}
