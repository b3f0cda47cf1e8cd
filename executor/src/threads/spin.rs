//! Spinning: how long the threads of a launcher poll for work before they park.

use std::time::{Duration, Instant};

use super::gate::Patience;

/// The behaviour of a launcher's thread between cycles, and of the core's thread while it waits for others.
///
/// A spinning thread reacts within a fraction of a microsecond and keeps a CPU busy. A parked thread costs
/// nothing, but waking it takes the system some microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Spin {
    /// The default of the launcher: the threads of a [`Pool`](crate::Pool) spin for 20 µs if there is a CPU
    /// for each; the threads of [`Threads`](crate::Threads) park at once.
    #[default]
    Auto,
    /// Parks at once.
    Never,
    /// Spins for this time and then parks. After a much longer wait, the thread parks at once until work
    /// arrives quickly again, so that a robot with a period of 8 ms does not spin in between.
    For(Duration),
    /// Never parks: the lowest latency, at the cost of a whole CPU per thread. With fewer CPUs than threads
    /// the latency would be the highest, so a pool refuses that.
    Always,
}

impl Spin {
    pub(crate) fn or(self, automatic: Self) -> Self {
        if self == Self::Auto { automatic } else { self }
    }
}

/// The state of one thread's waits.
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

/// The approximate time by which a wait appears longer if the thread slept.
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
