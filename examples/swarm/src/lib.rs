//! Fifty robots in one process that gather and split into two groups of equal size. Each robot is a module,
//! and so is the arena that they drive in.

mod arena;
mod messages;
mod robot;

use downbeat::App;
use downbeat::executor::{Inbox, Synchrony};
use downbeat::robot::Kind;

pub use arena::Arena;
pub use messages::{Command, Heard, Light, Neighbour, Overview, Pose, Sight, Word};
pub use robot::{Pace, Robot};

/// The program: the arena, and the three kinds of robot, which differ only in when they act.
#[must_use]
pub fn app() -> App {
    let robot = |name, about, pace| Kind::new(name, about, move || Robot::new(pace));
    App::new()
        .interfaces(Sight::INTERFACES)
        .interfaces(Command::INTERFACES)
        .interfaces(Overview::INTERFACES)
        .kind("arena", "the plane on which the robots drive (computed)", Arena::default)
        .add_kind(
            robot("in_step", "acts in every cycle that brings a new sight", Pace::EveryCycle)
                .with_synchrony(Synchrony::EveryCycle),
        )
        .add_kind(robot("by_timer", "acts with a period of its own", Pace::Timer))
        .add_kind(
            // A lost answer would leave a robot waiting for ever.
            robot("at_random", "acts at random times, on a thread of its own", Pace::Random)
                .with_synchrony(Synchrony::Detached(Inbox::KeepAll)),
        )
}
