//! Puts a release's firmware into the program, if `SLITPOSE_FIRMWARE` names the folder that has it.

use std::path::{Path, PathBuf};

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=SLITPOSE_FIRMWARE");
    let folder = std::env::var_os("SLITPOSE_FIRMWARE").map(PathBuf::from);
    let constants =
        [("RELEASED", "slitpose-board"), ("RELEASED_WITH_POSES", "slitpose-board-pose")].map(|(name, image)| {
            let file = folder.as_ref().map(|folder| {
                let file = folder.join(format!("{image}-{}.dfu", env!("CARGO_PKG_VERSION")));
                println!("cargo:rerun-if-changed={}", file.display());
                format!("Some(include_bytes!({file:?}))")
            });
            format!("const {name}: Option<&[u8]> = {};\n", file.unwrap_or_else(|| "None".to_owned()))
        });
    let out = std::env::var("OUT_DIR").expect("cargo names it");
    std::fs::write(Path::new(&out).join("firmware.rs"), constants.concat()).expect("a folder to write to");
}
