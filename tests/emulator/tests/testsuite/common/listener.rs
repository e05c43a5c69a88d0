//! Everything that a board says at its link, decoded into messages of its own, and checked for what must hold of any of
//! them: scans in order, counters that add up.

use super::is_of_silicon;
use slitpose_emulator::peripherals::Ticks;
use slitpose_protocol::poses::TRIANGLE;
use slitpose_protocol::{
    AdcScaling, Batch, Decoder, Edge, Edges, Hashes, MAX_MESSAGE_BYTES, Message, Pong, PoseRecord, RawScan, Rejection,
    Reply, ResetCause, Schedule, Severity, Status,
};

/// Scans that fit the board: 25 KB of packets of four scans and at least 218 bytes, and a batch
/// under way.
const ON_BOARD_SCANS: u64 = 480;

/// Scans in a transfer of 1 KB, which is lost if the link breaks while it is sent.
pub const TRANSFER_SCANS: u64 = 20;

/// Breaks of links by which every scan may be lost: what becomes of scans is no concern then.
pub const MANY_BREAKS: u64 = 1_000_000;

#[derive(Clone, Debug, PartialEq)]
pub struct Introduction {
    pub device_id: [u8; 12],
    pub board: String,
    pub reset_cause: ResetCause,
    pub hashes: Hashes,
    pub scaling: AdcScaling,
    pub configuration: u16,
    pub schedule: Schedule,
}

/// A message, of which scans are kept elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    Hello(Introduction),
    /// Number of the configuration, first sequence number, scans.
    Batch(u16, u64, u64),
    Status(Status),
    Event(u64, Severity, String),
    Reply(Reply),
    Pong(Pong),
}

/// A place where scans do not follow one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The last scan before it.
    pub after: u64,
    pub missing: u64,
    /// From the start of the frame before it to that of the one behind it.
    pub ticks: u64,
}

#[derive(Debug, Default)]
pub struct Listener {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<(u16, Schedule)>,
    pub said: Vec<(Ticks, Said)>,
    pub scans: Vec<RawScan>,
    pub gaps: Vec<Gap>,
    /// Scans since the board started, also those that were forgotten here.
    pub received: u64,
    last: Option<(u64, u64)>,
    /// How often a link was closed or broken: what was on its way is lost.
    pub breaks: u64,
    pub status: Option<Status>,
    /// Numbers of the heads of all packets of poses.
    pub heads: Vec<u32>,
    /// Poses of the board with sequence and tick of their scans, each with the tick of power at which its packet was over.
    pub poses: Vec<(Ticks, (u64, u64, PoseRecord))>,
    /// Covariances, each with the index of its pose.
    pub covariances: Vec<(usize, [f32; TRIANGLE])>,
    /// Edges of the trigger input, in the order of their numbers, and those that were missed.
    pub edges: Vec<Edge>,
    pub missed_edges: u32,
    /// Scans that the board has not solved, by the last packet of poses.
    pub missed: u32,
    /// Empty packets, and the instants of packets that were full and had none behind them.
    pub empty_packets: usize,
    full_since: Option<Ticks>,
    /// The longest that the end of a transfer was waited for behind a full packet.
    pub longest_full: Ticks,
}

impl Listener {
    /// The board starts anew, and its counters with it.
    pub fn forget_board(&mut self) {
        *self = Self { breaks: self.breaks, ..Self::default() };
    }

    /// A program opens the port: it has seen nothing yet.
    pub fn begin_session(&mut self) {
        self.decoder = Decoder::new();
        self.schedule = None;
        self.full_since = None;
        self.said.clear();
    }

    /// Forgets scans, gaps and messages, but not the counts.
    pub fn clear(&mut self) {
        self.said.clear();
        self.scans.clear();
        self.gaps.clear();
    }

    /// Frames that were damaged, in this session.
    pub fn damaged(&self) -> u64 {
        let counters = self.decoder.counters();
        counters.overlong + counters.misframed + counters.bad_checksum + counters.unknown + counters.malformed
    }

    /// Takes in a packet that was over at `at`.
    pub fn hear(&mut self, at: Ticks, bytes: &[u8]) {
        if let Some(since) = self.full_since.take() {
            self.longest_full = self.longest_full.max(at - since);
        }
        match bytes.len() {
            0 => self.empty_packets += 1,
            64 => self.full_since = Some(at),
            _ => {}
        }
        let mut decoder = std::mem::take(&mut self.decoder);
        let mut rest = bytes;
        while let Some(result) = decoder.next::<Message>(&mut rest) {
            if let Ok(message) = result {
                self.take(at, message);
            }
        }
        self.decoder = decoder;
    }

    fn take(&mut self, at: Ticks, message: Message<'_>) {
        let said = match message {
            Message::Hello(hello) => {
                assert_eq!(hello.check_schemas(), Ok(()));
                self.schedule = Some((hello.configuration, hello.schedule.clone()));
                Said::Hello(Introduction {
                    device_id: hello.device_id,
                    board: hello.board.to_owned(),
                    reset_cause: hello.reset_cause,
                    hashes: hello.hashes,
                    scaling: hello.scaling,
                    configuration: hello.configuration,
                    schedule: hello.schedule,
                })
            }
            Message::Batch(batch) => self.take_batch(&batch),
            Message::Status(status) => {
                self.check_account(&status);
                self.status = Some(status);
                Said::Status(status)
            }
            Message::Event(event) => Said::Event(event.tick, event.severity, event.text.to_owned()),
            Message::Reply(reply) => Said::Reply(reply),
            Message::Pong(pong) => Said::Pong(pong),
            Message::Truth(truth) => panic!("a physical board knows the truth: {truth:?}"),
            Message::Edges(Edges { number, missed, edges }) => {
                assert!(number as usize >= self.edges.len(), "{number}: none comes twice");
                self.missed_edges = missed;
                self.edges.extend(edges);
                return;
            }
            Message::Poses(poses) => {
                let frame_ticks = self.schedule().frame_ticks;
                self.heads.push(poses.head);
                self.missed = poses.missed;
                self.poses.extend(poses.iter(frame_ticks).map(|pose| (at, pose)));
                let last = self.poses.len() - 1;
                self.covariances.extend(poses.covariance.map(|covariance| (last, covariance)));
                return;
            }
        };
        self.said.push((at, said));
    }

    /// By the last hello.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule.as_ref().expect("a hello comes first").1
    }

    fn take_batch(&mut self, batch: &Batch<'_>) -> Said {
        let (number, schedule) = self.schedule.as_ref().expect("a hello comes before the first batch");
        assert_eq!(batch.configuration, *number, "the last hello announces the configuration of a batch");
        let frame_ticks = u64::from(schedule.frame_ticks);
        let scans = batch.scans(schedule).expect("a batch agrees with the schedule of its hello");
        let count = scans.len() as u64;
        for scan in scans {
            if let Some((sequence, tick)) = self.last {
                assert!(
                    scan.sequence > sequence && scan.tick > tick,
                    "scan {} at {} behind scan {sequence} at {tick}",
                    scan.sequence,
                    scan.tick
                );
                let (missing, ticks) = (scan.sequence - sequence - 1, scan.tick - tick);
                if (missing, ticks) != (0, frame_ticks) {
                    self.gaps.push(Gap { after: sequence, missing, ticks });
                }
            }
            self.last = Some((scan.sequence, scan.tick));
            self.received += 1;
            self.scans.push(scan);
        }
        Said::Batch(batch.configuration, batch.sequence, count)
    }

    /// Scans on the board by what a status and this end have counted.
    pub fn unaccounted(&self, status: &Status) -> u64 {
        let known = self.received + status.scans_dropped + status.scans_lost;
        status
            .scans_taken
            .checked_sub(known)
            .unwrap_or_else(|| panic!("{} received, more than {status:?}", self.received))
    }

    fn check_account(&self, status: &Status) {
        let most = ON_BOARD_SCANS + self.breaks * TRANSFER_SCANS;
        let unaccounted = self.unaccounted(status);
        assert!(unaccounted <= most, "{unaccounted} scans unaccounted for, {} received: {status:?}", self.received);
    }

    pub fn replies(&self, number: u16) -> Vec<Result<(), Rejection>> {
        let reply = |said: &(Ticks, Said)| match said.1 {
            Said::Reply(reply) if reply.number == number => Some(reply.outcome),
            _ => None,
        };
        self.said.iter().filter_map(reply).collect()
    }

    /// Whether each command of this session was accepted, in the order of the replies.
    pub fn accepted(&self) -> Vec<bool> {
        let said = self.said.iter();
        said.filter_map(|(_, said)| if let Said::Reply(reply) = said { Some(reply.outcome.is_ok()) } else { None })
            .collect()
    }

    pub fn hello(&self) -> Option<&Introduction> {
        self.said.iter().rev().find_map(|(_, said)| if let Said::Hello(hello) = said { Some(hello) } else { None })
    }

    pub fn hellos(&self) -> usize {
        self.said.iter().filter(|(_, said)| matches!(said, Said::Hello(_))).count()
    }

    /// Without those that faults of the silicon make for.
    pub fn events(&self) -> Vec<&str> {
        self.said
            .iter()
            .filter_map(|(_, said)| if let Said::Event(_, _, text) = said { Some(&text[..]) } else { None })
            .filter(|text| !is_of_silicon(text))
            .collect()
    }
}
