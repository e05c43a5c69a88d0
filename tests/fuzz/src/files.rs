//! Scenes and tables from strangers.

use std::io::Cursor;

use slitpose_head::scene_file::{SceneFile, fnv1a_64};
use slitpose_head::table::TableReader;
use slitpose_model::{CompiledScene, Pose, Solver, Tier};

/// A scene is refused with a message that names the file, or compiles in all tiers and for the solver, has the hash of
/// its bytes each time it is read, and gives no current that is not a number at home.
pub(crate) fn scene(bytes: &[u8]) {
    let file = match SceneFile::from_bytes("stranger.toml", bytes) {
        Ok(file) => file,
        Err(error) => return assert!(error.to_string().contains("stranger.toml"), "no place: {error}"),
    };
    assert_eq!(file.hash, fnv1a_64(bytes));
    let again = SceneFile::parse("stranger.toml", &file.source).expect("its own source");
    assert_eq!((again.hash, &again.scene), (file.hash, &file.scene));
    let _ = slitpose_head::front_end::configuration(&file);
    let paper = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).expect("what parses compiles");
    let currents = |cell| paper.photocurrents(cell, &Pose::HOME);
    let is_number = |cell| currents(cell).i_x1_a.is_finite() && currents(cell).i_x2_a.is_finite();
    assert!((0..paper.cell_count()).all(is_number), "a current is no number");
    assert!(Solver::<f64>::new(&file.scene, Tier::Paper).is_ok());
    let exact = CompiledScene::<f32>::compile(&file.scene, Tier::Exact { tolerance: 1e-4 });
    assert!(exact.is_ok(), "compiles in double precision only");
}

/// A table has no more rows than lines, and every error names it.
pub(crate) fn table(bytes: &[u8]) {
    let lines = bytes.iter().filter(|&&byte| byte == b'\n' || byte == b'\r').count() + 1;
    let named = |message: String| assert!(message.contains("stranger.csv"), "no place: {message}");
    let mut table = match TableReader::new("stranger.csv", Cursor::new(bytes.to_vec())) {
        Ok(table) => table,
        Err(error) => return named(error.to_string()),
    };
    let column = table.column("tx_mm").map_err(|error| named(error.to_string())).ok();
    let mut rows = 0;
    loop {
        match table.next_row() {
            Ok(Some(row)) => {
                rows += 1;
                if let Some(column) = column {
                    match row.number(column) {
                        Ok(number) => assert!(number.is_finite()),
                        Err(error) => named(error.to_string()),
                    }
                }
            }
            Ok(None) => break,
            Err(error) => {
                named(error.to_string());
                break;
            }
        }
    }
    assert!(rows < lines, "{rows} rows of {lines} lines");
}
