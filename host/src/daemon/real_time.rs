//! Real-time priority for threads that must not be late.

use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Gives the calling thread this priority (SCHED_FIFO, 1 to 99). The error is advice for the user.
pub(super) fn claim(priority: u8) -> Result<(), &'static str> {
    const REMEDY: &str = "no real-time priority for the threads of the board: allow it with LimitRTPRIO=99 in the \
                          systemd unit, or in /etc/security/limits.conf, or leave --real-time out";
    let value = ThreadPriorityValue::try_from(priority).map_err(|_| REMEDY)?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|_| REMEDY)
}
