//! When the process of a robot is started again.

use std::time::Duration;

/// The restarts of one robot.
#[derive(Debug, Default)]
pub(super) struct Restarts {
    /// Without a process that ran for [`SETTLED`] in between.
    in_a_row: u32,
}

/// The pause before the first restart; it doubles with each further one in a row.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// The most restarts in a row.
const MOST_IN_A_ROW: u32 = 5;
/// A process that ran for this long has not failed because of its start.
const SETTLED: Duration = Duration::from_secs(60);

impl Restarts {
    /// The pause before the next process, after one that ran for this long; `None` if there is no next one.
    pub(super) fn pause_after(&mut self, ran: Duration) -> Option<Duration> {
        if ran >= SETTLED {
            self.in_a_row = 0;
        }
        self.in_a_row += 1;
        (self.in_a_row <= MOST_IN_A_ROW).then(|| FIRST_PAUSE * (1 << (self.in_a_row - 1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_until_a_robot_is_given_up_and_begin_anew_after_one_that_ran() {
        let mut restarts = Restarts::default();
        let pause = |restarts: &mut Restarts, ran| {
            restarts.pause_after(Duration::from_secs(ran)).map(|pause| pause.as_secs())
        };
        for seconds in [1, 2, 4] {
            assert_eq!(pause(&mut restarts, 3), Some(seconds));
        }
        for seconds in [1, 2, 4, 8, 16] {
            let ran = if seconds == 1 { 60 } else { 59 };
            assert_eq!(pause(&mut restarts, ran), Some(seconds));
        }
        assert_eq!([pause(&mut restarts, 0), pause(&mut restarts, 0)], [None, None]);
    }
}
