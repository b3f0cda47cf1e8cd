//! Robots in two networks, each with its own selection of topics.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Running, downbeat, robot_file, text_of, wait_until};
use std::path::Path;
use std::time::Duration;
use test_machine::free_domain;

/// Sends two topics to a fleet and takes one from there, which is not sent to the robot's own network.
const FLEET: &str = "\
out = [{ topic = \"battery_state\", rate_hz = 2.0 }, { topic = \"joint_states\", as = \"/fleet/joints\" }]
in = [{ topic = \"plan\", as = \"/fleet/plan\", type = \"std_msgs/msg/String\", raw = true }]
";

/// The output of a command that looks at a domain.
fn shown(domain: u16, line: &[&str]) -> String {
    let output = downbeat(line).env("ROS_DOMAIN_ID", domain.to_string()).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

/// Runs the demo in its own domain and in a fleet, with `line` to look at the fleet; records it, and replays
/// it.
fn run_in_two_networks(folder: &Path, fleet: &str, look_at_fleet: impl Fn(&[&str]) -> String) {
    let robot = robot_file(folder, |text| format!("{text}\n[networks.fleet]\n{fleet}{FLEET}"));
    let (robot, bag, own) = (robot.to_str().unwrap(), folder.join("bag"), free_domain());
    let mut running = Running::start_by(
        downbeat(&["run", robot, "--record", bag.to_str().unwrap()]).env("ROS_DOMAIN_ID", own.to_string()),
    );
    running.wait_for_output("joined network fleet");
    wait_until("the fleet sees the robot", || look_at_fleet(&["topic", "list"]).contains("/fleet/joints"));
    let of_fleet = look_at_fleet(&["topic", "list", "-t"]);
    for expected in ["/battery_state [sensor_msgs/msg/BatteryState]", "/fleet/plan [std_msgs/msg/String]"] {
        assert!(of_fleet.contains(expected), "{expected}: {of_fleet}");
    }
    assert!(!of_fleet.contains("/imu/data_raw") && !of_fleet.contains("/joint_commands"), "{of_fleet}");
    let of_robot = shown(own, &["topic", "list"]);
    assert!(of_robot.contains("/imu/data_raw") && !of_robot.contains("/fleet/"), "{of_robot}");
    let states = look_at_fleet(&["topic", "echo", "--once", "/fleet/joints"]);
    assert!(states.contains("head_tilt"), "{states}");
    let said = look_at_fleet(&[
        "topic",
        "pub",
        "--once",
        "-w",
        "1",
        "/fleet/plan",
        "std_msgs/msg/String",
        "{data: go}",
    ]);
    assert!(said.contains("go"), "{said}");
    std::thread::sleep(Duration::from_millis(300));
    running.interrupt();
    assert_eq!(common::recorded_messages(&bag, "/plan"), 1, "{}", running.output());
    // A difference would be a failure.
    let replay = text_of(&["bag", "replay", robot, bag.to_str().unwrap()]);
    assert!(replay.contains("/joint_states"), "{replay}");
}

#[test]
fn a_robot_in_two_domains_shows_each_its_own_selection_and_replays_bit_for_bit() {
    let (folder, fleet) = (tempfile::tempdir().unwrap(), free_domain());
    let domain = format!("domain = {fleet}\n");
    run_in_two_networks(folder.path(), &domain, |line| shown(fleet, line));
}

#[cfg(feature = "zenoh")]
#[test]
fn a_robot_on_dds_is_in_a_fleet_on_zenoh_and_replays_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let port = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut router = downbeat(&["router"]);
    let router =
        Running::start_by(router.env("ZENOH_CONFIG_OVERRIDE", format!("listen/endpoints=[\"{endpoint}\"]")));
    router.wait_for_output("listens on");
    let (fleet, domain) = (format!("engine = \"zenoh\"\nconnect = \"{endpoint}\"\ndomain = 5\n"), 5);
    run_in_two_networks(folder.path(), &fleet, |line| {
        shown(domain, &[line, &["--connect", &endpoint]].concat())
    });
}

#[cfg(feature = "zenoh")]
#[test]
fn a_robot_runs_without_the_router_of_its_fleet_and_joins_when_it_comes() {
    let (folder, own) = (tempfile::tempdir().unwrap(), free_domain());
    let port = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let fleet = format!(
        "[networks.fleet]\nengine = \"zenoh\"\nconnect = \"{endpoint}\"\nout = [\"battery_state\"]\n"
    );
    let robot = robot_file(folder.path(), |text| format!("{text}\n{fleet}"));
    let running =
        Running::start_by(downbeat(&["run", robot.to_str().unwrap()]).env("ROS_DOMAIN_ID", own.to_string()));
    running.wait_for_output("no Zenoh router is there");
    wait_until("the robot runs", || shown(own, &["topic", "list"]).contains("/battery_state"));
    let mut router = downbeat(&["router"]);
    let _router =
        Running::start_by(router.env("ZENOH_CONFIG_OVERRIDE", format!("listen/endpoints=[\"{endpoint}\"]")));
    let look = ["topic", "list", "--connect", &endpoint];
    wait_until("the fleet sees the robot", || shown(own, &look).contains("/battery_state"));
}

#[test]
fn a_network_that_the_robot_is_in_already_is_refused_with_its_line() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), free_domain());
    let robot =
        robot_file(folder.path(), |text| format!("{text}\n[networks.fleet]\nout = [\"battery_state\"]\n"));
    let text = shown(domain, &["run", robot.to_str().unwrap(), "--duration", "1s"]);
    assert!(text.contains("network \"fleet\" is one that the robot is in already"), "{text}");
}
