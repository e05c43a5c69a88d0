//! What belongs to a board in a capture: its scene, and how it was solved.

use std::collections::BTreeMap;
use std::path::Path;

use slitpose_model::Tier;

use crate::device::DeviceId;
use crate::pipeline::Following;
use crate::scene_file::{SceneFile, SceneFileError, fnv1a_64};

/// Name of the metadata records that hold a [`Setup`].
pub(super) const METADATA: &str = "slitpose.device";

/// How scans were solved while they were recorded: a replay without options does the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Equations.
    pub tier: Tier,
    /// What follows them.
    pub following: Following,
}

/// The scene of a board, as it was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CapturedScene {
    /// The scene's name.
    pub name: String,
    /// The path or the shipped scene's name it came from.
    pub origin: String,
    /// [`SceneFile::hash`].
    pub hash: u64,
    /// The text of the file.
    pub source: String,
}

impl CapturedScene {
    /// Reads the text again.
    ///
    /// # Errors
    /// If this version of the program does not know everything in it.
    pub fn parse(&self) -> Result<SceneFile, SceneFileError> {
        SceneFile::parse(&self.origin, &self.source)
    }
}

/// A board in a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Which one.
    pub device: DeviceId,
    /// Its head.
    pub scene: CapturedScene,
    /// How it was solved.
    pub settings: Settings,
    /// Version of the program that recorded.
    pub program: String,
}

/// Channels that can be told without their records, should those be lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LinkChannels {
    pub(super) link: u16,
    pub(super) hello: u16,
}

impl Setup {
    /// A board with the head of `file`, recorded by this program.
    pub fn new(device: DeviceId, file: &SceneFile, settings: Settings) -> Self {
        let scene = CapturedScene {
            name: file.name.clone(),
            origin: file.origin.clone(),
            hash: file.hash,
            source: file.source.clone(),
        };
        Self { device, scene, settings, program: env!("CARGO_PKG_VERSION").to_owned() }
    }

    /// Name of the attachment with the scene: that of its file. Two scenes of one name differ in
    /// their hash; tools make files of it, and not every system takes every name.
    pub(super) fn attachment(&self, is_taken: impl Fn(&str) -> bool) -> String {
        let is_plain = |char: char| char.is_alphanumeric() || "-_.".contains(char);
        let origin = Path::new(&self.scene.origin).file_stem().unwrap_or_default().to_string_lossy();
        let stem: String = origin.chars().map(|char| if is_plain(char) { char } else { '_' }).collect();
        let name = format!("{stem}.toml");
        if is_taken(&name) { format!("{stem}-{:016x}.toml", self.scene.hash) } else { name }
    }

    /// As the entries of a metadata record.
    pub(super) fn to_metadata(&self, attachment: &str, channels: LinkChannels) -> BTreeMap<String, String> {
        let Settings { tier, following } = self.settings;
        let mut map = BTreeMap::new();
        let mut put = |key: &str, value: String| map.insert(key.to_owned(), value);
        put("device", self.device.to_string());
        put("program", self.program.clone());
        put("scene", attachment.to_owned());
        put("scene_name", self.scene.name.clone());
        put("scene_origin", self.scene.origin.clone());
        put("scene_hash", format!("{:016x}", self.scene.hash));
        match tier {
            Tier::Paper => put("tier", "paper".to_owned()),
            Tier::Exact { tolerance } => {
                put("tolerance", tolerance.to_string());
                put("tier", "exact".to_owned())
            }
        };
        if let Some(filter_s) = following.filter_s {
            put("filter_s", filter_s.to_string());
        }
        put("without_clipped", following.without_clipped.to_string());
        put("link_channel", channels.link.to_string());
        put("hello_channel", channels.hello.to_string());
        map
    }

    /// From the entries of a metadata record and the attachments before it; `None` if something is
    /// missing or does not agree.
    pub(super) fn from_metadata(
        map: &BTreeMap<String, String>,
        attachments: &BTreeMap<String, String>,
    ) -> Option<(Self, LinkChannels)> {
        let get = |key: &str| map.get(key);
        let source = attachments.get(get("scene")?)?.clone();
        let hash = u64::from_str_radix(get("scene_hash")?, 16).ok()?;
        if fnv1a_64(source.as_bytes()) != hash {
            return None;
        }
        let tier = match get("tier")?.as_str() {
            "paper" => Tier::Paper,
            "exact" => Tier::Exact { tolerance: get("tolerance")?.parse().ok()? },
            _ => return None,
        };
        let filter_s = get("filter_s").map(|text| text.parse()).transpose().ok()?;
        let following = Following { filter_s, without_clipped: get("without_clipped")?.parse().ok()? };
        let scene =
            CapturedScene { name: get("scene_name")?.clone(), origin: get("scene_origin")?.clone(), hash, source };
        let setup = Self {
            device: get("device")?.parse().ok()?,
            scene,
            settings: Settings { tier, following },
            program: get("program")?.clone(),
        };
        let channels =
            LinkChannels { link: get("link_channel")?.parse().ok()?, hello: get("hello_channel")?.parse().ok()? };
        Some((setup, channels))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene_file::WIDE;

    #[test]
    fn setups_come_back_as_they_were() {
        let file = WIDE.read().unwrap();
        let channels = LinkChannels { link: 1, hello: 7 };
        for (tier, filter_s, without_clipped) in
            [(Tier::Paper, None, true), (Tier::Exact { tolerance: 1.0 / 3.0e6 }, Some(0.1 + 0.2), false)]
        {
            let settings = Settings { tier, following: Following { filter_s, without_clipped } };
            let setup = Setup::new(DeviceId(*b"0123456789ab"), &file, settings);
            let name = setup.attachment(|_| false);
            assert_eq!(name, "wide.toml");
            let map = setup.to_metadata(&name, channels);
            let mut attachments = BTreeMap::from([(name.clone(), file.source.clone())]);
            assert_eq!(Setup::from_metadata(&map, &attachments), Some((setup, channels)));
            attachments.insert(name, "other".to_owned());
            assert_eq!(Setup::from_metadata(&map, &attachments), None);
        }
    }

    #[test]
    fn names_of_attachments_are_fit_for_files() {
        let mut file = WIDE.read().unwrap();
        file.origin = "../scenes/a b.toml".to_owned();
        let settings = Settings { tier: Tier::Paper, following: Following::default() };
        let setup = Setup::new(DeviceId::default(), &file, settings);
        assert_eq!(setup.attachment(|_| false), "a_b.toml");
        assert_eq!(setup.attachment(|name| name == "a_b.toml"), format!("a_b-{:016x}.toml", file.hash));
    }
}
