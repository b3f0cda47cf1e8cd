//! The end of a process that cannot wait for an orderly stop, such as one with a module that does not return.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use super::end_now;
use crate::logging::Stream;
use crate::screen::Screen;
use downbeat_bridge::ros;
use downbeat_servos::servo_emulator;

/// How long ending may take.
pub(super) const HURRY: Duration = Duration::from_millis(200);

/// Time to report what could not be finished.
const REPORT: Duration = Duration::from_millis(20);

/// Something to do before the process ends. Returns what remains undone.
type Task = (&'static str, fn() -> String);

/// Does what others depend on, side by side, and ends the process: closes bags, tells peers that this process
/// has left, and removes the links of emulated devices. Children of this process notice its end.
pub(super) fn end(code: i32) -> ! {
    let start = Instant::now();
    let tasks: [Task; 3] =
        [("bags", finish_bags), ("ROS 2", leave), ("links of emulated devices", remove_links)];
    let (done, undone) = run_side_by_side(&tasks, start + HURRY);
    let mut text = format!(
        "downbeat: ends without waiting for modules; closed after {} ms:",
        start.elapsed().as_millis()
    );
    text.push_str(&format!(" {}\n", if done.is_empty() { "nothing".to_owned() } else { done.join(", ") }));
    undone.iter().for_each(|undone| text.push_str(&format!("downbeat: {undone}\n")));
    // A halted terminal does not keep the process.
    Screen::of_process().log(Stream::Error, crate::output::escaped(format_args!("{text}")));
    Screen::of_process().flush_until(start + HURRY + REPORT);
    end_now(code)
}

/// Runs tasks at one time, until `end`. Returns which of them are done, and what is not.
fn run_side_by_side(tasks: &[Task], end: Instant) -> (Vec<&'static str>, Vec<String>) {
    let (sender, results) = channel();
    for &(name, task) in tasks {
        let sender = sender.clone();
        // If nobody waits any more, it has taken too long.
        let run = move || drop(sender.send((name, task())));
        // Without a thread, this one cannot be done in time.
        let _ = thread::Builder::new().name(name.to_owned()).spawn(run);
    }
    drop(sender);
    let (mut done, mut undone) = (Vec::new(), Vec::new());
    loop {
        match results.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok((name, remains)) if remains.is_empty() => done.push(name),
            Ok((_, remains)) => undone.push(remains),
            // All tasks have ended, one of them perhaps by a panic.
            Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) => return (done, undone),
        }
    }
}

fn leave() -> String {
    ros::leave_all();
    String::new()
}

fn remove_links() -> String {
    servo_emulator::remove_links();
    String::new()
}

fn finish_bags() -> String {
    // Somewhat less than all, so that the result is in time.
    let unfinished = downbeat_bags::finish_all(HURRY - REPORT);
    let unfinished = unfinished.iter().map(|path| {
        let path = path.display();
        format!(
            "{path} could not be finished in time: `downbeat bag repair {path} -o NEW` restores what is in it"
        )
    });
    unfinished.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_that_do_not_end_are_not_waited_for() {
        let forever = || {
            thread::sleep(Duration::from_secs(3600));
            String::new()
        };
        let tasks: [Task; 4] = [
            ("quick", String::new),
            ("forever", forever),
            ("panics", || panic!("as tested")),
            ("late", || "the bag x".to_owned()),
        ];
        // Five seconds are enough for the quick tasks on a busy machine. The task without an end gets no more
        // time.
        let start = Instant::now();
        let (done, undone) = run_side_by_side(&tasks, start + Duration::from_secs(5));
        assert_eq!((done, undone), (vec!["quick"], vec!["the bag x".to_owned()]));
        assert!(start.elapsed() >= Duration::from_secs(5) && start.elapsed() < Duration::from_secs(60));
        let (done, undone) = run_side_by_side(&tasks[..1], start + Duration::from_secs(3600));
        assert_eq!((done, undone), (vec!["quick"], Vec::new()));
    }
}
