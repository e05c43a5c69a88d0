//! A board that solves no poses.

use slitpose_protocol::{HeadPart, RawScan, Rejection, Schedule, Stream};

use crate::HEAD_KIND;
use crate::hardware::System;
use crate::outbox::Outbox;

/// Solves no scans.
#[derive(Debug, Default)]
pub struct Poser(());

#[allow(clippy::unused_self, reason = "the methods of a board that solves poses")]
impl Poser {
    pub(crate) fn take_part(&mut self, _: &HeadPart, _: &Schedule) -> Result<bool, Rejection> {
        Err(Rejection::Unsupported { kind: HEAD_KIND })
    }

    pub(crate) fn bytes(&self) -> Result<&[u8], Rejection> {
        Ok(&[])
    }

    pub(crate) fn configure(&mut self, _: u16, _: &Schedule) {}

    pub(crate) fn is_at_work(&self) -> bool {
        false
    }

    pub(crate) fn is_unfit(&self) -> bool {
        false
    }

    pub(crate) fn is_behind(&self) -> bool {
        false
    }

    pub(crate) fn take(&mut self, _: &RawScan) {}

    pub(crate) fn work<M: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        _: &mut impl System,
        _: &mut Outbox<M>,
        _: usize,
    ) -> bool {
        false
    }

    pub(crate) fn flush<M: AsRef<[u8]> + AsMut<[u8]>>(&mut self, _: &mut Outbox<M>) {}

    pub(crate) fn set_stream(&mut self, _: Stream) {}
}
