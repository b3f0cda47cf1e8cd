//! What runs, for a process that does not stop.

use std::fmt::Write;
use std::fs;

use crate::output;
use downbeat_executor::running_modules;

/// Prints the modules whose callbacks run, and the threads of this process.
pub(super) fn print() {
    output::print_error(format_args!("{}", text()));
}

fn text() -> String {
    let mut text = "SIGQUIT: modules whose callbacks run: ".to_owned();
    let modules = running_modules();
    text.push_str(&if modules.is_empty() { "none".to_owned() } else { modules.join(", ") });
    text.push('\n');
    for thread in threads() {
        // Writing to a `String` does not fail.
        let _ = writeln!(text, "  {thread}");
    }
    text
}

/// The threads with their states; only Linux reports them.
fn threads() -> Vec<String> {
    let entries = fs::read_dir("/proc/self/task").into_iter().flatten().filter_map(Result::ok);
    let mut threads: Vec<_> = entries
        .filter_map(|entry| {
            let id: u32 = entry.file_name().to_str()?.parse().ok()?;
            let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
            Some((id, thread(id, &stat)?))
        })
        .collect();
    threads.sort_unstable();
    threads.into_iter().map(|(_, line)| line).collect()
}

/// A line about a thread, from its `stat` file (proc_pid_stat(5)).
fn thread(id: u32, stat: &str) -> Option<String> {
    // The name may contain spaces and parentheses.
    let (before, after) = stat.rsplit_once(')')?;
    let (_, name) = before.split_once('(')?;
    let fields: Vec<_> = after.split_whitespace().collect();
    let state = match *fields.first()? {
        "R" => "running",
        "S" => "waiting",
        "D" => "waiting for a device",
        "T" | "t" => "halted",
        other => other,
    };
    // Fields 14 and 15, in ticks, of which all current systems have 100 per second.
    let ticks: u64 = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
    Some(format!("thread {id} \"{name}\": {state}, {:.2} s of processor time", ticks as f64 / 100.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_listed_with_their_states() {
        let stat = "123 (a (b) c) R 1 1 1 0 -1 4194304 1 0 0 0 250 50 0 0 20 0 1 0 1 0 0";
        assert_eq!(
            thread(123, stat).as_deref(),
            Some("thread 123 \"a (b) c\": running, 3.00 s of processor time")
        );
        assert_eq!(thread(1, "1 (cut) S"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_has_threads() {
        assert!(text().lines().count() > 1);
    }
}
