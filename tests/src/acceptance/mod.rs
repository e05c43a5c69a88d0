//! The whole daemon in long, rough and fast use: each study runs the `slitpose` command, prints what it
//! measured, and says which bounds were kept.
//!
//! * [`soak`]: several boards for a long time, and nothing lost or growing;
//! * [`storm`]: the same in bad weather, and nothing lost silently;
//! * [`replug`]: a board that goes in all manners and comes back;
//! * [`kill`]: what a capture holds of a daemon that was killed;
//! * [`hour`]: how fast long captures are solved, and in how much memory.
//!
//! Each is an example of this package, in full size, and a test, in small. [`daemon`] is the process under
//! test, [`wall_clock`] its clock, [`usage`] what it takes, which only Linux tells; [`metered`] and [`unplugging`] are
//! its boards, [`subscriber`] and [`live_pages`] its clients; [`scan_table`] counts what a capture holds, [`curves`] draws.

pub mod curves;
pub mod daemon;
pub mod hour;
pub mod kill;
pub mod live_pages;
pub mod metered;
pub mod replug;
pub mod scan_table;
pub mod soak;
pub mod storm;
pub mod subscriber;
pub mod unplugging;
pub mod usage;
pub mod wall_clock;
