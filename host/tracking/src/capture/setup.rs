//! The setup of a board in a capture: its scene, what its head was known by, and how it was solved.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use slitpose_calibration::{Basis, Calibration, CalibrationFileError, Head};
use slitpose_model::{Cell, Tier};
use thiserror::Error;

use crate::link::DeviceId;
use crate::pipeline::{PipelineOptions, PoseSource};
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::{SceneFile, SceneFileError, fnv1a_64};

/// Name of the metadata records that hold a [`Setup`].
pub(super) const METADATA: &str = "slitpose.device";

/// How scans were solved during the recording, and are solved by a replay without options.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How exactly the optics were evaluated.
    pub tier: Tier,
    /// How scans were followed.
    pub following: PipelineOptions,
}

/// The scene of a board, as it was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CapturedScene {
    pub name: String,
    /// Its origin: a path, or the name of a shipped scene.
    pub origin: String,
    /// [`SceneFile::hash`].
    pub hash: u64,
    pub source: Arc<str>,
}

impl CapturedScene {
    pub fn parse(&self) -> Result<SceneFile, SceneFileError> {
        SceneFile::parse(&self.origin, &self.source)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CapturedCalibration {
    name: String,
    /// FNV-1a, 64 bits, of the text.
    hash: u64,
    source: Arc<str>,
}

impl CapturedCalibration {
    pub fn parse(&self) -> Result<Calibration, CalibrationFileError> {
        Calibration::from_bytes(&self.name, self.source.as_bytes())
    }
}

/// What a head was known by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CapturedBasis {
    /// Its scene alone.
    Scene,
    /// A calibration.
    Calibration(CapturedCalibration),
    /// The tolerances of its parts.
    Tolerances,
}

/// Everything that is needed to solve the scans of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The board.
    pub device: DeviceId,
    /// Its scene.
    pub scene: CapturedScene,
    /// What its head was known by.
    pub basis: CapturedBasis,
    /// How its scans were solved.
    pub settings: Settings,
    /// Version of the program that recorded.
    pub program: String,
}

/// Numbers of a board's channels, by which data are found if the records of the channels are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LinkChannels {
    pub(super) link: u16,
    pub(super) hello: u16,
}

impl Setup {
    /// A board with `head`, recorded by this program.
    pub fn new(device: DeviceId, head: &Head, settings: Settings) -> Self {
        let file = &head.file;
        let basis = match &head.basis {
            Basis::Scene => CapturedBasis::Scene,
            Basis::Tolerances => CapturedBasis::Tolerances,
            Basis::Calibration(calibration) => CapturedBasis::Calibration(CapturedCalibration {
                name: format!("calibration-{:016x}.toml", calibration.hash()),
                hash: fnv1a_64(calibration.source().as_bytes()),
                source: calibration.source().into(),
            }),
        };
        let scene = CapturedScene {
            name: file.name.clone(),
            origin: file.origin.clone(),
            hash: file.hash,
            source: file.source.as_str().into(),
        };
        Self { device, scene, basis, settings, program: env!("CARGO_PKG_VERSION").to_owned() }
    }

    /// The cells of the head, for pictures; `None` if scene or calibration cannot be read.
    pub(super) fn cells(&self) -> Option<Vec<Cell>> {
        let file = self.scene.parse().ok()?;
        let scene = match &self.basis {
            CapturedBasis::Calibration(calibration) => calibration.parse().ok()?.apply(&file).ok()?,
            // Tolerances leave the parts where they are.
            CapturedBasis::Scene | CapturedBasis::Tolerances => file.scene,
        };
        Some(scene.cells.to_vec())
    }

    /// The calibration as an attachment: name and text.
    pub(super) fn calibration(&self) -> Option<(&str, &Arc<str>)> {
        match &self.basis {
            CapturedBasis::Calibration(calibration) => Some((&calibration.name, &calibration.source)),
            CapturedBasis::Scene | CapturedBasis::Tolerances => None,
        }
    }

    /// Name of the attachment with the scene: that of its file, with its hash if the name is taken. It is
    /// valid as a file name on every system.
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
        match &self.basis {
            CapturedBasis::Scene => {}
            CapturedBasis::Tolerances => drop(put("uncalibrated", "true".to_owned())),
            CapturedBasis::Calibration(calibration) => {
                put("calibration", calibration.name.clone());
                put("calibration_hash", format!("{:016x}", calibration.hash));
            }
        }
        match tier {
            Tier::Paper => put("tier", "paper".to_owned()),
            Tier::Exact { tolerance } => {
                put("tolerance", tolerance.to_string());
                put("tier", "exact".to_owned())
            }
        };
        if following.source == PoseSource::Board {
            put("poses", "board".to_owned());
        }
        if let Some(filter_s) = following.filter_s {
            put("filter_s", filter_s.to_string());
        }
        put("without_clipped", following.without_clipped.to_string());
        if following.known_light {
            put("known_light", "true".to_owned());
        }
        put("link_channel", channels.link.to_string());
        put("hello_channel", channels.hello.to_string());
        let hash = settings_hash(&map);
        map.insert(HASH.to_owned(), format!("{hash:016x}"));
        map
    }

    /// From the entries of a metadata record, and the scenes and calibrations of the file by their hashes.
    pub(super) fn from_metadata(
        map: &BTreeMap<String, String>,
        texts: &Texts,
    ) -> Result<(Self, LinkChannels), SetupError> {
        let stated = map.get(HASH).and_then(|hash| u64::from_str_radix(hash, 16).ok());
        if stated != Some(settings_hash(map)) {
            return Err(SetupError::Damaged);
        }
        let get = |key: &'static str| map.get(key).ok_or(SetupError::Damaged);
        let value = |key: &'static str, expected: &'static str| {
            let value = map.get(key).cloned().unwrap_or_default();
            SetupError::Value { device: map.get("device").cloned().unwrap_or_default(), key, value, expected }
        };
        let number = |key: &'static str, expected: &'static str, is_fit: fn(f64) -> bool| {
            let number = get(key)?.parse::<f64>().ok();
            number.filter(|number| is_fit(*number)).ok_or_else(|| value(key, expected))
        };
        let channel = |key: &'static str| get(key)?.parse::<u16>().map_err(|_| value(key, "a channel from 0 to 65535"));
        let tier = match get("tier")?.as_str() {
            "paper" => Tier::Paper,
            "exact" => Tier::Exact {
                tolerance: number("tolerance", "a number between 0 and 1", |number| number > 0.0 && number < 1.0)?,
            },
            _ => return Err(value("tier", "`paper` or `exact`")),
        };
        let filter_s = match map.get("filter_s") {
            Some(_) => {
                Some(number("filter_s", "a number of seconds above 0", |number| number > 0.0 && number.is_finite())?)
            }
            None => None,
        };
        let without_clipped =
            get("without_clipped")?.parse().map_err(|_| value("without_clipped", "`true` or `false`"))?;
        let device = get("device")?.parse().map_err(|_| value("device", "24 hexadecimal digits"))?;
        let hash =
            |key: &'static str| u64::from_str_radix(get(key)?, 16).map_err(|_| value(key, "16 hexadecimal digits"));
        let basis = match map.get("calibration") {
            Some(name) => {
                let hash = hash("calibration_hash")?;
                let source = texts.get(&hash).cloned().ok_or(SetupError::Calibration { hash })?;
                CapturedBasis::Calibration(CapturedCalibration { name: name.clone(), hash, source })
            }
            None => match map.get("uncalibrated").map(String::as_str) {
                None | Some("false") => CapturedBasis::Scene,
                Some("true") => CapturedBasis::Tolerances,
                Some(_) => return Err(value("uncalibrated", "`true` or `false`")),
            },
        };
        let hash = hash("scene_hash")?;
        let source = texts.get(&hash).cloned().ok_or(SetupError::Scene { hash })?;
        let scene =
            CapturedScene { name: get("scene_name")?.clone(), origin: get("scene_origin")?.clone(), hash, source };
        let source = match map.get("poses").map(String::as_str) {
            None => PoseSource::Host,
            Some("board") => PoseSource::Board,
            Some(_) => return Err(value("poses", "`board`, or nothing")),
        };
        let known_light = match map.get("known_light").map(String::as_str) {
            None => false,
            Some("true") => true,
            Some(_) => return Err(value("known_light", "`true`, or nothing")),
        };
        let settings = Settings { tier, following: PipelineOptions { source, filter_s, without_clipped, known_light } };
        let setup = Self { device, scene, basis, settings, program: get("program")?.clone() };
        Ok((setup, LinkChannels { link: channel("link_channel")?, hello: channel("hello_channel")? }))
    }
}

/// Texts of scenes and calibrations by their hashes.
pub(super) type Texts = BTreeMap<u64, Arc<str>>;

/// Key of the hash over all other entries.
const HASH: &str = "settings_hash";

/// FNV-1a, 64 bits, of all entries but the hash itself, in the order of their keys: key, 0, value, 0.
fn settings_hash(map: &BTreeMap<String, String>) -> u64 {
    let mut bytes = Vec::new();
    for text in map.iter().filter(|(key, _)| *key != HASH).flat_map(|(key, value)| [key, value]) {
        bytes.extend_from_slice(text.as_bytes());
        bytes.push(0);
    }
    fnv1a_64(&bytes)
}

/// Why the settings of a board cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum SetupError {
    #[error("settings of a board are damaged")]
    Damaged,
    #[error(
        "the settings of board {} say {key} = `{}`, and {expected} is needed; \
         give --scene, and what else differs from the defaults, to solve its bytes all the same",
        printable(device),
        printable(value)
    )]
    Value { device: String, key: &'static str, value: String, expected: &'static str },
    #[error("the scene of hash {hash:016x} is missing or damaged")]
    Scene { hash: u64 },
    #[error("the calibration of hash {hash:016x} is missing or damaged")]
    Calibration { hash: u64 },
    #[error("the capture holds more than {limit} boards; the others are passed over")]
    TooMany { limit: usize },
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;

    #[test]
    fn setups_come_back_as_they_were() {
        let file = WIDE.read().unwrap();
        let channels = LinkChannels { link: 1, hello: 7 };
        for (tier, source, filter_s, without_clipped) in [
            (Tier::Paper, PoseSource::Host, None, true),
            (Tier::Exact { tolerance: 1.0 / 3.0e6 }, PoseSource::Board, Some(0.1 + 0.2), false),
        ] {
            let following = PipelineOptions { source, filter_s, without_clipped, known_light: !without_clipped };
            let settings = Settings { tier, following };
            let setup = Setup::new(DeviceId(*b"0123456789ab"), &file.clone().into(), settings);
            let name = setup.attachment(|_| false);
            assert_eq!(name, "wide.toml");
            let map = setup.to_metadata(&name, channels);
            let scenes = BTreeMap::from([(file.hash, file.source.clone().into())]);
            assert_eq!(Setup::from_metadata(&map, &scenes), Ok((setup, channels)));
            let missing = Setup::from_metadata(&map, &BTreeMap::new());
            assert_eq!(missing, Err(SetupError::Scene { hash: file.hash }));
        }
    }

    fn entries() -> (BTreeMap<String, String>, Texts) {
        let file = WIDE.read().unwrap();
        let following = PipelineOptions { filter_s: Some(0.005), ..PipelineOptions::default() };
        let settings = Settings { tier: Tier::Exact { tolerance: 1e-6 }, following };
        let setup = Setup::new(DeviceId(*b"0123456789ab"), &file.clone().into(), settings);
        let map = setup.to_metadata("wide.toml", LinkChannels { link: 1, hello: 7 });
        (map, BTreeMap::from([(file.hash, file.source.into())]))
    }

    #[test]
    fn values_without_sense_are_refused_by_name() {
        let (map, scenes) = entries();
        for (key, values) in [
            ("tolerance", &["NaN", "0", "-1", "inf", "1", "1e-6x", ""][..]),
            ("filter_s", &["NaN", "0", "-0.005", "inf", "soon"]),
            ("tier", &["Exact", ""]),
            ("without_clipped", &["1"]),
            ("known_light", &["false", "1"]),
            ("device", &["0123"]),
            ("link_channel", &["65536", "-1"]),
        ] {
            for value in values {
                let mut changed = map.clone();
                changed.insert(key.to_owned(), (*value).to_owned());
                changed.insert(HASH.to_owned(), format!("{:016x}", settings_hash(&changed)));
                let message = Setup::from_metadata(&changed, &scenes).unwrap_err().to_string();
                assert!(message.contains(&format!("{key} = `{value}`")), "{message}");
            }
        }
    }

    #[test]
    fn names_of_attachments_are_fit_for_files() {
        let mut file = WIDE.read().unwrap();
        file.origin = "../scenes/a b.toml".to_owned();
        let settings = Settings { tier: Tier::Paper, following: PipelineOptions::default() };
        let setup = Setup::new(DeviceId::default(), &file.clone().into(), settings);
        assert_eq!(setup.attachment(|_| false), "a_b.toml");
        assert_eq!(setup.attachment(|name| name == "a_b.toml"), format!("a_b-{:016x}.toml", file.hash));
    }
}
