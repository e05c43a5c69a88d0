//! The frame of a pose for a motor controller: [`FRAME_BYTES`] bytes of fixed layout, one frame for each scan that was
//! solved. On the first board it leaves by a serial port of its own (`firmware/README.md`, "A motor controller").
//!
//! | byte | type | unit | is |
//! |---|---|---|---|
//! | 0, 1 | | | a5 5a: a frame begins |
//! | 2 | `u8` | | [`VERSION`] of this layout |
//! | 3 | `u8` | | status, below |
//! | 4 to 7 | `u32` | scans | sequence number of the scan, low half |
//! | 8 to 11 | `u32` | ticks | device time of the start of its frame, low half |
//! | 12, 13 | `u16` | 64 ticks | from the start of its frame to the pose ([`PoseRecord::ready`]); 65 535: as much or more |
//! | 14, 15 | `u16` | frames | not sent, or cut short, since reset, modulo 65 536 |
//! | 16, 17 | `u16` | | cells used, bit k for cell k |
//! | 18, 19 | `u16` | | cells left out because they contradict all others, bit k for cell k |
//! | 20 to 31 | 3 `f32` | m | translation of `base_from_tool` at the reference instant |
//! | 32 to 47 | 4 `f32` | | its rotation, unit quaternion x, y, z, w |
//! | 48 to 51 | `f32` | m | σ of the translation: √(σ_x² + σ_y² + σ_z²) |
//! | 52 to 55 | `f32` | rad | σ of the rotation, of the three angles alike |
//! | 56 to 59 | `f32` | | χ² |
//! | 60 to 63 | `u32` | | CRC-32/ISO-HDLC (zlib's `crc32`) of bytes 0 to 59 |
//!
//! All numbers are little endian; a tick is 1/170 000 000 s. A point of the tool is at R·p + t in the base frame. Both σ
//! are the same in every frame of axes, and no direction has a larger one.
//!
//! # Status
//! | value | [`PoseStatus`] | a controller |
//! |---|---|---|
//! | 0 | converged | uses the pose |
//! | 1 | fewer cells | uses it if both σ suffice: they are those of the cells that were used |
//! | 2 | a cell left out | the same; the cell is named in bytes 18 and 19, and should be seen to |
//! | 3 | misfit | uses it only to come to a stop: the residuals are larger than the noise explains, so σ says too little |
//! | 4 to 7 | ambiguous, unobservable, too dark, diverged | has no pose |
//! | others | of a later firmware | has no pose |
//!
//! Without a pose translation, rotation and both σ are NaN. Decide by the status: a comparison with NaN is false.
//!
//! # Receiving
//! Look for a5 5a, take 64 bytes, and compare the CRC. If it or the version differs, go on with the byte behind that a5:
//! numbers may contain the same two bytes. A frame that is damaged or missing is not repeated; the next one comes with
//! the next scan. Differences of the sequence number show what is missing, and bytes 14 and 15 how many of those the
//! board has not sent. No frame comes while the board does not sample, has no head for its schedule, or is in reset: use
//! a timeout, of a millisecond at least, because a frame may come half a millisecond later than the one before it would
//! let expect. When it has run out, or poses are missing for as long, bring the plant to rest. Sequence and tick begin
//! anew at a reset of the board. `firmware/include/slitpose_frame.h` does all of this but the timeout, in C.
//!
//! # Age
//! The pose is that of the *reference instant*, the mean of the lit instants: `tick` and the schedule's
//! [`reference_ticks`](slitpose_protocol::Schedule::reference_ticks), 9 712 ticks or 57.1 µs by default. `ready` says
//! when it was solved; from then to the end of the last byte 131 µs pass at 5 Mbaud (in the emulator): with the default
//! schedule a pose is then 64·`ready` ticks + 74 µs old.
//!
//! # Not promised
//! Equal distances of frames: a scan that took longer is followed by the next ones sooner. A pause between two frames. A
//! frame for every scan: scans are passed over while the board looks for a lost tool. That a later version keeps the length,
//! or any field but bytes 0 to 2.
//!
//! [`PoseRecord::ready`]: slitpose_protocol::PoseRecord::ready
//! [`PoseStatus`]: slitpose_protocol::PoseStatus

use slitpose_model::Real;

use crate::hardware::SolvedPose;

/// Bytes of a frame.
pub const FRAME_BYTES: usize = 64;

/// Words of a frame: word k is bytes 4k to 4k + 3, the lowest first.
pub const FRAME_WORDS: usize = FRAME_BYTES / 4;

/// Words that the checksum is of.
pub const CHECKED_WORDS: usize = FRAME_WORDS - 1;

/// Raised when the layout changes.
pub const VERSION: u8 = 1;

const SYNC: [u8; 2] = [0xa5, 0x5a];

/// Places of the variances in the lower triangle of a covariance: of the translation, and of the rotation.
const VARIANCES: [[usize; 3]; 2] = [[0, 2, 5], [9, 14, 20]];

/// The frame of `pose`, with the count of frames that were not sent. `checksum` gives the CRC-32/ISO-HDLC of words.
#[inline(always)]
pub fn frame(
    pose: &SolvedPose,
    unsent: u16,
    checksum: impl FnOnce(&[u32; CHECKED_WORDS]) -> u32,
) -> [u32; FRAME_WORDS] {
    let SolvedPose { sequence, tick, record, covariance } = pose;
    let halves = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
    let [sigma_m, sigma_rad] = covariance.as_ref().map_or([f32::NAN; 2], |covariance| {
        VARIANCES.map(|places| places.into_iter().map(|place| covariance[place]).sum::<f32>().root())
    });
    let [x_m, y_m, z_m] = record.translation_m.map(f32::to_bits);
    let [x, y, z, w] = record.rotation_xyzw.map(f32::to_bits);
    let checked = [
        u32::from_le_bytes([SYNC[0], SYNC[1], VERSION, record.status as u8]),
        *sequence as u32,
        *tick as u32,
        halves(record.ready, unsent),
        halves(record.cells_used, record.excluded),
        x_m,
        y_m,
        z_m,
        x,
        y,
        z,
        w,
        sigma_m.to_bits(),
        sigma_rad.to_bits(),
        record.chi2.to_bits(),
    ];
    let mut words = [0; FRAME_WORDS];
    words[..CHECKED_WORDS].copy_from_slice(&checked);
    words[CHECKED_WORDS] = checksum(&checked);
    words
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::poses::TRIANGLE;
    use slitpose_protocol::{PoseRecord, PoseStatus};

    use super::*;

    const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

    /// Packed by Python's `struct` and `zlib.crc32`; `tests/python/test_frame.py` reads them back.
    const WITH_POSE: &str = "a55a0102efcdab8998badcfed20405003d0002006f12833a6f1203bb\
        0000003f0000003f000000bf0000003f0000003f00004036000090390000c840570d52a8";
    const WITHOUT_POSE: &str = "a55a01060700000000000000ffffffff030000000000c07f0000c07f\
        0000c07f0000c07f0000c07f0000c07f0000c07f0000c07f0000c07f000000007b4d43a5";

    fn hex(pose: &SolvedPose, unsent: u16) -> std::string::String {
        let words = frame(pose, unsent, |words| {
            let bytes: std::vec::Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            CRC.checksum(&bytes)
        });
        words.iter().flat_map(|word| word.to_le_bytes()).map(|byte| std::format!("{byte:02x}")).collect()
    }

    #[test]
    fn a_pose_lies_in_the_bytes_that_python_has_packed() {
        // (2, 2, 1)·2⁻²⁰ m and (1, 4, 8)·2⁻¹⁵ rad. Covariances are not for the frame.
        let mut covariance = [1.0; TRIANGLE];
        let micro = 2.0_f32.powi(-20);
        let milli = 2.0_f32.powi(-15);
        for (place, sigma) in VARIANCES[0].into_iter().zip([2.0 * micro, 2.0 * micro, micro]) {
            covariance[place] = sigma * sigma;
        }
        for (place, sigma) in VARIANCES[1].into_iter().zip([milli, 4.0 * milli, 8.0 * milli]) {
            covariance[place] = sigma * sigma;
        }
        let pose = SolvedPose {
            sequence: 0x0123_4567_89ab_cdef,
            tick: 0x0000_0001_fedc_ba98,
            record: PoseRecord {
                status: PoseStatus::CellExcluded,
                cells_used: 0b11_1101,
                excluded: 0b10,
                ready: 1_234,
                translation_m: [1.0e-3, -2.0e-3, 0.5],
                rotation_xyzw: [0.5, -0.5, 0.5, 0.5],
                chi2: 6.25,
            },
            covariance: Some(covariance),
        };
        assert_eq!(hex(&pose, 5), WITH_POSE);
    }

    #[test]
    fn without_a_pose_its_numbers_are_nan() {
        let pose = SolvedPose {
            sequence: 7,
            tick: 1 << 32,
            record: PoseRecord {
                status: PoseStatus::TooDark,
                cells_used: 0b11,
                excluded: 0,
                ready: u16::MAX,
                translation_m: [f32::NAN; 3],
                rotation_xyzw: [f32::NAN; 4],
                chi2: 0.0,
            },
            covariance: None,
        };
        assert_eq!(hex(&pose, u16::MAX), WITHOUT_POSE);
    }
}
