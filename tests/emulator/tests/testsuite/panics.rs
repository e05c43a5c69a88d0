//! The images could panic at no place that `firmware/PANICS.md` does not give a reason for.

use std::collections::BTreeMap;
use std::path::Path;

use slitpose_emulator::panics::sites;
use slitpose_emulator::rig::built_files;

#[test]
fn every_panic_that_the_images_could_reach_has_its_reason() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/PANICS.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let mut listed = BTreeMap::new();
    for row in page.lines().filter_map(|line| line.strip_prefix("| `")) {
        let columns: Vec<&str> = row.trim_end_matches(" |").split(" | ").collect();
        let [file, count, reason] = columns[..] else { panic!("three columns: {row}") };
        assert!(reason.len() > 5, "{file} has no reason");
        listed.insert(file.trim_end_matches('`').to_owned(), count.parse::<usize>().expect("a number"));
    }
    let images = built_files().unwrap_or_else(|error| panic!("{error}"));
    for file in &images {
        let mut found: BTreeMap<&str, Vec<_>> = BTreeMap::new();
        let sites = sites(file).unwrap_or_else(|error| panic!("{error}"));
        // The bounds checks of the outbox's ring at the least.
        assert!(sites.len() > 20, "{sites:?}");
        sites.iter().for_each(|site| found.entry(&site.file).or_default().push((site.line, &site.kind)));
        for (file, sites) in found {
            let most = listed.get(file).copied().unwrap_or(0);
            assert!(
                sites.len() <= most,
                "{file} could panic in {} places, and firmware/PANICS.md has reasons for {most}: say why, or do without: {sites:?}",
                sites.len()
            );
        }
    }
}
