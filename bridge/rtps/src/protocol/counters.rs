//! Counters of traffic and invalid input.

use std::time::{Duration, Instant};

/// Time between two warnings of the same kind: hostile input must not fill a log.
const WARNING_PERIOD: Duration = Duration::from_secs(60);

/// A kind of invalid, hostile or foreign input, which is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Fault {
    /// A message of another protocol or another major version.
    #[error("a datagram of another protocol")]
    Foreign,
    #[error("a malformed message")]
    Malformed,
    #[error("malformed discovery data")]
    MalformedDiscovery,
    /// An announcement without a usable IPv4 address.
    #[error("a participant without a usable address")]
    NoAddress,
    /// An endpoint that was announced by another participant than its own.
    #[error("an endpoint that belongs to another participant")]
    ForeignEndpoint,
    #[error("a participant beyond the limit")]
    TooManyParticipants,
    #[error("an endpoint beyond the limit")]
    TooManyEndpoints,
    /// The guard rejected the message.
    #[error("a message that security rejects")]
    Rejected,
    /// An acknowledgement that does not come from an address of its participant.
    #[error("an acknowledgement from another address than the reader's")]
    Elsewhere,
}

impl Fault {
    /// Number of kinds.
    pub const COUNT: usize = Self::Elsewhere as usize + 1;
}

/// Traffic and faults since the participant was created.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    pub datagrams_received: u64,
    pub bytes_received: u64,
    pub datagrams_sent: u64,
    pub bytes_sent: u64,
    /// Data of writers without a matched local reader. Normal at the start and end of a writer.
    pub unmatched: u64,
    /// How often sending was delayed because a peer has not answered yet and was already sent three times the
    /// bytes received from it.
    pub withheld: u64,
    faults: [u64; Fault::COUNT],
}

impl Counters {
    /// Returns how often `fault` occurred.
    pub fn faults(&self, fault: Fault) -> u64 {
        self.faults[fault as usize]
    }
}

/// Counts faults and decides when to warn about them.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    kinds: [Option<Warned>; Fault::COUNT],
}

#[derive(Debug, Clone, Copy)]
struct Warned {
    at: Instant,
    since: u64,
}

impl Warnings {
    /// Counts a fault. If a warning is due, returns the number of faults since the last one.
    pub(crate) fn count(&mut self, counters: &mut Counters, fault: Fault, now: Instant) -> Option<u64> {
        counters.faults[fault as usize] += 1;
        let warned = &mut self.kinds[fault as usize];
        let since = warned.map_or(1, |warned| warned.since + 1);
        let is_due = warned.is_none_or(|warned| now.saturating_duration_since(warned.at) >= WARNING_PERIOD);
        match warned {
            Some(warned) if !is_due => warned.since = since,
            _ => *warned = Some(Warned { at: now, since: 0 }),
        }
        is_due.then_some(since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_warning_a_minute_contains_the_number_of_faults() {
        let start = Instant::now();
        let (mut counters, mut warnings) = (Counters::default(), Warnings::default());
        let mut count =
            |seconds| warnings.count(&mut counters, Fault::Malformed, start + Duration::from_secs(seconds));
        assert_eq!(count(0), Some(1));
        assert_eq!(count(1), None);
        assert_eq!(count(59), None);
        assert_eq!(count(60), Some(3));
        assert_eq!(count(61), None);
        assert_eq!(counters.faults(Fault::Malformed), 5);
        assert_eq!(counters.faults(Fault::Foreign), 0);
    }
}
