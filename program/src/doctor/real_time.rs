//! What the system lets a robot have of the processor.

use super::facts::Facts;
use super::finding::Finding;
use super::wanted::Wanted;

const AREA: &str = "realtime";

pub(super) fn examine(facts: &Facts, wanted: &Wanted) -> Vec<Finding> {
    if !facts.is_linux {
        let found = "priorities, throttling and governors are those of Linux, and are not looked at here";
        return vec![Finding::ok(AREA, found)];
    }
    let mut findings: Vec<_> =
        wanted.thread_problems.iter().map(|problem| Finding::explained(AREA, problem)).collect();
    if findings.is_empty() {
        findings.push(priorities(facts, wanted));
    }
    findings.push(kernel(facts, wanted));
    findings.extend(throttling(facts));
    findings.extend(governor(facts));
    findings
}

fn priorities(facts: &Facts, wanted: &Wanted) -> Finding {
    match (wanted.priority, facts.highest_priority) {
        (Some(priority), _) => {
            Finding::ok(AREA, format!("the priority {priority} of its threads is allowed"))
        }
        (None, _) if wanted.is_robot => Finding::ok(AREA, "the robot asks for no real-time priority"),
        (None, 0) => Finding::warn(
            AREA,
            "real-time priorities are not allowed, and robot files may ask for one (`priority`)",
            "`echo \"$USER - rtprio 80\" | sudo tee -a /etc/security/limits.conf`, and log in again",
        ),
        (None, highest) => Finding::ok(AREA, format!("real-time priorities are allowed up to {highest}")),
    }
}

fn kernel(facts: &Facts, wanted: &Wanted) -> Finding {
    if facts.is_preempt_rt {
        return Finding::ok(AREA, "the kernel is PREEMPT_RT");
    }
    let found = "the kernel is not PREEMPT_RT: drivers and interrupts may delay a thread of any priority";
    if wanted.priority.is_none() {
        return Finding::ok(AREA, found);
    }
    let package = match std::env::consts::ARCH {
        "aarch64" => "linux-image-rt-arm64",
        _ => "linux-image-rt-amd64",
    };
    Finding::warn(AREA, found, format!("`sudo apt install {package}` on Debian, and boot it"))
}

fn throttling(facts: &Facts) -> Option<Finding> {
    let usual = "`sudo sysctl -w kernel.sched_rt_runtime_us=950000`";
    Some(match facts.real_time_runtime_us? {
        0 => Finding::problem(AREA, "threads with a real-time priority get no time at all", usual),
        ..0 => Finding::warn(
            AREA,
            "real-time threads are not throttled: one that never waits halts the machine",
            usual,
        ),
        runtime => {
            Finding::ok(AREA, format!("real-time threads may use {} ms of each second", runtime / 1000))
        }
    })
}

fn governor(facts: &Facts) -> Option<Finding> {
    if facts.governors.is_empty() {
        return None;
    }
    let found = format!("CPU governor: {}", facts.governors.join(", "));
    Some(if facts.governors == ["performance"] {
        Finding::ok(AREA, found)
    } else {
        Finding::warn(
            AREA,
            format!("{found}: the clock of the processor falls between cycles, and the next one begins late"),
            "`echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
        )
    })
}
