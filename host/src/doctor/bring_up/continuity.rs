//! The continuity check of an unpowered Nucleo with a multimeter, by the wiring table.

use slitpose_firmware::pcb::pins;

use slitpose_head::finding::Finding;

/// The measurements in their order. `ask` gives whether it is as the question says; `None` if there is no one to ask.
pub(crate) fn continuity(mut ask: impl FnMut(&str) -> Option<bool>) -> impl Iterator<Item = Finding> {
    pins::rows("check").map(move |check| {
        let text = format!("{}: {}", check.name, check.function);
        match ask(&text) {
            Some(true) => Finding::ok("continuity", text),
            Some(false) => Finding::failed("continuity", format!("{text}, but it is not so"), check.note),
            None => Finding::skipped("continuity", format!("{text}; if not, {}", check.note)),
        }
    })
}
