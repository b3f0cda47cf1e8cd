//! The robots `robots/px4_*.toml`: run, flown by commands of ROS 2, recorded and replayed.
#![cfg(feature = "px4")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Running, downbeat, output_of, own_domain, recorded_messages, text_of, wait_until};

const ROBOT: &str = "robots/px4_emulated.toml";

#[test]
fn the_robot_for_a_vehicle_has_the_topics_and_the_qos_of_the_release() {
    let text = text_of(&["check", "robots/px4_offboard.toml"]);
    let of = |topic: &str| text.lines().find(|line| line.contains(topic)).unwrap_or_default().to_owned();
    for topic in
        ["<- /fmu/out/vehicle_status_v1", "<- /fmu/out/battery_status_v1", "-> /fmu/in/trajectory_setpoint"]
    {
        assert!(of(topic).contains("best_effort volatile"), "{topic}: {text}");
    }
    let folder = tempfile::tempdir().unwrap();
    let older = folder.path().join("robot.toml");
    let file = std::fs::read_to_string("robots/px4_offboard.toml").unwrap();
    std::fs::write(&older, file.replace("\"1.17\"", "\"1.15\"")).unwrap();
    let text = text_of(&["check", older.to_str().unwrap()]);
    assert!(text.contains("<- /fmu/out/vehicle_status ") && !text.contains("_v1"), "{text}");
}

#[test]
fn names_of_px4_msgs_stand_for_the_release_that_the_environment_names() {
    let show = |release: &str| {
        let mut command = downbeat(&["interface", "show", "px4_msgs/msg/OffboardControlMode"]);
        command.env("DOWNBEAT_PX4_RELEASE", release).output().unwrap()
    };
    let text = |release| String::from_utf8(show(release).stdout).unwrap();
    assert!(text("1.14").contains("bool actuator\n"), "{}", text("1.14"));
    assert!(text("1.15").contains("bool direct_actuator") && text("") == text("1.17"));
    let refused = show("1.13");
    let problem = String::from_utf8(refused.stderr).unwrap();
    assert!(
        !refused.status.success() && problem.contains("DOWNBEAT_PX4_RELEASE: the messages of PX4 \"1.13\""),
        "{problem}"
    );
}

#[test]
fn a_vehicle_is_flown_by_commands_and_the_run_replays() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let (bag, domain) = (bag.to_str().unwrap(), own_domain().to_string());
    let on = ["--domain", &domain];
    let mut robot = Running::start(&[&["run", ROBOT, "--record", bag][..], &on].concat());
    robot.wait_for_output("hold, disarmed");
    let pose =
        "{header: {frame_id: odom}, pose: {position: {x: 3.0, y: 2.0, z: 5.0}, orientation: {w: 1.0}}}";
    let publish = ["topic", "pub", "-r", "10", "/setpoint_pose", "geometry_msgs/msg/PoseStamped", pose];
    let mut publisher = Running::start(&[&publish[..], &on].concat());
    publisher.wait_for_output("publishing #5");
    let call = |words: &[&str]| text_of(&[&["service", "call"][..], words, &on].concat());
    let armed = call(&["/arm", "std_srvs/srv/SetBool", "{data: true}"]);
    assert!(armed.contains("PX4 has accepted the command to arm"), "{armed}");
    let entered = call(&["/offboard", "std_srvs/srv/Trigger"]);
    assert!(entered.contains("success=True"), "{entered}");
    robot.wait_for_output("offboard, armed");
    wait_until("the vehicle is there", || {
        let odometry = text_of(&[&["topic", "echo", "--once", "/odom"][..], &on].concat());
        odometry.contains("x: 2.9") && odometry.contains("y: 1.9") && odometry.contains("z: 4.9")
    });
    publisher.interrupt();
    robot.wait_for_output("no current command, so set-points stop");
    robot.wait_for_output("hold, armed, failsafe");
    let landed = call(&["/land", "std_srvs/srv/Trigger"]);
    assert!(landed.contains("PX4 has accepted the command to land"), "{landed}");
    robot.wait_for_output("land, disarmed");
    robot.interrupt();
    assert!(recorded_messages(std::path::Path::new(bag), "/fmu/in/trajectory_setpoint") > 40);
    let replayed = output_of(&["bag", "replay", ROBOT, bag]);
    assert!(replayed.status.success(), "{}", String::from_utf8_lossy(&replayed.stdout));
}
