//! What is worth telling the user, and how often.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// The same reason is reported at most once in this time, so that strangers cannot fill a log.
const PERIOD: Duration = Duration::from_secs(60);
/// The most reasons told in a period.
const MOST: usize = 64;

/// Counts the reasons of refusals and decides which of them are reported.
#[derive(Debug, Default)]
pub(super) struct Reports {
    told: BTreeMap<String, (Instant, u64)>,
}

impl Reports {
    /// Returns the sentence for a reason if it is to be told now, with how often it was not told before.
    pub(super) fn tell(&mut self, now: Instant, reason: String) -> Option<String> {
        self.told.retain(|known, (at, _)| now.saturating_duration_since(*at) < PERIOD || *known == reason);
        if let Some((at, left)) = self.told.get_mut(&reason) {
            if now.saturating_duration_since(*at) < PERIOD {
                *left += 1;
                return None;
            }
            let count = std::mem::take(left);
            *at = now;
            return Some(match count {
                0 => reason,
                count => format!("{reason} (and {count} times in the minute before)"),
            });
        }
        if self.told.len() >= MOST {
            return None;
        }
        self.told.insert(reason.clone(), (now, 0));
        Some(reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_told_once_a_minute_with_its_count() {
        let (mut reports, start) = (Reports::default(), Instant::now());
        let mut tell = |seconds: u64| reports.tell(start + Duration::from_secs(seconds), "no".to_owned());
        assert_eq!(tell(0).as_deref(), Some("no"));
        assert_eq!((tell(1), tell(59)), (None, None));
        assert_eq!(tell(61).as_deref(), Some("no (and 2 times in the minute before)"));
        assert_eq!(tell(200).as_deref(), Some("no"));
    }

    #[test]
    fn many_reasons_do_not_fill_the_log() {
        let (mut reports, now) = (Reports::default(), Instant::now());
        let told = (0..1000).filter(|number| reports.tell(now, number.to_string()).is_some()).count();
        assert_eq!(told, MOST);
    }
}
