//! How long the threads of a launcher look for work before they park.

use std::time::{Duration, Instant};

use super::gate::Patience;

/// What a thread of a launcher does between cycles, and the core's thread while others still work.
///
/// A thread that spins answers within a fraction of a microsecond and keeps a CPU busy; one that is parked costs
/// nothing and takes the system some microseconds to wake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Spin {
    /// As suits the launcher: the threads of a [`Pool`](crate::Pool) spin for 20 µs if each can have a CPU of its
    /// own; those of [`Threads`](crate::Threads) park at once.
    #[default]
    Auto,
    /// Parks at once.
    Never,
    /// Spins for this time and then parks. After a wait that was much longer it parks at once, until work
    /// comes quickly again: a robot that runs every 8 ms is not kept busy in between.
    For(Duration),
    /// Never parks: the lowest latency, for the price of a whole CPU per thread. With fewer CPUs than threads it
    /// would be the highest; a pool refuses that.
    Always,
}

impl Spin {
    pub(crate) fn or(self, automatic: Self) -> Self {
        if self == Self::Auto { automatic } else { self }
    }
}

/// The waits of one thread.
#[derive(Debug)]
pub(crate) struct Spinner {
    spin: Spin,
    begin: Option<Instant>,
    looks: u32,
    has_spun_in_vain: bool,
    last_was_short: bool,
}

/// Reading the clock costs as much as several looks.
const LOOKS_PER_READING: u32 = 16;

/// A wait that ended in the system's sleep seems longer than it had to be, by about this.
const TIME_TO_WAKE: Duration = Duration::from_micros(50);

impl Spinner {
    pub(crate) fn new(spin: Spin) -> Self {
        Self { spin, begin: None, looks: 0, has_spun_in_vain: false, last_was_short: true }
    }
}

impl Patience for Spinner {
    fn begin(&mut self) {
        self.looks = 0;
        self.has_spun_in_vain = false;
        self.begin = matches!(self.spin, Spin::For(_)).then(Instant::now);
    }

    fn lasts(&mut self) -> bool {
        let lasts = match (self.spin, self.begin) {
            (Spin::Always, _) => true,
            (Spin::For(limit), Some(begin)) if self.last_was_short => {
                self.looks += 1;
                self.has_spun_in_vain =
                    self.looks.is_multiple_of(LOOKS_PER_READING) && begin.elapsed() >= limit;
                !self.has_spun_in_vain
            }
            _ => false,
        };
        if lasts {
            std::hint::spin_loop();
        }
        lasts
    }

    fn end(&mut self) {
        if let (Spin::For(limit), Some(begin)) = (self.spin, self.begin) {
            self.last_was_short = !self.has_spun_in_vain && begin.elapsed() < limit + TIME_TO_WAKE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looks(spinner: &mut Spinner, limit: usize) -> usize {
        spinner.begin();
        let looks = (0..limit).take_while(|_| spinner.lasts()).count();
        spinner.end();
        looks
    }

    #[test]
    fn a_spinner_that_never_spins_parks_at_once_and_one_that_always_spins_does_not() {
        assert_eq!(looks(&mut Spinner::new(Spin::Never), 100), 0);
        assert_eq!(looks(&mut Spinner::new(Spin::Always), 100_000), 100_000);
    }

    #[test]
    fn a_spinner_that_spun_in_vain_parks_at_once_the_next_time() {
        let mut spinner = Spinner::new(Spin::For(Duration::ZERO));
        assert_eq!(looks(&mut spinner, 100), LOOKS_PER_READING as usize - 1);
        assert_eq!(looks(&mut spinner, 100), 0);
    }

    #[test]
    fn a_spinner_that_finds_work_quickly_goes_on_spinning() {
        let mut spinner = Spinner::new(Spin::For(Duration::from_secs(3600)));
        assert_eq!(looks(&mut spinner, 100), 100);
        assert_eq!(looks(&mut spinner, 100), 100);
    }
}
