//! The simulated board as a device: device time passes while its host waits for bytes.

use std::io;

use super::Device;
use crate::pace::{Pace, Speed};
use crate::simulator::SimulatedBoard;

/// Device time that passes between two waits.
const WAIT_EVERY_S: f64 = 2e-3;

/// A simulated board for a number of frames.
#[derive(Debug)]
pub struct SimulatedDevice {
    board: SimulatedBoard,
    frame_s: f64,
    pace: Pace,
    frames_at_once: u64,
    frames_passed: u64,
    frames: u64,
}

impl SimulatedDevice {
    /// `board` for as many frames of `frame_s` as begin within `duration_s`, which may be infinite.
    pub fn new(board: SimulatedBoard, frame_s: f64, duration_s: f64, speed: Speed) -> Self {
        // The last frame of 0.3 s at 4 kHz must not depend on the last bit of either. Saturates.
        let frames = (duration_s / frame_s - 1e-6).ceil() as u64;
        let frames_at_once = (WAIT_EVERY_S / frame_s).ceil() as u64;
        Self { board, frame_s, pace: Pace::new(speed), frames_at_once, frames_passed: 0, frames }
    }
}

impl Device for SimulatedDevice {
    fn name(&self) -> &str {
        "sim"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.write(bytes);
        Ok(())
    }

    fn keeps_time(&self) -> bool {
        self.pace.is_real_time()
    }

    /// What the board has to say comes before time passes: commands are answered in no time.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        let before = bytes.len();
        self.board.transmit(bytes);
        if bytes.len() > before {
            return Ok(true);
        }
        let until = self.frames.min(self.frames_passed.saturating_add(self.frames_at_once));
        while self.frames_passed < until {
            self.board.step(bytes);
            self.frames_passed += 1;
        }
        self.pace.wait(self.frames_passed as f64 * self.frame_s);
        Ok(bytes.len() > before || self.frames_passed < self.frames)
    }
}
