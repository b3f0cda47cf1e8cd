//! What each request to stop means.

use std::time::{Duration, Instant};

/// Requests within this time after the first are the same: `timeout` and supervisors signal a process and its
/// group, terminals and shells both send SIGHUP, and a parent that is signalled may pass the signal on.
pub(super) const ONE_REQUEST: Duration = Duration::from_secs(1);

/// The same for requests after the second one, after which the process ends soon.
const ONE_HURRY: Duration = Duration::from_millis(50);

/// The requests so far.
#[derive(Debug)]
pub(super) struct Requests {
    first: Option<Instant>,
    second: Option<Instant>,
}

/// What to do about a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meaning {
    /// Stop in order.
    Stop,
    /// Nothing: it repeats the last request.
    Same,
    /// End soon, after what others depend on is done.
    Hurry,
    /// End at once.
    End,
}

impl Requests {
    pub(super) const NONE: Self = Self { first: None, second: None };

    /// Takes a request that is never impatient, such as the end of the parent. Returns whether it is the
    /// first one.
    #[cfg(any(feature = "football", feature = "view"))]
    pub(super) fn begin(&mut self, now: Instant) -> bool {
        let is_first = self.first.is_none();
        self.first.get_or_insert(now);
        is_first
    }

    /// Takes a request that came at this time.
    pub(super) fn take(&mut self, now: Instant) -> Meaning {
        match (self.first, self.second) {
            (None, _) => {
                self.first = Some(now);
                Meaning::Stop
            }
            (Some(first), None) if now < first + ONE_REQUEST => Meaning::Same,
            (Some(_), None) => {
                self.second = Some(now);
                Meaning::Hurry
            }
            (Some(_), Some(second)) if now < second + ONE_HURRY => Meaning::Same,
            (Some(_), Some(_)) => Meaning::End,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_within_a_second_are_one_and_later_ones_are_impatient() {
        let start = Instant::now();
        let mut requests = Requests::NONE;
        let meanings = [0, 1, 100, 999, 1000, 1001, 1049, 1050, 9000]
            .map(|ms| requests.take(start + Duration::from_millis(ms)));
        use Meaning::{End, Hurry, Same, Stop};
        assert_eq!(meanings, [Stop, Same, Same, Same, Hurry, Same, Same, End, End]);
    }
}
