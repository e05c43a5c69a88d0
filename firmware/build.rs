//! Tells the linker how to lay out an image for the board.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    // No page alignment between sections: flash addresses are file offsets of their own.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    let has_ccm = std::env::var_os("CARGO_FEATURE_POSE").is_some();
    // Ahead of the runtime's script: the first to name a part of the code has it.
    for script in has_ccm.then_some("ccm.x").into_iter().chain(["stack.x"]) {
        println!("cargo:rerun-if-changed={script}");
        println!("cargo:rustc-link-arg-bins=-T{}/{script}", env!("CARGO_MANIFEST_DIR"));
    }
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
