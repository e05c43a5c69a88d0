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

/// `name:fields` of every kind, one a line: first the messages, then the commands.
const LIST: &str = include_str!("schemas.txt");

/// Number of [`Message::Hello`](crate::Message::Hello) on the wire.
pub(crate) const HELLO_KIND: u32 = 0;

/// Kinds of [`Message`](crate::Message); the index is the number on the wire.
pub const MESSAGES: [Schema; 9] = listed(0);

/// Kinds of [`Command`](crate::Command); the index is the number on the wire.
pub const COMMANDS: [Schema; 14] = listed(MESSAGES.len());

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

/// The kinds in the lines of the list from number `first` on.
const fn listed<const N: usize>(first: usize) -> [Schema; N] {
    let mut schemas = [Schema { name: "", fields: "", key: 0 }; N];
    let (mut rest, mut number) = (LIST, 0);
    while number < first + N {
        let (line, after) = cut(rest, b'\n');
        if number >= first {
            let (name, fields) = cut(line, b':');
            schemas[number - first] = Schema { name, fields, key: fnv_1a(line.as_bytes()) };
        }
        (rest, number) = (after, number + 1);
    }
    schemas
}

/// `text` before and after the first `separator`.
const fn cut(text: &str, separator: u8) -> (&str, &str) {
    let mut end = 0;
    while text.as_bytes()[end] != separator {
        end += 1;
    }
    let (before, after) = text.split_at(end);
    (before, after.split_at(1).1)
}

/// The 64-bit FNV-1a hash of `bytes` (Fowler, Noll, Vo; RFC 9923).
const fn fnv_1a(bytes: &[u8]) -> u64 {
    const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    let (mut hash, mut i) = (OFFSET_BASIS, 0);
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
///
/// ```
/// use slitpose_protocol::schema::{MESSAGES, SchemaKeys};
/// assert_eq!(SchemaKeys::messages().check(&MESSAGES), Ok(()));
/// let changed: Vec<u8> = SchemaKeys::messages().0.iter().map(|byte| byte ^ 1).collect();
/// assert!(SchemaKeys(&changed).check(&MESSAGES).is_err());
/// ```
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
