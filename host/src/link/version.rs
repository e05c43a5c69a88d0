//! Versions of the protocol on both sides of a link.

use std::fmt;

use slitpose_protocol::{PROTOCOL, ProtocolVersion};

/// A board's version of the protocol, compared with that of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Versions {
    /// The board's version.
    pub board: ProtocolVersion,
}

impl fmt::Display for Versions {
    /// Both versions, the older side, and the next step.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (board, ours) = (self.board, PROTOCOL);
        write!(f, "the board speaks protocol {board}, this program {ours}: ")?;
        match (board.major, board.minor).cmp(&(ours.major, ours.minor)) {
            std::cmp::Ordering::Less => f.write_str(
                "the firmware is older; update it: build the image from the source of this program with \
                 firmware/build, and flash it as firmware/README.md tells",
            ),
            std::cmp::Ordering::Greater => {
                f.write_str("this program is older; update slitpose to the release that the firmware is from")
            }
            std::cmp::Ordering::Equal => f.write_str(
                "the same version, but different builds; build firmware (firmware/build) and program from the same \
                 source, and update both",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_older_side_is_the_one_to_be_updated() {
        let text = |major, minor| Versions { board: ProtocolVersion { major, minor } }.to_string();
        let ProtocolVersion { major, minor } = PROTOCOL;
        assert!(text(major - 1, minor + 1).contains("the firmware is older; update it"));
        assert!(text(major + 1, minor).contains("this program is older; update slitpose"));
        assert!(text(major, minor + 1).contains("this program is older"));
        assert!(text(major, minor).contains("different builds"));
    }
}
