//! The protocol as a table: each kind of message and command, its fields, and a key that
//! changes with them.
//!
//! A board sends its keys in [`Hello`](crate::Hello), so that programs built from
//! different sources detect a mismatch before they misread data. A key is the 64-bit FNV-1a
//! hash of `name:fields` in ASCII. In `fields` types are written as they are encoded:
//! `u8` and `f64` fixed, other integers varints, `[T;n]` exactly n, `[T;..n]` a count
//! and up to n, `bytes` and `str` a count and as many bytes, `a|b` an enum numbered
//! from 0, `?` an option.

use serde::{Deserialize, Serialize};
use thiserror::Error;

macro_rules! schedule {
    () => {
        "{tick_hz u32,frame_ticks u32,slots [u16;..17],slot_ticks u32,\
         settling_ticks u32,conversion_ticks u32,oversampling u16,cells u8}"
    };
}

macro_rules! schedule_error {
    () => {
        "CellCount{cells u8}|Oversampling{oversampling u16}\
         |Zero(TickRate|Frame|Slot|Conversion)\
         |DarkTwice{first_slot u8,second_slot u8}\
         |UnknownEmitter{emitter u8,slot u8,cells u8}\
         |LitTwice{emitter u8,first_slot u8,second_slot u8}|NeverLit{emitter u8}\
         |SlotTooShort{needed_ticks u64,slot_ticks u32}\
         |FrameTooShort{needed_ticks u64,frame_ticks u32}"
    };
}

macro_rules! hardware_fault {
    () => {
        "Timing|Conversion{asked_ticks u32,nearest_ticks u32}\
         |Settling{asked_ticks u32,least_ticks u32}|Oversampling{oversampling u16}\
         |Channels{cells u8,channels u8}|Emitters|SharedLevel{first u8,second u8}|Supply\
         |Converters|Counters"
    };
}

/// Number of [`Message::Hello`](crate::Message::Hello) on the wire.
pub(crate) const HELLO_KIND: u32 = 0;

/// Kinds of [`Message`](crate::Message); the index is the number on the wire.
pub const MESSAGES: [Schema; 9] = [
    Schema::new(
        "Hello",
        concat!(
            "protocol{major u8,minor u8},message_keys bytes,command_keys bytes,\
             device_id [u8;12],kind(Physical|Simulated),board str,firmware str,\
             reset_cause(Unknown|PowerOn|BrownOut|Pin|Software|Watchdog|Panic|StackOverflow),\
             hashes{scene ?u64,calibration ?u64},scaling{zero_code f64,amperes_per_code f64,bits u8,\
             saturation_code u16},configuration u16,schedule",
            schedule!()
        ),
    ),
    Schema::new("Batch", "configuration u16,sequence u64,tick u64,levels [u16;..16],samples bytes"),
    Schema::new(
        "Status",
        "tick u64,acquiring bool,scans_taken u64,scans_dropped u64,batches_dropped u32,\
         scans_lost u64,adc_overruns u32,replies_dropped u32,commands_damaged u32,\
         commands_rejected u32,supply_v f32,temperature_k f32,cpu_load_permille u16,\
         clock(Internal|Crystal|CrystalFailed),settings(Defaults|Stored|PassedOver)",
    ),
    Schema::new("Event", "tick u64,severity(Info|Warning|Error),text str"),
    Schema::new(
        "Reply",
        concat!(
            "number u16,outcome(Ok|Err(Unsupported{kind u32}|Malformed{kind u32}|Schedule(",
            schedule_error!(),
            ")|Levels{levels u8,cells u8}|TickRate{asked_hz u32,board_hz u32}|Hardware(",
            hardware_fault!(),
            ")|Unsuited(",
            hardware_fault!(),
            ")|Storing|Storage))"
        ),
    ),
    Schema::new("Pong", "token u32,tick u64"),
    Schema::new("Truth", "sequence u64,translation_m [f64;3],rotation_xyzw [f64;4]"),
    Schema::new(
        "Poses",
        "configuration u16,sequence u64,tick u64,every u8,missed u32,head u32,covariance ?[f32;21],records bytes",
    ),
    Schema::new("Edges", "number u32,missed u32,edges [u64;..8]"),
];

/// Kinds of [`Command`](crate::Command); the index is the number on the wire.
pub const COMMANDS: [Schema; 14] = [
    Schema::new("Hello", ""),
    Schema::new("Start", ""),
    Schema::new("Stop", ""),
    Schema::new("Configure", concat!("schedule", schedule!(), ",levels [u16;..16],exposure(Fixed|Automatic)")),
    Schema::new("Ping", "token u32"),
    Schema::new("Identify", "seconds u8"),
    Schema::new("Store", "hashes{scene ?u64,calibration ?u64}"),
    Schema::new("Forget", ""),
    Schema::new("Reboot", "target(Firmware|BootLoader)"),
    Schema::new("Head", "offset u16,total u16,bytes [u8;..128]"),
    Schema::new("Stream", "scans u16,poses u8"),
    Schema::new("FullScale", "full_scale_pa u32"),
    Schema::new("Packet", "scans u8"),
    Schema::new("Pulse", "every u16,slot u8"),
];

const KEY_BYTES: usize = size_of::<u64>();
static MESSAGE_KEYS: [u8; MESSAGES.len() * KEY_BYTES] = key_bytes(&MESSAGES);
static COMMAND_KEYS: [u8; COMMANDS.len() * KEY_BYTES] = key_bytes(&COMMANDS);

/// One kind of message or command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schema {
    /// Name of the variant.
    pub name: &'static str,
    /// Its fields in the order of the wire.
    pub fields: &'static str,
    /// Hash of name and fields.
    pub key: u64,
}

impl Schema {
    const fn new(name: &'static str, fields: &'static str) -> Self {
        const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
        let hash = fnv_1a(fnv_1a(OFFSET_BASIS, name.as_bytes()), b":");
        Self { name, fields, key: fnv_1a(hash, fields.as_bytes()) }
    }
}

/// Continues a 64-bit FNV-1a hash (Fowler, Noll, Vo; RFC 9923) over `bytes`.
const fn fnv_1a(mut hash: u64, bytes: &[u8]) -> u64 {
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(PRIME);
        i += 1;
    }
    hash
}

const fn key_bytes<const N: usize>(table: &[Schema]) -> [u8; N] {
    let mut out = [0; N];
    let mut i = 0;
    while i < N {
        out[i] = table[i / KEY_BYTES].key.to_le_bytes()[i % KEY_BYTES];
        i += 1;
    }
    out
}

/// Keys of all kinds known to a peer, in the order of its table: 8 bytes each, little
/// endian. A newer peer has more keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SchemaKeys<'a>(pub &'a [u8]);

impl SchemaKeys<'static> {
    /// Keys of [`MESSAGES`].
    pub fn messages() -> Self {
        Self(&MESSAGE_KEYS)
    }

    /// Keys of [`COMMANDS`].
    pub fn commands() -> Self {
        Self(&COMMAND_KEYS)
    }
}

impl SchemaKeys<'_> {
    /// Compares the peer's keys with the table `ours`, for the kinds known to both.
    ///
    /// # Errors
    /// The first kind with another layout.
    pub fn check(self, ours: &[Schema]) -> Result<(), SchemaMismatch> {
        let (theirs, _) = self.0.as_chunks::<KEY_BYTES>();
        for (schema, &bytes) in ours.iter().zip(theirs) {
            let theirs = u64::from_le_bytes(bytes);
            if theirs != schema.key {
                return Err(SchemaMismatch { name: schema.name, ours: schema.key, theirs });
            }
        }
        Ok(())
    }
}

/// A kind with different layouts on the two sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "{name} has schema key {ours:016x} here and {theirs:016x} on the board: \
     build both from the same source"
)]
pub struct SchemaMismatch {
    /// Name of the kind.
    pub name: &'static str,
    /// Key in this crate.
    pub ours: u64,
    /// Key sent by the board.
    pub theirs: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peers_compare_what_both_know() {
        let keys = SchemaKeys::commands();
        assert_eq!(keys.check(&COMMANDS), Ok(()));
        assert_eq!(SchemaKeys(&keys.0[..16]).check(&COMMANDS), Ok(()));
        assert_eq!(keys.check(&COMMANDS[..2]), Ok(()));

        let mut other = COMMAND_KEYS;
        other[3 * KEY_BYTES] ^= 1;
        let mismatch = SchemaKeys(&other).check(&COMMANDS).unwrap_err();
        assert_eq!(mismatch.name, "Configure");
        assert_eq!(mismatch.theirs, COMMANDS[3].key ^ 1);
    }
}
