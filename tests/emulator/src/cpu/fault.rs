//! What can go wrong in the core, and the report of it.

/// Reason of a fault (DDI0403, B1.5.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// Nothing answers a data access, or it is refused.
    #[error("bus fault: data access to {address:#010x}")]
    DataBus {
        /// Address of the access.
        address: u32,
    },
    /// The MPU forbids a data access.
    #[error("memory fault: data access to guarded {address:#010x}")]
    Guarded {
        /// Address of the access.
        address: u32,
    },
    /// Nothing answers an instruction fetch.
    #[error("bus fault: instruction fetch from {address:#010x}")]
    FetchBus {
        /// Address of the fetch.
        address: u32,
    },
    /// A fetch from a region that is never executable (0x4000_0000–0x5FFF_FFFF and 0xA000_0000 up).
    #[error("memory fault: instruction fetch from non-executable {address:#010x}")]
    FetchNeverExecute {
        /// Address of the fetch.
        address: u32,
    },
    /// The register frame of an exception could not be written.
    #[error("bus fault while stacking at {address:#010x}")]
    Stacking {
        /// Address of the access.
        address: u32,
    },
    /// The MPU forbids to write the register frame of an exception.
    #[error("memory fault while stacking at guarded {address:#010x}")]
    StackingGuarded {
        /// Address of the access.
        address: u32,
    },
    /// The register frame of an exception could not be read.
    #[error("bus fault while unstacking at {address:#010x}")]
    Unstacking {
        /// Address of the access.
        address: u32,
    },
    /// An exception vector could not be read.
    #[error("bus fault while reading the vector at {address:#010x}")]
    VectorTable {
        /// Address of the vector.
        address: u32,
    },
    /// Code that switches on a mode of the floating-point unit which is not modelled.
    #[error("usage fault: FPSCR {fpscr:#010x} asks for a mode that the emulator does not model")]
    FloatMode {
        /// What was to be written.
        fpscr: u32,
    },
    /// An encoding without a meaning.
    #[error("usage fault: undefined instruction {first:#06x} {second:#06x}")]
    Undefined {
        /// First halfword.
        first: u16,
        /// Second halfword, 0 for a 16-bit instruction.
        second: u16,
    },
    /// A jump to an address with bit 0 clear: the state of another instruction set.
    #[error("usage fault: execution with EPSR.T clear")]
    InvalidState,
    /// An exception return that fits no active exception.
    #[error("usage fault: invalid exception return {value:#010x}")]
    InvalidReturn {
        /// The EXC_RETURN value.
        value: u32,
    },
    /// A coprocessor that is not there, or not enabled in CPACR.
    #[error("usage fault: coprocessor absent or not enabled")]
    NoCoprocessor,
    /// An unaligned access that must be aligned.
    #[error("usage fault: unaligned access to {address:#010x}")]
    Unaligned {
        /// Address of the access.
        address: u32,
    },
    /// A division by zero with CCR.DIV_0_TRP set.
    #[error("usage fault: division by zero")]
    DivideByZero,
    /// BKPT without a debugger.
    #[error("breakpoint without a debugger")]
    Breakpoint,
    /// SVC where its handler cannot preempt.
    #[error("supervisor call at a priority that forbids it")]
    SupervisorCall,
}

/// The state of the core when a fault was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{fault} at pc {pc:#010x} (lr {lr:#010x}, sp {sp:#010x}, xpsr {xpsr:#010x}, CFSR {cfsr:#010x}, HFSR {hfsr:#010x})"
)]
pub struct FaultReport {
    /// Reason.
    pub fault: Fault,
    /// Address of the instruction.
    pub pc: u32,
    /// Link register.
    pub lr: u32,
    /// Stack pointer in use.
    pub sp: u32,
    /// Program status.
    pub xpsr: u32,
    /// Configurable fault status register.
    pub cfsr: u32,
    /// HardFault status register.
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
