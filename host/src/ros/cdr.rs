//! CDR as used by ROS 2: four bytes that name the encoding, then values in little-endian order,
//! each aligned to its size from the end of those four bytes.
//!
//! Written here because only six kinds of value are needed and the bulk of a capture is one long `uint8[]`,
//! which the existing crates, through serde, would copy byte by byte.

/// Plain CDR, little endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes one message into a reused buffer.
pub(crate) struct Encoder<'a> {
    bytes: &'a mut Vec<u8>,
}

impl<'a> Encoder<'a> {
    /// Begins a message; clears `bytes`.
    pub(crate) fn new(bytes: &'a mut Vec<u8>) -> Self {
        bytes.clear();
        bytes.extend_from_slice(&ENCAPSULATION);
        Self { bytes }
    }

    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let behind_header = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(ENCAPSULATION.len() + behind_header.next_multiple_of(N), 0);
        self.bytes.extend_from_slice(&value);
    }

    pub(crate) fn bool(&mut self, value: bool) {
        self.u8(value.into());
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.put([value]);
    }

    pub(crate) fn i32(&mut self, value: i32) {
        self.put(value.to_le_bytes());
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.put(value.to_le_bytes());
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.put(value.to_le_bytes());
    }

    pub(super) fn f32(&mut self, value: f32) {
        self.put(value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.put(value.to_le_bytes());
    }

    /// The number of elements of a sequence, which follow one by one.
    pub(crate) fn length(&mut self, length: usize) {
        debug_assert!(u32::try_from(length).is_ok(), "a sequence of {length} elements");
        self.u32(length as u32);
    }

    /// `uint8[]`.
    pub(crate) fn bytes(&mut self, value: &[u8]) {
        self.length(value.len());
        self.bytes.extend_from_slice(value);
    }

    /// A text; its length includes a final zero.
    pub(crate) fn text(&mut self, value: &str) {
        self.length(value.len() + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
    }
}

/// Reads one message; all methods return `None` if it ends too soon.
pub(crate) struct Decoder<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// `None` if the message is in another encoding.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<Self> {
        let (header, body) = bytes.split_first_chunk::<4>()?;
        // The last two bytes are options, which plain CDR does not use.
        (header[..2] == ENCAPSULATION[..2]).then_some(Self { body, at: 0 })
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let taken = self.body.get(self.at..)?.get(..length)?;
        self.at += length;
        Some(taken)
    }

    fn get<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.at = self.at.next_multiple_of(N);
        self.take(N)?.first_chunk().copied()
    }

    pub(crate) fn bool(&mut self) -> Option<bool> {
        self.get().map(|[value]: [u8; 1]| value != 0)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.get().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.get().map(u64::from_le_bytes)
    }

    /// `uint8[]`.
    pub(crate) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.length::<1>()?;
        self.take(length)
    }

    /// The number of elements, of `SIZE` bytes each, of a sequence. Limited by the length of the message, so
    /// that it is safe for allocation.
    fn length<const SIZE: usize>(&mut self) -> Option<usize> {
        let length = usize::try_from(self.u32()?).ok()?;
        (length.checked_mul(SIZE)? <= self.body.len() - self.at).then_some(length)
    }

    /// `uint32[]`, element by element.
    pub(crate) fn each_u32(&mut self, mut take: impl FnMut(u32)) -> Option<usize> {
        let length = self.length::<4>()?;
        for _ in 0..length {
            take(self.u32()?);
        }
        Some(length)
    }

    /// `uint64[]` and `int64[]`, element by element.
    pub(crate) fn each_u64(&mut self, mut take: impl FnMut(usize, u64)) -> Option<usize> {
        let length = self.length::<8>()?;
        for index in 0..length {
            take(index, self.u64()?);
        }
        Some(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_aligned_from_the_end_of_the_header() {
        let mut bytes = vec![9; 9];
        let mut encoder = Encoder::new(&mut bytes);
        encoder.bool(true);
        encoder.u32(0x0403_0201);
        encoder.text("ab");
        encoder.length(0);
        encoder.u64(5);
        // By hand, from the rules of OMG CORBA 3.4, part 2, 9.3.
        let expected = [
            &[0, 1, 0, 0][..],
            &[1, 0, 0, 0],
            &[1, 2, 3, 4],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[0, 0, 0, 0, 0, 0, 0, 0],
            &[5, 0, 0, 0, 0, 0, 0, 0],
        ];
        assert_eq!(bytes, expected.concat()[..bytes.len()]);
        assert_eq!(bytes.len(), 36);
    }
}
