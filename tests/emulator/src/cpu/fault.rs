//! What can go wrong in the core, and the report of it.

/// Reason of a fault (DDI0403, B1.5.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // The messages say it.
pub enum Fault {
    #[error("bus fault: data access to {address:#010x}")]
    DataBus { address: u32 },
    #[error("memory fault: data access to guarded {address:#010x}")]
    Guarded { address: u32 },
    #[error("bus fault: instruction fetch from {address:#010x}")]
    FetchBus { address: u32 },
    #[error("memory fault: instruction fetch from non-executable {address:#010x}")]
    FetchNeverExecute { address: u32 },
    #[error("bus fault while stacking at {address:#010x}")]
    Stacking { address: u32 },
    #[error("memory fault while stacking at guarded {address:#010x}")]
    StackingGuarded { address: u32 },
    #[error("bus fault while unstacking at {address:#010x}")]
    Unstacking { address: u32 },
    #[error("bus fault while reading the vector at {address:#010x}")]
    VectorTable { address: u32 },
    #[error("usage fault: FPSCR {fpscr:#010x} asks for a mode that the emulator does not model")]
    FloatMode { fpscr: u32 },
    #[error("usage fault: undefined instruction {first:#06x} {second:#06x}")]
    Undefined { first: u16, second: u16 },
    #[error("usage fault: execution with EPSR.T clear")]
    InvalidState,
    #[error("usage fault: invalid exception return {value:#010x}")]
    InvalidReturn { value: u32 },
    #[error("usage fault: coprocessor absent or not enabled")]
    NoCoprocessor,
    #[error("usage fault: unaligned access to {address:#010x}")]
    Unaligned { address: u32 },
    #[error("usage fault: division by zero")]
    DivideByZero,
    #[error("breakpoint without a debugger")]
    Breakpoint,
    #[error("supervisor call at a priority that forbids it")]
    SupervisorCall,
}

/// The state of the core when a fault was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{fault} at pc {pc:#010x} (lr {lr:#010x}, sp {sp:#010x}, xpsr {xpsr:#010x}, CFSR {cfsr:#010x}, HFSR {hfsr:#010x})"
)]
#[allow(missing_docs)] // The registers of these names.
pub struct FaultReport {
    pub fault: Fault,
    pub pc: u32,
    pub lr: u32,
    pub sp: u32,
    pub xpsr: u32,
    pub cfsr: u32,
    pub hfsr: u32,
}

impl Fault {
    /// Number of the exception that handles it when enabled, and its bit in CFSR.
    pub(super) fn class(self) -> (u8, u32) {
        match self {
            Self::FetchNeverExecute { .. } => (4, 1 << 0),
            Self::Guarded { .. } => (4, 1 << 1),
            Self::StackingGuarded { .. } => (4, 1 << 4),
            Self::FetchBus { .. } => (5, 1 << 8),
            Self::DataBus { .. } => (5, 1 << 9),
            Self::Unstacking { .. } => (5, 1 << 11),
            Self::Stacking { .. } => (5, 1 << 12),
            Self::Undefined { .. } | Self::FloatMode { .. } => (6, 1 << 16),
            Self::InvalidState => (6, 1 << 17),
            Self::InvalidReturn { .. } => (6, 1 << 18),
            Self::NoCoprocessor => (6, 1 << 19),
            Self::Unaligned { .. } => (6, 1 << 24),
            Self::DivideByZero => (6, 1 << 25),
            Self::VectorTable { .. } | Self::Breakpoint | Self::SupervisorCall => (3, 0),
        }
    }
}
