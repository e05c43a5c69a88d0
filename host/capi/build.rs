//! Names the library as programs on Linux look for it: with the number of its ABI, so that one of another ABI can lie beside it.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libslitpose_solver.so.1");
    }
}
