//! The header in the repository is the one that the sources give: `SLITPOSE_WRITE=1` writes it.

use std::path::Path;

#[test]
fn header_follows_from_the_sources() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).unwrap();
    let sources = ["lib", "solution", "solver"].map(|name| folder.join(format!("src/{name}.rs")));
    let builder = cbindgen::Builder::new().with_config(config);
    let bindings = sources.iter().fold(builder, |builder, source| builder.with_src(source)).generate().unwrap();
    let mut made = Vec::new();
    bindings.write(&mut made);
    let header = folder.join("include/slitpose_solver.h");
    if std::env::var_os("SLITPOSE_WRITE").is_some() {
        std::fs::write(&header, &made).unwrap();
    }
    assert!(
        std::fs::read(&header).unwrap_or_default() == made,
        "{}: run SLITPOSE_WRITE=1 cargo test -p slitpose-capi --test header",
        header.display()
    );
}
