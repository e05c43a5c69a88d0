//! slitpose in a browser: the live page with a simulated head, a board by Web Serial, or a capture, without a server.
//!
//! ```text
//!  page (host/src/live/page) ◀─messages of LIVE.md─▶ worker.js ──calls──▶ Station ──▶ pipeline, captures, simulator
//!  port by Web Serial        ◀───────bytes─────────▶
//! ```
//!
//! [`Station`] stands behind the page in place of a daemon. It takes time from a clock and bytes from calls, so it runs
//! anywhere. In a browser it runs in a worker, so that the page never waits for it.

#[cfg(target_arch = "wasm32")]
mod browser;
mod conversation;
mod followed;
mod recording;
mod replay;
mod shown;
mod simulated;
mod station;
#[cfg(test)]
mod tests;

#[cfg(target_arch = "wasm32")]
use browser::Files;
#[cfg(not(target_arch = "wasm32"))]
use slitpose_tracking::playback::Disk as Files;

use serde_json::json;
use slitpose_head::faults::KINDS;
use slitpose_head::scene_file::SHIPPED;
use slitpose_head::simulator::TrajectoryKind;
use wasm_bindgen::prelude::wasm_bindgen;

pub use station::{HeadFiles, Station};

/// What the page offers, as JSON: the shipped scenes, the motions and the kinds of faults.
#[wasm_bindgen]
pub fn choices() -> String {
    let scenes = SHIPPED.iter().map(|scene| json!({"name": scene.name, "about": scene.about, "text": scene.text}));
    let faults = KINDS.iter().map(|kind| json!({"name": kind.name, "example": kind.example, "about": kind.what}));
    json!({
        "scenes": scenes.collect::<Vec<_>>(),
        "motions": TrajectoryKind::NAMED.map(|(name, _)| name),
        "faults": faults.collect::<Vec<_>>(),
    })
    .to_string()
}
