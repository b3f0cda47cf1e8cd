//! The end of a process that cannot wait for an orderly stop, such as one with a module that does not return.

use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

use super::end_now;
use crate::bags;
use crate::bridge::ros;
use crate::modules::servo_emulator;
use crate::program::output;

/// How long ending may take.
pub(super) const HURRY: Duration = Duration::from_millis(200);

/// Time to report what could not be finished.
const REPORT: Duration = Duration::from_millis(20);

/// Does what others depend on, side by side, and ends the process: closes bags, tells peers that this process has left, and removes the
/// links of emulated devices. Children of this process notice its end.
pub(super) fn end(code: i32) -> ! {
    let deadline = Instant::now() + HURRY;
    let (sender, done) = channel();
    let tasks: [(&str, fn()); 3] =
        [("bags", finish_bags), ("leave", ros::leave_all), ("links", servo_emulator::remove_links)];
    for (name, task) in tasks {
        let sender = sender.clone();
        // The sender is dropped when the task ends, even by a panic.
        let run = move || {
            let _sender = sender;
            task();
        };
        // Without a thread, this one cannot be done in time.
        let _ = thread::Builder::new().name(name.to_owned()).spawn(run);
    }
    drop(sender);
    // Nothing is sent: it returns when all tasks have ended.
    let _: Result<(), _> = done.recv_timeout(deadline.saturating_duration_since(Instant::now()) + REPORT);
    end_now(code)
}

fn finish_bags() {
    for path in bags::finish_all(HURRY) {
        let path = path.display();
        output::print_error(format_args!(
            "downbeat: {path} could not be finished in time: `downbeat bag repair {path} NEW` restores what is in it\n"
        ));
    }
}
