//! Messages whose destructors panic, as those of user types may: the robot continues.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use downbeat_executor::*;

/// Panics when dropped, if the flag is set.
struct Bomb(bool);

impl Drop for Bomb {
    fn drop(&mut self) {
        assert!(!self.0 || std::thread::panicking(), "a message in a test");
    }
}

/// Publishes a bomb in every cycle and, if the flag is set, panics after that.
struct Bomber {
    panics: bool,
    out: Option<Publication<Bomb>>,
}

impl Module for Bomber {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("bombs")?);
        setup.every(PERIOD, |bomber: &mut Self, ctx: &mut Context<'_>| {
            ctx.publish(bomber.out.unwrap(), Bomb(true));
            assert!(!bomber.panics, "a module in a test");
        })
    }
}

struct Counter {
    sender: Sender<u64>,
    count: u64,
}

impl Module for Counter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let numbers = setup.publish::<u64>("numbers")?;
        setup.subscribe(
            "numbers",
            |counter: &mut Self, number: Received<'_, u64>, _: &mut Context<'_>| {
                counter.sender.send(*number).unwrap();
            },
        )?;
        setup.every(PERIOD, move |counter: &mut Self, ctx: &mut Context<'_>| {
            counter.count += 1;
            ctx.publish(numbers, counter.count);
        })
    }
}

const PERIOD: Duration = Duration::from_millis(1);

#[test]
fn a_message_that_panics_in_drop_harms_no_other_topic_and_no_launcher() {
    for panics in [false, true] {
        let clock = ManualClock::new(Time::ZERO);
        let pool = Pool::new(3).unwrap();
        let mut core = Core::new().with_launcher(pool).with_clock(clock.clone());
        let (sender, numbers) = channel();
        core.add("bomber", Bomber { panics, out: None }).unwrap();
        core.add("counter", Counter { sender, count: 0 }).unwrap();
        core.add("another bomber", Bomber { panics, out: None }).unwrap();
        for _ in 0..6 {
            core.cycle().unwrap();
            clock.advance(PERIOD);
        }
        assert_eq!(numbers.try_iter().collect::<Vec<_>>(), [1, 2, 3, 4], "module panics: {panics}");
    }
}
