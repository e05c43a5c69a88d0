//! Numbers of `firmware/README.md` that arithmetic gives are those of the program that does it.

use std::path::Path;
use std::process::Command;

#[test]
fn the_tables_of_the_analogue_front_end_are_those_of_the_program() {
    let firmware = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware");
    let printed = Command::new("python3").arg(firmware.join("analogue")).output().expect("python3 runs");
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    let printed = String::from_utf8(printed.stdout).expect("UTF-8");
    let page = std::fs::read_to_string(firmware.join("README.md")).expect("the page");
    let rows: Vec<&str> = printed.lines().filter(|line| line.starts_with('|')).collect();
    assert!(rows.len() > 20, "{printed}");
    for row in rows {
        assert!(page.lines().any(|line| line == row), "firmware/README.md lacks: {row}");
    }
}
