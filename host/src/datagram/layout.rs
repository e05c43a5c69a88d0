//! The bytes of datagrams, requests and answers, as [`super`] describes them.

use bytes::BufMut;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::columns::no_twist;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Outcomes, Record};

const POSE_MAGIC: [u8; 4] = *b"SLPP";
const REQUEST_MAGIC: [u8; 4] = *b"SLPQ";
const ANSWER_MAGIC: [u8; 4] = *b"SLPA";
const VERSION: u16 = 1;

const HAS_POSE: u32 = 1;
const HAS_TWIST: u32 = 2;
const HAS_HOST_TIME: u32 = 4;
const HAS_ARRIVAL: u32 = 8;
const IS_SIMULATED: u32 = 16;
const IS_BEHIND: u32 = 32;
const IN_FRAME: u32 = 64;

const AT_FLAGS: usize = 8;
const AT_MISSED: usize = 40;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PoseDatagram([u8; Self::BYTES]);

impl PoseDatagram {
    pub const BYTES: usize = 560;

    /// The datagram of `record` with the number `number`, made at `now`.
    pub fn new(record: &Record, number: u64, now: HostInstant) -> Self {
        let solution = &record.solution;
        let flags = [
            (HAS_POSE, solution.estimate.is_some()),
            (HAS_TWIST, record.twist.is_ok()),
            (HAS_HOST_TIME, record.host_time.is_some()),
            (HAS_ARRIVAL, record.arrival.is_some()),
            (IS_SIMULATED, record.simulated),
            (IN_FRAME, record.view.is_some()),
        ];
        let flags = flags.iter().filter(|(_, is_set)| *is_set).fold(0, |flags, (flag, _)| flags | flag);

        let mut bytes = [0; Self::BYTES];
        let mut out = &mut bytes[..];
        out.put_slice(&POSE_MAGIC);
        out.put_u16_le(VERSION);
        out.put_u16_le(Self::BYTES as u16);
        out.put_u32_le(flags);
        out.put_u16_le(Outcomes::number_of(&solution.outcome));
        out.put_u16_le(solution.cells_used.count() as u16);
        out.put_slice(&record.device.0);
        out.put_u16_le(solution.excluded.bits());
        out.put_u16_le(solution.redundancy as u16);

        let (time, arrival) = (record.host_time, record.arrival);
        for number in [
            number,
            0,
            record.sequence,
            (record.device_time_s * 1e9).round() as u64,
            time.map_or(0, |time| time.monotonic_ns),
            time.map_or(0, |time| time.utc_ns),
            time.map_or(0, |time| time.uncertainty_ns),
            arrival.map_or(0, |arrival| arrival.monotonic_ns),
            now.monotonic_ns,
        ] {
            out.put_u64_le(number);
        }

        let estimate = solution.estimate;
        put(&mut out, estimate.map(|estimate| estimate.pose.translation_m.to_array()));
        put(&mut out, estimate.map(|estimate| estimate.pose.rotation.to_array()));
        for row in 0..6 {
            put(&mut out, estimate.map(|estimate| estimate.covariance[row]));
        }
        let twist = record.twist.ok();
        put(&mut out, twist.map(|estimate| estimate.twist.linear_m_per_s.to_array()));
        put(&mut out, twist.map(|estimate| estimate.twist.angular_rad_per_s.to_array()));
        put::<6>(&mut out, twist.map(|estimate| std::array::from_fn(|i| estimate.covariance[i][i].sqrt())));
        put(&mut out, record.light_level.map(|level| [level]));
        out.put_u64_le(no_twist(&record.twist) as u64);
        Self(bytes)
    }

    /// Marks that scans before this one were skipped, and the next may be, too.
    pub(crate) fn mark_behind(&mut self) {
        self.0[AT_FLAGS] |= IS_BEHIND as u8;
    }

    /// Sets the number of datagrams that the receiver has missed.
    pub(super) fn set_missed(&mut self, missed: u64) {
        self.0[AT_MISSED..AT_MISSED + 8].copy_from_slice(&missed.to_le_bytes());
    }

    pub fn as_bytes(&self) -> &[u8; Self::BYTES] {
        &self.0
    }

    pub(super) fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }
}

/// Writes numbers, or as many that are none.
fn put<const N: usize>(out: &mut &mut [u8], values: Option<[f64; N]>) {
    values.unwrap_or([f64::NAN; N]).into_iter().for_each(|value| out.put_f64_le(value));
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// The number of datagrams.
    pub mode: Mode,
    pub device: Option<DeviceId>,
    /// The cookie last received, 0 before that. Unix sockets need none.
    pub cookie: u64,
}

/// The number of datagrams that a client requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The newest datagram of each board.
    Newest,
    /// All datagrams of the next seconds.
    Follow,
}

impl Request {
    pub const BYTES: usize = 32;

    const SHORT_BYTES: usize = 24;

    pub fn new(mode: Mode, device: Option<DeviceId>) -> Self {
        Self { mode, device, cookie: 0 }
    }

    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mode: u16 = match self.mode {
            Mode::Newest => 1,
            Mode::Follow => 2,
        };
        let mut bytes = [0; Self::BYTES];
        begin(&mut bytes, REQUEST_MAGIC, mode);
        bytes[12..Self::SHORT_BYTES].copy_from_slice(&self.device.unwrap_or_default().0);
        bytes[Self::SHORT_BYTES..].copy_from_slice(&self.cookie.to_le_bytes());
        bytes
    }

    /// The request in `bytes`; `None` if they are not a request of this version.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut whole = [0; Self::BYTES];
        whole.get_mut(..bytes.len())?.copy_from_slice(bytes);
        if bytes.len() == Self::SHORT_BYTES && whole[6..8] == (Self::SHORT_BYTES as u16).to_le_bytes() {
            whole[6..8].copy_from_slice(&(Self::BYTES as u16).to_le_bytes());
        } else if bytes.len() != Self::BYTES {
            return None;
        }
        let (head, cookie) = whole.split_last_chunk()?;
        let cookie = u64::from_le_bytes(*cookie);
        let device = DeviceId(head.get(12..)?.try_into().ok()?);
        let device = Some(device).filter(|device| *device != DeviceId::default());
        [Mode::Newest, Mode::Follow]
            .map(|mode| Self { mode, device, cookie })
            .into_iter()
            .find(|request| request.to_bytes() == whole)
    }
}

/// An answer to a client other than a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Ask again with this cookie.
    Prove(u64),
    Refused,
    /// Served; here is a newer cookie.
    Renew(u64),
}

impl Answer {
    /// Its length: no more than that of any request.
    pub const BYTES: usize = Request::SHORT_BYTES;

    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let (kind, cookie) = match self {
            Self::Prove(cookie) => (1, cookie),
            Self::Refused => (2, 0),
            Self::Renew(cookie) => (3, cookie),
        };
        let mut bytes = [0; Self::BYTES];
        begin(&mut bytes, ANSWER_MAGIC, kind);
        bytes[16..].copy_from_slice(&cookie.to_le_bytes());
        bytes
    }

    /// The answer in `bytes`; `None` if they are not an answer of this version.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let cookie = u64::from_le_bytes(*bytes.last_chunk()?);
        [Self::Prove(cookie), Self::Refused, Self::Renew(cookie)].into_iter().find(|answer| answer.to_bytes() == bytes)
    }
}

fn begin<const N: usize>(bytes: &mut [u8; N], magic: [u8; 4], kind: u16) {
    bytes[..4].copy_from_slice(&magic);
    bytes[4..6].copy_from_slice(&VERSION.to_le_bytes());
    bytes[6..8].copy_from_slice(&(N as u16).to_le_bytes());
    bytes[8..10].copy_from_slice(&kind.to_le_bytes());
}
