//! Each finding, from facts that lead to it.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use super::facts::{Access, Clock, Device, Interface, Python};
use super::wanted::{ModulePort, Protocol};
use super::*;

/// A machine on which there is nothing to do.
fn healthy() -> Facts {
    Facts {
        is_linux: true,
        kernel: Some("6.1.0-rt".into()),
        c_library: Some("glibc 2.36".into()),
        is_preempt_rt: true,
        highest_priority: 80,
        real_time_runtime_us: Some(950_000),
        governors: vec!["performance".into()],
        receive_buffer: Some(8 << 20),
        send_buffer: Some(8 << 20),
        interfaces: vec![Interface { name: "eth0".into(), has_multicast: true }],
        ephemeral_ports: Some((32_768, 60_999)),
        devices: vec![device(Access::Granted)],
        clock: Clock { seconds: 1_790_000_000, jump: Duration::ZERO, is_synchronised: Some(true) },
        disks: vec![("/home/ann".into(), 64 << 30), ("/var/lib/downbeat".into(), 32 << 30)],
        python: Some(Python { version: (3, 11), has_downbeat: true }),
        ..Facts::default()
    }
}

fn device(access: Access) -> Device {
    let latency = Some((1, "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer".into()));
    Device { path: "/dev/ttyUSB0".into(), modules: vec!["hardware".into()], access, latency }
}

/// The only finding that is not ok, of a healthy machine on which something was changed.
fn only(change: impl FnOnce(&mut Facts, &mut Wanted)) -> (Verdict, String) {
    let (mut facts, mut wanted) = (healthy(), Wanted::default());
    change(&mut facts, &mut wanted);
    let mut findings = diagnose(&facts, &wanted);
    findings.retain(|finding| finding.verdict != Verdict::Ok);
    assert_eq!(findings.len(), 1, "{findings:#?}");
    (findings[0].verdict, findings[0].to_string())
}

#[track_caller]
fn warns(expected: &[&str], change: impl FnOnce(&mut Facts, &mut Wanted)) {
    finds(Verdict::Warn, expected, change);
}

#[track_caller]
fn is_problem(expected: &[&str], change: impl FnOnce(&mut Facts, &mut Wanted)) {
    finds(Verdict::Problem, expected, change);
}

#[track_caller]
fn finds(verdict: Verdict, expected: &[&str], change: impl FnOnce(&mut Facts, &mut Wanted)) {
    let (found, line) = only(change);
    assert_eq!(found, verdict, "{line}");
    expected.iter().for_each(|expected| assert!(line.contains(expected), "{expected:?} in {line}"));
    assert!(!line.contains('\n'), "{line}");
}

fn set(facts: &mut Facts, variable: &str, value: &str) {
    facts.variables.insert(variable.to_owned(), value.to_owned());
}

#[test]
fn a_healthy_machine_has_nothing_to_do() {
    let findings = diagnose(&healthy(), &Wanted::default());
    assert!(findings.iter().all(|finding| finding.verdict == Verdict::Ok), "{findings:#?}");
    let lines: Vec<_> = findings.iter().map(ToString::to_string).collect();
    for expected in [
        "ok       devices   /dev/ttyUSB0 of hardware may be opened",
        "ok       devices   /dev/ttyUSB0 passes on answers every 1 ms",
        "ok       realtime  the kernel is PREEMPT_RT",
        "ok       network   eth0 is up and has multicast",
        "ok       clock     2026-09-21 14:13:20 UTC, synchronised",
        "ok       disk      65536 MiB are free in /home/ann",
        "ok       disk      32768 MiB are free in /var/lib/downbeat",
    ] {
        assert!(lines.iter().any(|line| line == expected), "{expected} in {lines:#?}");
    }
}

#[test]
fn a_port_that_may_not_be_opened_has_the_command_that_permits_it() {
    let group = |is_listed| Access::OfGroup { group: "dialout".into(), is_listed };
    let with = |access| move |facts: &mut Facts, _: &mut Wanted| facts.devices = vec![device(access)];
    is_problem(
        &["/dev/ttyUSB0 of hardware", "`sudo usermod -aG dialout $USER`, and log in again"],
        with(group(false)),
    );
    is_problem(&["after you logged in", "`newgrp dialout`"], with(group(true)));
    is_problem(&["only its owner", "`sudo chmod a+rw /dev/ttyUSB0`"], with(Access::OfOwner));
    is_problem(&["does not exist", "plug the device in"], with(Access::Missing));
}

#[test]
fn an_adapter_with_the_usual_latency_is_too_slow_for_servos() {
    warns(
        &["every 16 ms", "`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`"],
        |facts, _| facts.devices[0].latency.as_mut().unwrap().0 = 16,
    );
}

#[test]
fn a_priority_that_the_user_may_not_take_is_a_problem_only_where_a_robot_asks_for_it() {
    warns(&["rtprio 80", "/etc/security/limits.conf"], |facts, _| facts.highest_priority = 0);
    is_problem(&["robot.toml:3: the system does not allow the SCHED_FIFO priority 80"], |facts, wanted| {
        facts.highest_priority = 0;
        let problem = "robot.toml:3: the system does not allow the SCHED_FIFO priority 80";
        *wanted = Wanted { is_robot: true, thread_problems: vec![problem.into()], ..Wanted::default() };
    });
    let (mut facts, wanted) = (healthy(), Wanted { is_robot: true, ..Wanted::default() });
    facts.highest_priority = 0;
    assert!(diagnose(&facts, &wanted).iter().all(|finding| finding.verdict == Verdict::Ok));
}

#[test]
fn the_kernel_its_throttling_and_its_governor_may_delay_threads() {
    warns(&["not PREEMPT_RT", "sudo apt install linux-image-rt-"], |facts, wanted| {
        facts.is_preempt_rt = false;
        wanted.priority = Some(80);
    });
    warns(&["not throttled", "kernel.sched_rt_runtime_us=950000"], |facts, _| {
        facts.real_time_runtime_us = Some(-1)
    });
    is_problem(&["get no time"], |facts, _| facts.real_time_runtime_us = Some(0));
    warns(&["CPU governor: performance, powersave", "echo performance | sudo tee"], |facts, _| {
        facts.governors.push("powersave".into());
    });
}

#[test]
fn small_socket_buffers_have_the_setting_of_the_system() {
    let line = "`echo net.core.rmem_max=4194304 | sudo tee -a /etc/sysctl.d/60-downbeat.conf && sudo sysctl --system`";
    warns(&["socket buffers of 208 KiB", line], |facts, _| facts.receive_buffer = Some(212_992));
    warns(&["net.core.wmem_max=4194304"], |facts, _| facts.send_buffer = Some(212_992));
}

#[test]
fn an_interface_without_multicast_and_a_machine_without_network_find_no_other_nodes() {
    warns(&["`sudo ip link set dev eth0 multicast on`", "ROS_STATIC_PEERS"], |facts, _| {
        facts.interfaces[0].has_multicast = false;
    });
    warns(&["no network interface is up"], |facts, _| facts.interfaces.clear());
    let mut facts = healthy();
    facts.interfaces.clear();
    set(&mut facts, "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    let findings = diagnose(&facts, &Wanted::default());
    assert!(findings.iter().all(|finding| finding.verdict == Verdict::Ok), "needs none: {findings:#?}");
}

#[test]
fn a_variable_with_a_wrong_value_is_a_problem_and_one_without_effect_a_warning() {
    is_problem(&["ROS_DOMAIN_ID=\"233\" is not a domain", "0 to 232"], |facts, _| {
        set(facts, "ROS_DOMAIN_ID", "233")
    });
    is_problem(&["RMW_IMPLEMENTATION=\"rmw_dds\" is not known"], |facts, _| {
        set(facts, "RMW_IMPLEMENTATION", "rmw_dds")
    });
    warns(&["ROS_STATIC_PEERS=10.0.0.7", "Set it to SUBNET"], |facts, _| {
        set(facts, "ROS_STATIC_PEERS", "10.0.0.7");
        set(facts, "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    });
    warns(&["ROS_SECURITY_ENABLE=\"1\" has no effect"], |facts, _| set(facts, "ROS_SECURITY_ENABLE", "1"));
    warns(&["ROS_DISCOVERY_SERVER", "`unset ROS_DISCOVERY_SERVER`"], |facts, _| {
        set(facts, "ROS_DISCOVERY_SERVER", "10.0.0.1:11811");
    });
    warns(&["ZENOH_CONFIG_OVERRIDE has no effect", "RMW_IMPLEMENTATION=rmw_zenoh_cpp"], |facts, _| {
        set(facts, "ZENOH_CONFIG_OVERRIDE", "mode=\"client\"");
    });
}

#[test]
fn security_without_what_it_needs_is_a_problem_where_it_is_enforced() {
    let enable = |facts: &mut Facts| {
        set(facts, "ROS_SECURITY_ENABLE", "true");
        set(facts, "ROS_SECURITY_KEYSTORE", "/keys");
        facts.dangling.push("ROS_SECURITY_KEYSTORE");
    };
    let why = if cfg!(feature = "security") { "/keys names no folder" } else { "without \"security\"" };
    warns(&[why, "joins without protection", "create-keystore"], |facts, _| enable(facts));
    is_problem(&[why, "lets no robot start"], |facts, _| {
        enable(facts);
        set(facts, "ROS_SECURITY_STRATEGY", "Enforce");
    });
}

#[test]
fn a_domain_tells_its_ports_and_is_full_when_all_are_in_use() {
    let mut facts = healthy();
    facts.udp_ports = [9910, 9912].into();
    set(&mut facts, "ROS_DOMAIN_ID", "10");
    let lines: Vec<_> = diagnose(&facts, &Wanted::default()).iter().map(ToString::to_string).collect();
    let expected =
        "DDS domain 10, with all nodes of the subnet; UDP ports from 9900, the next one 9914, 2 in use";
    assert!(lines.iter().any(|line| line.contains(expected)), "{lines:#?}");
    is_problem(&["all ports of its participants are in use", "'sport >= :7400'"], |facts, _| {
        facts.udp_ports = (7400..7650).collect();
    });
}

#[test]
fn a_domain_among_the_ports_of_the_system_may_lose_them() {
    warns(&["domain 110", "32768 to 60999", "0 to 100"], |facts, wanted| {
        wanted.networks = vec![(None, Some(110))];
        set(facts, "ROS_DOMAIN_ID", "7");
    });
}

#[test]
fn a_port_of_a_viewer_that_is_in_use_is_named_with_its_key() {
    is_problem(&["TCP port 8765 of `foxglove`", "'sport = :8765'"], |facts, wanted| {
        facts.tcp_ports.insert(8765);
        wanted.view_ports = vec![("foxglove", 8765), ("page", 7374)];
    });
}

#[test]
fn a_port_of_a_module_that_is_in_use_is_named_with_the_module() {
    let port = |protocol| {
        move |facts: &mut Facts, wanted: &mut Wanted| {
            facts.tcp_ports.insert(4010);
            facts.udp_ports.insert(4010);
            let module = |name: &str, port| ModulePort { module: name.into(), protocol, port };
            wanted.module_ports = vec![module("lines", 4010), module("others", 4011)];
        }
    };
    is_problem(&["TCP port 4010 of lines is in use", "`ss -ltnp 'sport = :4010'`"], port(Protocol::Tcp));
    warns(&["UDP port 4010 of lines is in use", "`ss -lunp 'sport = :4010'`"], port(Protocol::Udp));
}

#[cfg(feature = "zenoh")]
#[test]
fn zenoh_without_a_router_finds_nobody() {
    warns(&["no router listens on port 7447", "`downbeat router`"], |facts, _| {
        set(facts, "RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    });
    is_problem(&["ZENOH_SESSION_CONFIG_URI=/none.json5 names no file"], |facts, wanted| {
        set(facts, "ZENOH_SESSION_CONFIG_URI", "/none.json5");
        facts.dangling.push("ZENOH_SESSION_CONFIG_URI");
        wanted.networks = vec![(Some("zenoh".parse().unwrap()), None)];
    });
    let mut facts = healthy();
    set(&mut facts, "RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    facts.tcp_ports.insert(7447);
    assert!(diagnose(&facts, &Wanted::default()).iter().all(|finding| finding.verdict == Verdict::Ok));
}

#[test]
fn a_clock_that_was_never_set_is_a_problem_and_one_that_moves_or_drifts_a_warning() {
    is_problem(&["the clock says 1970-01-01 00:01:00 UTC", "`sudo timedatectl set-ntp true`"], |facts, _| {
        facts.clock.seconds = 60;
    });
    warns(&["was set by 1500 ms"], |facts, _| facts.clock.jump = Duration::from_millis(1500));
    warns(&["not synchronised", "set-ntp true"], |facts, _| facts.clock.is_synchronised = Some(false));
}

#[test]
fn a_disk_that_is_nearly_full_is_named_with_its_folder() {
    warns(&["1024 MiB are free in /home/ann", "max_bag_files"], |facts, _| facts.disks[0].1 = 1 << 30);
    is_problem(&["10 MiB are free in /var/lib/downbeat"], |facts, _| facts.disks[1].1 = 10 << 20);
}

#[test]
fn python_that_is_too_old_is_named() {
    warns(&["Python 3.9 is too old", "Python 3.11 or newer"], |facts, _| {
        facts.python = Some(Python { version: (3, 9), has_downbeat: false });
    });
}

#[test]
fn elsewhere_than_on_linux_what_is_of_linux_only_is_said_to_be_so() {
    let facts = Facts { is_linux: false, governors: Vec::new(), ..healthy() };
    let findings = diagnose(&facts, &Wanted::default());
    let about: Vec<_> = findings.iter().filter(|finding| finding.area == "realtime").collect();
    assert!(about.len() == 1 && about[0].found.contains("are those of Linux"), "{about:?}");
}
