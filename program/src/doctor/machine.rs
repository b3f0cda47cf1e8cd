//! The system, its clock, the disk and Python.

use std::path::Path;
use std::time::Duration;

use chrono::DateTime;

use super::facts::{Facts, Python};
use super::finding::Finding;

/// The begin of 2026. A clock before it was never set.
const EARLIEST: u64 = 1_767_225_600;
/// Clocks are slewed by at most a thousandth, which is less in the time that reading the facts takes.
const JUMP: Duration = Duration::from_millis(50);
const MIB: u64 = 1 << 20;
/// Less is full soon.
const LITTLE: u64 = 2048 * MIB;
/// Less is full at once.
const HARDLY_ANY: u64 = 100 * MIB;
/// What the wheel needs.
const OLDEST_PYTHON: (u32, u32) = (3, 11);

pub(super) fn examine(facts: &Facts) -> Vec<Finding> {
    let mut findings = vec![system(facts), clock(facts)];
    findings.extend(facts.disks.iter().map(|(folder, free)| disk(folder, *free)));
    findings.extend(facts.python.as_ref().map(python));
    findings
}

fn system(facts: &Facts) -> Finding {
    let kernel = facts.kernel.as_deref().unwrap_or("unknown kernel");
    let library = facts.c_library.as_deref().unwrap_or("no glibc");
    let (system, processor) = (std::env::consts::OS, std::env::consts::ARCH);
    Finding::ok("system", format!("{system} {kernel} on {processor}, {library}"))
}

fn clock(facts: &Facts) -> Finding {
    const AREA: &str = "clock";
    let clock = &facts.clock;
    let synchronise = "`sudo timedatectl set-ntp true`";
    let time = i64::try_from(clock.seconds).ok().and_then(|seconds| DateTime::from_timestamp(seconds, 0));
    let time = time.map(|time| time.format("%Y-%m-%d %H:%M:%S UTC").to_string()).unwrap_or_default();
    if clock.seconds < EARLIEST {
        let found = format!("the clock says {time}: messages and bags get times of the past");
        return Finding::problem(AREA, found, format!("{synchronise}, or set it: `sudo date --set TIME`"));
    }
    if clock.jump > JUMP {
        let found = format!("the clock was set by {} ms during this command", clock.jump.as_millis());
        let remedy = "start robots when it is synchronised: `timedatectl timesync-status`; modules are not affected, the stamps \
                      of messages are";
        return Finding::warn(AREA, found, remedy);
    }
    match clock.is_synchronised {
        Some(true) => Finding::ok(AREA, format!("{time}, synchronised")),
        Some(false) => {
            let found = format!("{time}, not synchronised: stamps differ from those of other machines");
            Finding::warn(AREA, found, synchronise)
        }
        None => Finding::ok(AREA, format!("{time}; nothing here says whether it is synchronised")),
    }
}

fn disk(folder: &Path, free: u64) -> Finding {
    const AREA: &str = "disk";
    let found = format!("{} MiB are free in {}", free / MIB, folder.display());
    let remedy = "free some space, or record elsewhere: `downbeat run ROBOT.toml --record /other/disk/run`; max_bag_files in \
                  [record] deletes the oldest files of a run";
    match free {
        ..HARDLY_ANY => Finding::problem(AREA, found, remedy),
        HARDLY_ANY..LITTLE => Finding::warn(AREA, found, remedy),
        _ => Finding::ok(AREA, found),
    }
}

/// Modules in Python run in the program of the wheel.
fn python(python: &Python) -> Finding {
    const AREA: &str = "python";
    let (major, minor) = python.version;
    let found = format!("Python {major}.{minor}");
    if python.version < OLDEST_PYTHON {
        let (major, minor) = OLDEST_PYTHON;
        let remedy = format!("install Python {major}.{minor} or newer, if the robot has modules in Python");
        return Finding::warn(AREA, format!("{found} is too old for modules in Python"), remedy);
    }
    if python.has_downbeat {
        return Finding::ok(AREA, format!("{found} with downbeat"));
    }
    Finding::ok(AREA, format!("{found}; `pip install downbeat-robotics` adds modules in Python"))
}
