//! The pictures in the README are what the program draws.

use slitpose_tests::reference::data;
use slitpose_tests::slitpose;

#[test]
fn the_readme_shows_what_the_program_draws() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let drawn = folder.path().join("drawn.svg");
    for (name, arguments) in [
        ("wide.svg", ["scene", "plot", "wide", "--pose", "1.5,-1,2,0,4,8"].as_slice()),
        ("cell.svg", &["scene", "plot", "bench", "--cell", "0", "--pose", "2,0,0,0,0,0"]),
    ] {
        let output = ["--output", drawn.to_str().expect("UTF-8")];
        let finished = slitpose!().run(arguments.iter().chain(&output));
        assert_eq!(finished.code, 0, "{}", finished.stderr);
        let shown = data("../../host/pictures").join(name);
        let read = |path: &std::path::Path| std::fs::read_to_string(path).expect("picture");
        assert!(read(&shown) == read(&drawn), "{name}: draw it anew with `slitpose {}`", arguments.join(" "));
    }
}
