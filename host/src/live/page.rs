//! The files of the page, within the program.

/// A file: its path after `/`, its media type, its text.
pub(super) type PageFile = (&'static str, &'static str, &'static str);

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// In the page's text: the version of the program.
pub(super) const VERSION_MARK: &str = "SLITPOSE_VERSION";

macro_rules! files {
    ($($media:ident $name:literal)*) => {
        [$(($name, $media, include_str!(concat!("page/", $name)))),*]
    };
}

/// All of them; the first is the page itself.
pub(super) const FILES: &[PageFile] = &files! {
    HTML "index.html"
    JAVASCRIPT "banner.js"
    JAVASCRIPT "camera.js"
    JAVASCRIPT "daemon.js"
    JAVASCRIPT "dom.js"
    JAVASCRIPT "findings.js"
    JAVASCRIPT "format.js"
    JAVASCRIPT "gestures.js"
    JAVASCRIPT "head.js"
    JAVASCRIPT "history.js"
    SVG "icon.svg"
    JAVASCRIPT "link.js"
    JAVASCRIPT "main.js"
    JAVASCRIPT "numbers.js"
    JAVASCRIPT "palette.js"
    JAVASCRIPT "placement.js"
    JAVASCRIPT "player.js"
    JAVASCRIPT "plots.js"
    JAVASCRIPT "strips.js"
    CSS "style.css"
    JAVASCRIPT "timeline.js"
    JAVASCRIPT "vectors.js"
    JAVASCRIPT "view3d.js"
};

#[cfg(test)]
mod tests {
    use super::*;

    /// All of it comes over a phone's network.
    const MOST_BYTES: usize = 200_000;

    #[test]
    fn the_page_is_small_whole_and_fetches_nothing_from_elsewhere() {
        let bytes: usize = FILES.iter().map(|(_, _, text)| text.len()).sum();
        println!("{bytes} bytes in {} files", FILES.len());
        assert!(bytes <= MOST_BYTES, "{bytes}");
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/live/page");
        let mut there: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        there.sort();
        let mut served: Vec<_> = FILES.iter().map(|(name, _, _)| (*name).to_owned()).collect();
        served.sort();
        assert_eq!(served, there, "files of the page that are not served, or the other way round");
        for (name, media, text) in FILES {
            for import in text.lines().filter_map(|line| line.split(" from \"./").nth(1)) {
                let module = import.split('"').next().unwrap();
                assert!(served.iter().any(|file| file == module), "{name} imports {module}");
            }
            let elsewhere = text.replace("http://www.w3.org/2000/svg", "");
            assert!(!elsewhere.contains("https://") && !elsewhere.contains("http://"), "{name}");
            if *media == HTML {
                assert!(text.contains(VERSION_MARK) && !text.contains("<style") && !text.contains(" style="), "{name}");
            }
        }
    }
}
