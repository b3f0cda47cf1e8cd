//! Serial ports and cameras: may they be opened, and do their adapters answer at once?

use super::facts::{Access, Device, Facts};
use super::finding::Finding;

const AREA: &str = "devices";
/// A longer one delays the answers of servos beyond their cycle.
const LONGEST_LATENCY_MS: u32 = 1;

pub(super) fn examine(facts: &Facts) -> Vec<Finding> {
    if facts.devices.is_empty() {
        return vec![Finding::ok(AREA, "no serial port and no camera is present or named")];
    }
    facts.devices.iter().flat_map(|device| [Some(access(device)), latency(device)]).flatten().collect()
}

fn access(Device { path, modules, access, .. }: &Device) -> Finding {
    let name = if modules.is_empty() { path.clone() } else { format!("{path} of {}", modules.join(", ")) };
    match access {
        Access::Granted => Finding::ok(AREA, format!("{name} may be opened")),
        Access::Missing => Finding::problem(
            AREA,
            format!("{name} does not exist"),
            "plug the device in, or name another (ls /dev/serial/by-id /dev/v4l/by-id)",
        ),
        Access::OfGroup { group, is_listed: true } => Finding::problem(
            AREA,
            format!("{name} may not be opened yet: you joined the group {group} after you logged in"),
            format!("log in again, or `newgrp {group}` in this terminal"),
        ),
        Access::OfGroup { group, is_listed: false } => Finding::problem(
            AREA,
            format!("{name} may not be opened: it is of the group {group}"),
            format!("`sudo usermod -aG {group} $USER`, and log in again"),
        ),
        Access::OfOwner => Finding::problem(
            AREA,
            format!("{name} may not be opened: only its owner may"),
            format!("a udev rule that gives it to a group, for now `sudo chmod a+rw {path}`"),
        ),
    }
}

fn latency(device: &Device) -> Option<Finding> {
    let (milliseconds, file) = device.latency.as_ref()?;
    let found = format!("{} passes on answers every {milliseconds} ms", device.path);
    Some(if *milliseconds <= LONGEST_LATENCY_MS {
        Finding::ok(AREA, found)
    } else {
        let found = format!("{found}, which is late for servos in cycles of 8 ms");
        Finding::warn(AREA, found, format!("`echo 1 | sudo tee {}`", file.display()))
    })
}
