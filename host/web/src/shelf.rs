//! Where captures are read from: in a browser from files that the user has given to the page, a piece at a time, so that
//! memory does not grow with them; elsewhere, as in tests, from the disk.

#[cfg(target_arch = "wasm32")]
pub(crate) use crate::browser::Files;
#[cfg(not(target_arch = "wasm32"))]
pub(crate) use slitpose_tracking::playback::Disk as Files;
