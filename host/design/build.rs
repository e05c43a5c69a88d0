//! Tells the program how it was optimised: reports of run times say so.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let level = std::env::var("OPT_LEVEL").unwrap_or_default();
    println!("cargo::rustc-env=SLITPOSE_OPT_LEVEL={level}");
}
