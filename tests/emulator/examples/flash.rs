//! What each feature of the image takes of flash, as a Markdown table: the default image less the one
//! without it. Builds them all, the default one last.
//!
//! ```text
//! cargo run --release -p slitpose-emulator --example flash
//! ```

use std::path::Path;
use std::process::Command;

use slitpose_emulator::rig::open_image;

/// The features of the default image besides `board`.
const FEATURES: [&str; 4] = ["usb", "uart", "storage", "sensors"];

fn main() {
    let all = flash_bytes(&FEATURES);
    println!("| feature | bytes of flash |\n|---|---|");
    let mut rest = all;
    for left_out in FEATURES {
        let others: Vec<&str> = FEATURES.into_iter().filter(|&feature| feature != left_out).collect();
        let bytes = all - flash_bytes(&others);
        rest -= bytes;
        println!("| `{left_out}` | {bytes} |");
    }
    println!("| `board` | {rest}, what is left |\n| `image` | {all} in all |");
    println!("| `defmt` | {} |", flash_bytes(&[&FEATURES[..], &["defmt"]].concat()) - all);
    build(&[]);
}

/// Builds the image with `features`, and asks the linker.
fn flash_bytes(features: &[&str]) -> usize {
    let said = build(&["--features", &features.join(",")]);
    // Its last word is where the image is, relative to the project.
    let path = said.split_whitespace().next_back().expect("it says where");
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    open_image(Some(&project.join(path))).expect("an image").flash_bytes()
}

fn build(arguments: &[&str]) -> String {
    let build = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/build");
    let output = Command::new(build).args(arguments).output().expect("firmware/build runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
}
