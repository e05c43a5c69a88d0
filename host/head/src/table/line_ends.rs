//! Line ends of other systems.

use std::io::{Read, Result};

/// Passes text on with every carriage return before a line feed left out: the parser would count such lines one short.
pub(super) struct LineFeeds<R> {
    source: R,
    /// A carriage return has been read and not passed on, for what follows is not known.
    held: bool,
}

impl<R: Read> LineFeeds<R> {
    pub(super) fn of(source: R) -> Self {
        Self { source, held: false }
    }
}

impl<R: Read> Read for LineFeeds<R> {
    /// `out` must have room for two bytes, as a reader's buffer has.
    fn read(&mut self, out: &mut [u8]) -> Result<usize> {
        let first = usize::from(self.held);
        out[..first].fill(b'\r');
        let count = self.source.read(&mut out[first..])?;
        let filled = first + count;
        if count == 0 {
            self.held = false;
            return Ok(filled);
        }
        if !out[..filled].contains(&b'\r') {
            return Ok(filled);
        }
        self.held = out[filled - 1] == b'\r';
        let mut kept = 0;
        for at in 0..filled {
            if out[at] == b'\r' && (at + 1 == filled || out[at + 1] == b'\n') {
                continue;
            }
            out[kept] = out[at];
            kept += 1;
        }
        // Nothing but a carriage return is not the end.
        if kept == 0 { self.read(out) } else { Ok(kept) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_feeds_are_all_that_is_left_wherever_reads_are_cut() {
        for text in ["a,b\r\n1,2\r\n", "\r\r\n\r", "a\rb\n\r\nc\r", "", "\r", "no end"] {
            let expected = text.replace("\r\n", "\n");
            for size in 1..8 {
                for room in 2..6 {
                    let mut source = LineFeeds::of(Cut { text: text.as_bytes(), size });
                    let (mut read, mut buffer) = (Vec::new(), vec![0; room]);
                    while let count @ 1.. = source.read(&mut buffer).unwrap() {
                        read.extend_from_slice(&buffer[..count]);
                    }
                    assert_eq!(String::from_utf8(read).unwrap(), expected, "{text:?} by {size} and {room}");
                }
            }
        }
    }

    struct Cut<'a> {
        text: &'a [u8],
        size: usize,
    }

    impl Read for Cut<'_> {
        fn read(&mut self, out: &mut [u8]) -> Result<usize> {
            let most = self.size.min(out.len());
            self.text.read(&mut out[..most])
        }
    }
}
