//! Commands that inspect the network, with real rclpy and with a downbeat robot. The expected texts are
//! recorded outputs of the `ros2` command of Jazzy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::process::{Output, Stdio};
use std::thread::scope;
use std::time::{SystemTime, UNIX_EPOCH};

use common::matrix::{Check, Way, With, check};
use common::rclpy::{Peer, python};
use common::{Running, WATCHDOG, downbeat, robot_file, wait_until};
use serde_json::{Value, json};
use test_machine::free_domain;

const STRING: &str = "std_msgs/msg/String";
const STRING_HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// A ROS domain, in which the commands run.
struct Domain(u16);

impl Domain {
    fn peer(&self) -> Option<Peer> {
        Peer::start(self.0, "LOCALHOST")
    }

    /// Adds a long time-out for busy machines.
    fn line<'a>(&self, line: &[&'a str]) -> Vec<&'a str> {
        [line, &["--spin-time", "40"]].concat()
    }

    fn run(&self, line: &[&str]) -> Output {
        let mut command = downbeat(line);
        command.env("ROS_DOMAIN_ID", self.0.to_string()).stdin(Stdio::null()).output().unwrap()
    }

    /// Returns the standard output of a command that succeeds and prints nothing on standard error.
    fn shown(&self, line: &[&str]) -> String {
        let Output { status, stdout, stderr } = self.run(&self.line(line));
        let [out, error] = [stdout, stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert!(status.success() && error.is_empty(), "{line:?}: {out}\n{error}");
        out
    }

    /// Returns the error of a command that fails after searching for half a second.
    fn refused(&self, line: &[&str]) -> String {
        let output = self.run(&[line, &["--spin-time", "0.5"]].concat());
        assert_eq!(output.status.code(), Some(1), "{line:?}");
        String::from_utf8(output.stderr).unwrap()
    }

    fn start(&self, line: &[&str]) -> Running {
        let line = self.line(line);
        Running::start_by(downbeat(&line).env("ROS_DOMAIN_ID", self.0.to_string()))
    }
}

fn noted(feature: &str, way: Way) -> Check {
    check("Command line", feature, With::Rclpy, way)
}

fn latched() -> Value {
    json!({"depth": 1, "durability": "transient_local"})
}

/// Removes what differs between runs.
fn without_gid(text: &str) -> String {
    text.lines().filter(|line| !line.starts_with("GID: ")).map(|line| format!("{line}\n")).collect()
}

#[test]
fn topics_nodes_and_services_of_rclpy_are_shown_as_by_ros2() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`topic`, `node` and `service` list, info, type, find", Way::In);
    peer.ask(json!({"do": "advertise", "topic": "/chatter", "type": STRING, "qos": latched()}));
    peer.ask(json!({"do": "subscribe", "topic": "/heard", "type": STRING}));
    peer.ask(json!({"do": "advertise", "topic": "/_hidden", "type": STRING}));
    peer.ask(json!({"do": "serve", "service": "/switch", "type": "std_srvs/srv/SetBool"}));
    let services = [
        ("/peer/describe_parameters", "rcl_interfaces/srv/DescribeParameters"),
        ("/peer/get_parameter_types", "rcl_interfaces/srv/GetParameterTypes"),
        ("/peer/get_parameters", "rcl_interfaces/srv/GetParameters"),
        ("/peer/get_type_description", "type_description_interfaces/srv/GetTypeDescription"),
        ("/peer/list_parameters", "rcl_interfaces/srv/ListParameters"),
        ("/peer/set_parameters", "rcl_interfaces/srv/SetParameters"),
        ("/peer/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically"),
        ("/switch", "std_srvs/srv/SetBool"),
    ];
    let typed: String = services.iter().map(|(name, kind)| format!("{name} [{kind}]\n")).collect();
    let owned: String = services.iter().map(|(name, kind)| format!("    {name}: {kind}\n")).collect();
    let info = format!(
        "/peer\n  Subscribers:\n    /heard: {STRING}\n  Publishers:\n    /chatter: {STRING}\n    \
         /parameter_events: rcl_interfaces/msg/ParameterEvent\n    /rosout: rcl_interfaces/msg/Log\n  Service Servers:\n{owned}  \
         Service Clients:\n\n  Action Servers:\n\n  Action Clients:\n\n"
    );
    let all_of_it = info.replace("  Publishers:\n", &format!("  Publishers:\n    /_hidden: {STRING}\n"));
    let chatter = format!(
        "Type: {STRING}\n\nPublisher count: 1\n\nNode name: peer\nNode namespace: /\nTopic type: {STRING}\nTopic type hash: \
         {STRING_HASH}\nEndpoint type: PUBLISHER\nQoS profile:\n  Reliability: RELIABLE\n  History (Depth): UNKNOWN\n  \
         Durability: TRANSIENT_LOCAL\n  Lifespan: Infinite\n  Deadline: Infinite\n  Liveliness: AUTOMATIC\n  Liveliness lease \
         duration: Infinite\n\nSubscription count: 0\n\n"
    );
    let topics = format!(
        "/chatter [{STRING}]\n/heard [{STRING}]\n/parameter_events [rcl_interfaces/msg/ParameterEvent]\n/rosout \
         [rcl_interfaces/msg/Log]\n"
    );
    let verbose = format!(
        "Published topics:\n * /chatter [{STRING}] 1 publisher\n * /parameter_events [rcl_interfaces/msg/ParameterEvent] 1 \
         publisher\n * /rosout [rcl_interfaces/msg/Log] 1 publisher\n\nSubscribed topics:\n * /heard [{STRING}] 1 subscriber\n\n"
    );
    let expected: Vec<(&[&str], &str)> = vec![
        (&["topic", "list", "-t"], &topics),
        (&["topic", "list", "-v"], &verbose),
        (&["topic", "list", "-c", "--include-hidden-topics"], "5\n"),
        (&["topic", "info", "-v", "/chatter"], &chatter),
        (
            &["topic", "info", "heard"],
            "Type: std_msgs/msg/String\nPublisher count: 0\nSubscription count: 1\n",
        ),
        (&["topic", "type", "/chatter"], "std_msgs/msg/String\n"),
        (&["topic", "find", STRING], "/chatter\n/heard\n"),
        (&["node", "list"], "/peer\n"),
        (&["node", "list", "-c"], "1\n"),
        (&["node", "info", "/peer"], &info),
        (&["node", "info", "/peer", "--include-hidden", "--no-daemon"], &all_of_it),
        (&["service", "list", "-t"], &typed),
        (&["service", "type", "/switch"], "std_srvs/srv/SetBool\n"),
        (&["service", "find", "std_srvs/srv/SetBool"], "/switch\n"),
        (
            &["service", "info", "/switch"],
            "Type: std_srvs/srv/SetBool\nClients count: 0\nServices count: 1\n",
        ),
    ];
    // Each command takes some seconds: four at a time.
    for some in expected.chunks(4) {
        scope(|scope| {
            let domain = &domain;
            for (line, text) in some {
                scope.spawn(move || assert_eq!(without_gid(&domain.shown(line)), *text, "{line:?}"));
            }
        });
    }
    peer.leave();
}

#[test]
fn messages_of_rclpy_are_echoed_as_by_ros2_of_types_that_only_rclpy_knows_too() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`topic echo`, of a type that the publisher's node describes too", Way::In);
    let joints = "sensor_msgs/msg/JointState";
    peer.ask(json!({"do": "advertise", "topic": "/joint_states", "type": joints, "qos": latched()}));
    let stamp = json!({"sec": 1795231370, "nanosec": 584300949});
    let state = json!({
        "header": {"stamp": stamp, "frame_id": "body_link"}, "name": ["r_sho_pitch", "l_sho_pitch"],
        "position": [-0.8582515129958178, 0.8582515129958178], "velocity": [0.1, 0.2],
    });
    peer.ask(json!({"do": "publish", "topic": "/joint_states", "fields": state}));
    let imu = json!({"linear_acceleration": {"z": 9.81}});
    peer.ask(json!({"do": "advertise", "topic": "/imu", "type": "sensor_msgs/msg/Imu", "qos": latched()}));
    peer.ask(json!({"do": "publish", "topic": "/imu", "fields": imu}));
    // This text would clear the screen.
    peer.ask(json!({"do": "advertise", "topic": "/chatter", "type": STRING, "qos": latched()}));
    peer.ask(json!({"do": "publish", "topic": "/chatter", "fields": {"data": "\u{1b}[2Jhello"}}));
    // A type of a package that this build does not contain.
    peer.ask(json!({"do": "advertise", "topic": "/plane", "type": "shape_msgs/msg/Plane", "qos": latched()}));
    peer.ask(json!({"do": "publish", "topic": "/plane", "fields": {"coef": [0.0, 0.5, 1.0, -2.0]}}));
    let block = "header:\n  stamp:\n    sec: 1795231370\n    nanosec: 584300949\n  frame_id: body_link\nname:\n- r_sho_pitch\n- \
                 l_sho_pitch\nposition:\n- -0.8582515129958178\n- 0.8582515129958178\nvelocity:\n- 0.1\n- 0.2\neffort: []\n---\n";
    let expected: Vec<(&[&str], &str)> = vec![
        (&["/joint_states"], block),
        (
            &["/joint_states", "--csv"],
            "1795231370,584300949,body_link,r_sho_pitch,l_sho_pitch,-0.8582515129958178,0.8582515129958178,0.1,0.2,\n",
        ),
        (&["/joint_states", "--field", "header.stamp"], "sec: 1795231370\nnanosec: 584300949\n---\n"),
        (&["/joint_states", "--field", "velocity"], "array('d', [0.1, 0.2])\n---\n"),
        (
            &["/joint_states", "--field", "header", "--no-str"],
            "stamp:\n  sec: 1795231370\n  nanosec: 584300949\nframe_id: '<string length: <9>>'\n---\n",
        ),
        (&["/imu", "--field", "angular_velocity_covariance"], "[0. 0. 0. 0. 0. 0. 0. 0. 0.]\n---\n"),
        (&["/chatter"], "data: \"\\e[2Jhello\"\n---\n"),
        (
            &["/chatter", STRING, "--raw"],
            "b'\\x00\\x01\\x00\\x00\\n\\x00\\x00\\x00\\x1b[2Jhello\\x00\\x00\\x00'\n---\n",
        ),
        (&["/chatter", "--field", "data"], "\\u001b[2Jhello\n---\n"),
        (&["/plane", "--flow-style"], "coef: [0.0, 0.5, 1.0, -2.0]\n---\n"),
        (
            &["/plane", "--no-arr", "--qos-durability", "transient_local", "--qos-reliability", "reliable"],
            "coef: '<array type: double[4]>'\n---\n",
        ),
    ];
    for some in expected.chunks(4) {
        scope(|scope| {
            for (line, text) in some {
                let line = [&["topic", "echo", "--once"], *line].concat();
                let domain = &domain;
                scope.spawn(move || assert_eq!(domain.shown(&line), *text, "{line:?}"));
            }
        });
    }
    let refused = domain.run(&domain.line(&["topic", "echo", "/joint_states", "--field", "head"]));
    let refusal = String::from_utf8(refused.stderr).unwrap();
    assert!(refusal.starts_with("downbeat: Invalid field 'head'"), "{refusal}");
    peer.leave();
}

#[test]
fn rate_bandwidth_and_delay_are_measured() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`topic hz`, `bw`, `delay`", Way::In);
    let stamped = "geometry_msgs/msg/PointStamped";
    peer.ask(json!({"do": "advertise", "topic": "/point", "type": stamped}));
    let mut commands: Vec<Running> =
        ["hz", "bw", "delay"].iter().map(|verb| domain.start(&["topic", verb, "/point"])).collect();
    let begin = std::time::Instant::now();
    let has = |command: &Running, text: &str| command.output().contains(text);
    while !(has(&commands[0], "average rate: ")
        && has(&commands[1], "/s from ")
        && has(&commands[2], "average delay: "))
    {
        assert!(begin.elapsed() < WATCHDOG, "{:?}", commands.iter().map(Running::output).collect::<Vec<_>>());
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        let stamp = json!({"sec": now.as_secs(), "nanosec": now.subsec_nanos()});
        peer.ask(json!({"do": "publish", "topic": "/point", "fields": {"header": {"stamp": stamp}}}));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    commands.iter_mut().for_each(Running::interrupt);
    let lines = |command: &Running| command.output().lines().map(str::to_owned).collect::<Vec<_>>();
    let hz = lines(&commands[0]);
    assert!(
        hz[0].starts_with("average rate: ") && hz[1].starts_with("\tmin: ") && hz[1].contains("s std dev: "),
        "{hz:?}"
    );
    let bandwidth = lines(&commands[1]);
    assert_eq!(bandwidth[0], "Subscribed to [/point]");
    // A point with an empty frame: 4 bytes of header, 8 of time, 8 of text with padding, 24 of numbers.
    assert!(
        bandwidth.iter().any(|line| line.contains("Message size mean: 44 B min: 44 B max: 44 B")
            || line.contains("mean: 0.04 KB")),
        "{bandwidth:?}"
    );
    let delay = lines(&commands[2]);
    let of = delay.iter().find_map(|line| line.strip_prefix("average delay: ")).unwrap();
    assert!((0.0..5.0).contains(&of.parse::<f64>().unwrap()), "{delay:?}");
    peer.leave();
}

#[test]
fn published_messages_reach_rclpy() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`topic pub`", Way::Out);
    let joints = "sensor_msgs/msg/JointState";
    peer.ask(json!({"do": "subscribe", "topic": "/goals", "type": joints}));
    let yaml = "{header: auto, name: [head_pan], position: [0.25]}";
    let shown = domain.shown(&["topic", "pub", "--once", "/goals", joints, yaml]);
    let taken = peer.take("/goals", 1);
    let fields = &taken[0]["fields"];
    assert_eq!((&fields["name"], &fields["position"]), (&json!(["head_pan"]), &json!([0.25])));
    let stamp = &fields["header"]["stamp"];
    assert!(stamp["sec"].as_i64().unwrap() > 1_700_000_000, "{stamp}");
    let expected = format!(
        "publisher: beginning loop\npublishing #1: sensor_msgs.msg.JointState(header=std_msgs.msg.Header(stamp=\
         builtin_interfaces.msg.Time(sec={}, nanosec={}), frame_id=''), name=['head_pan'], position=[0.25], velocity=[], \
         effort=[])\n\n",
        stamp["sec"], stamp["nanosec"]
    );
    let shown = shown.replace("Waiting for at least 1 matching subscription(s)...\n", "");
    assert_eq!(shown, expected);

    domain.shown(&["topic", "pub", "-t", "3", "-r", "50", "-p", "0", "/goals", joints]);
    assert_eq!(peer.take("/goals", 3).len(), 3);
    let refusal = domain.refused(&["topic", "pub", "/goals", joints, "{names: [a]}"]);
    assert!(refusal.starts_with("downbeat: Failed to populate field: "), "{refusal}");
    let refusal = domain.refused(&["topic", "pub", "/goals", "sensor_msgs/msg/JointSate", "{}"]);
    assert!(refusal.starts_with("downbeat: The passed message type is invalid: "), "{refusal}");
    peer.leave();
}

#[test]
fn a_service_of_rclpy_is_called() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`service call`", Way::Out);
    peer.ask(json!({"do": "serve", "service": "/set_torque", "type": "std_srvs/srv/SetBool"}));
    let shown = domain.shown(&["service", "call", "/set_torque", "std_srvs/srv/SetBool", "{data: true}"]);
    let shown = shown.replace("waiting for service to become available...\n", "");
    assert_eq!(
        shown,
        "requester: making request: std_srvs.srv.SetBool_Request(data=True)\n\nresponse:\nstd_srvs.srv.SetBool_Response(\
         success=True, message='data is True')\n\n"
    );
    assert_eq!(peer.ask(json!({"do": "requests_to", "service": "/set_torque"})), json!([{"data": true}]));
    peer.leave();
}

#[test]
fn parameters_of_rclpy_are_shown_and_set() {
    let domain = Domain(free_domain());
    let Some(peer) = domain.peer() else { return };
    let _check = noted("`param` list, get, set, describe, dump, load", Way::Both);
    let names = "  start_type_description_service\n  use_sim_time\n";
    assert_eq!(domain.shown(&["param", "list"]), format!("/peer:\n{names}"));
    assert_eq!(domain.shown(&["param", "list", "/peer"]), names);
    assert_eq!(
        domain.shown(&["param", "list", "/peer", "--filter", "use", "--param-type"]),
        "  use_sim_time (type: boolean)\n"
    );
    assert_eq!(
        domain.shown(&["param", "describe", "/peer", "use_sim_time"]),
        "Parameter name: use_sim_time\n  Type: boolean\n  Constraints:\n"
    );
    let dumped = |value: bool| {
        format!(
            "/peer:\n  ros__parameters:\n    start_type_description_service: true\n    use_sim_time: {value}\n\n"
        )
    };
    assert_eq!(domain.shown(&["param", "dump", "peer"]), dumped(false));
    assert_eq!(
        domain.shown(&["param", "set", "/peer", "use_sim_time", "true"]),
        "Set parameter successful\n"
    );
    assert_eq!(domain.shown(&["param", "get", "/peer", "use_sim_time"]), "Boolean value is: True\n");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("peer.yaml");
    std::fs::write(&file, "/peer:\n  ros__parameters:\n    use_sim_time: false\n").unwrap();
    assert_eq!(
        domain.shown(&["param", "load", "/peer", file.to_str().unwrap()]),
        "Set parameter use_sim_time successful\n"
    );
    assert_eq!(domain.shown(&["param", "get", "/peer", "use_sim_time", "--hide-type"]), "False\n");
    let refused = domain.run(&domain.line(&["param", "set", "/peer", "use_sim_time", "3"]));
    assert_eq!(refused.status.code(), Some(1));
    let refusal = String::from_utf8(refused.stderr).unwrap();
    assert!(refusal.starts_with("downbeat: Setting parameter failed: "), "{refusal}");
    peer.leave();
}

#[test]
fn a_goal_is_sent_to_an_action_of_rclpy() {
    let domain = Domain(free_domain());
    let Some(mut peer) = domain.peer() else { return };
    let _check = noted("`action` list, info, type, send_goal with feedback and cancel", Way::Both);
    let fibonacci = "test_msgs/action/Fibonacci";
    peer.ask(json!({"do": "action_server", "action": "/fibonacci", "type": fibonacci}));
    assert_eq!(domain.shown(&["action", "list", "-t"]), format!("/fibonacci [{fibonacci}]\n"));
    assert_eq!(domain.shown(&["action", "type", "/fibonacci"]), format!("{fibonacci}\n"));
    assert_eq!(
        domain.shown(&["action", "info", "-t", "/fibonacci"]),
        format!("Action: /fibonacci\nAction clients: 0\nAction servers: 1\n    /peer [{fibonacci}]\n")
    );

    // Only the wheels contain the definition of the action.
    let prefix = python().unwrap();
    let prefix = Path::new(&prefix).parent().and_then(Path::parent).unwrap().to_owned();
    let send = |order: &str| {
        let line = [
            "action",
            "send_goal",
            "--feedback",
            "/fibonacci",
            fibonacci,
            order,
            "--from",
            prefix.to_str().unwrap(),
        ];
        domain.start(&line)
    };
    let next_goal = |peer: &mut Peer| {
        let mut goal = Value::Null;
        wait_until("the server works on the goal", || {
            goal = peer.ask(json!({"do": "working_on"}))[0][0].clone();
            !goal.is_null()
        });
        goal
    };
    let mut sending = send("{order: 2}");
    let goal = next_goal(&mut peer);
    peer.ask(json!({"do": "tell", "goal": goal, "sequence": [0, 1]}));
    sending.wait_for_output("Feedback:");
    peer.ask(json!({"do": "end", "goal": goal, "how": "succeed", "sequence": [0, 1, 1]}));
    assert!(sending.wait().success());
    assert_eq!(
        sending.output(),
        format!(
            "Waiting for an action server to become available...\nSending goal:\n     order: 2\n\nGoal accepted with ID: {}\n\n\
             Feedback:\n    sequence:\n- 0\n- 1\n\nResult:\n    sequence:\n- 0\n- 1\n- 1\n\nGoal finished with status: SUCCEEDED\n",
            goal.as_str().unwrap()
        )
    );

    // Ctrl-C cancels.
    let sending = send("{order: 3}");
    let goal = next_goal(&mut peer);
    sending.wait_for_output("Goal accepted");
    sending.signal("-INT");
    sending.wait_for_output("Goal canceled.");
    peer.ask(json!({"do": "end", "goal": goal, "how": "canceled", "sequence": []}));

    let mut sending = send("{order: -1}");
    assert!(sending.wait().success());
    assert!(sending.output().ends_with("Goal was rejected.\n"), "{}", sending.output());
    peer.leave();
}

#[test]
fn a_robot_is_inspected_from_another_process() {
    let domain = Domain(free_domain());
    let folder = tempfile::tempdir().unwrap();
    let with = |text: String| text.replace("[expose]", "[expose]\nlifecycle = [\"motion\"]");
    let robot = robot_file(folder.path(), with);
    let mut running = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.0.to_string()]);

    let listed = domain.shown(&["topic", "list", "-t"]);
    assert!(listed.contains("/joint_states [sensor_msgs/msg/JointState]\n"), "{listed}");
    let echoed = domain.shown(&["topic", "echo", "--once", "/imu/data_raw", "--field", "header.frame_id"]);
    assert!(echoed.ends_with("\n---\n"), "{echoed}");
    assert_eq!(domain.shown(&["node", "list"]), "/darwin_op\n/motion\n");
    let names = domain.shown(&["param", "list", "/darwin_op"]);
    assert!(names.contains("  mux.hold_s\n"), "{names}");
    assert_eq!(domain.shown(&["param", "get", "/darwin_op", "mux.hold_s"]), "Double value is: 2.0\n");
    assert_eq!(
        domain.shown(&["param", "set", "/darwin_op", "mux.hold_s", "3.5"]),
        "Set parameter successful\n"
    );
    assert_eq!(domain.shown(&["param", "get", "/darwin_op", "mux.hold_s", "--hide-type"]), "3.5\n");

    // The file contains empty lists, whose type is not apparent from the text.
    let dump = folder.path().join("dump.yaml");
    std::fs::write(&dump, domain.shown(&["param", "dump", "/darwin_op"])).unwrap();
    let loaded = domain.run(&domain.line(&["param", "load", "/darwin_op", dump.to_str().unwrap()]));
    let [out, error] = [loaded.stdout, loaded.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(loaded.status.success(), "{error}");
    assert!(out.contains("Set parameter hardware.offset_ticks successful\n"), "{out}{error}");
    let refused = "Set parameter start_type_description_service failed: ";
    assert!(error.contains(refused) && error.lines().all(|line| line.ends_with("read-only")), "{error}");

    assert_eq!(domain.shown(&["lifecycle", "nodes"]), "/motion\n");
    assert_eq!(domain.shown(&["lifecycle", "get", "/motion"]), "active [3]\n");
    assert_eq!(domain.shown(&["lifecycle", "set", "/motion", "deactivate"]), "Transitioning successful\n");
    assert_eq!(domain.shown(&["lifecycle", "get"]), "/motion: inactive [2]\n");
    let transitions = domain.shown(&["lifecycle", "list", "motion"]);
    assert!(transitions.contains("- activate [3]\n\tStart: inactive\n\tGoal: activating\n"), "{transitions}");
    let unknown = domain.run(&domain.line(&["lifecycle", "set", "/motion", "dance"]));
    let refusal = String::from_utf8(unknown.stderr).unwrap();
    assert!(
        refusal.starts_with("downbeat: Unknown transition requested, available ones are:\n- "),
        "{refusal}"
    );
    running.interrupt();
}

#[test]
fn unknown_names_are_errors() {
    let domain = Domain(free_domain());
    for (line, error) in [
        (["topic", "info", "/nothing"], "downbeat: Unknown topic '/nothing'\n"),
        (["topic", "type", "/nothing"], "downbeat: Unknown topic '/nothing'\n"),
        (["node", "info", "/nobody"], "downbeat: Unable to find node '/nobody'\n"),
        (["service", "type", "/nothing"], "downbeat: Unknown service '/nothing'\n"),
        (["param", "dump", "/nobody"], "downbeat: Node not found\n"),
        (["lifecycle", "get", "/nobody"], "downbeat: Node not found\n"),
        (["action", "type", "/nothing"], "downbeat: Unknown action '/nothing'\n"),
    ] {
        assert_eq!(domain.refused(&line), error, "{line:?}");
    }
    let refusal = domain.refused(&["topic", "echo", "/nothing"]);
    assert_eq!(
        refusal,
        "WARNING: topic [/nothing] does not appear to be published yet\ndownbeat: Could not determine the type for the passed \
         topic\n"
    );
}

#[test]
fn shells_complete_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let output = downbeat(&["completions", shell]).output().unwrap();
        let script = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success());
        for word in ["downbeat", "send_goal", "--include-hidden-topics", "bag"] {
            assert!(script.contains(word.trim_start_matches("--")), "{shell}: {word}");
        }
    }
}

#[test]
fn each_command_has_a_man_page_with_its_options() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    assert!(downbeat(&["man", pages.to_str().unwrap()]).status().unwrap().success());
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap().replace("\\-", "-");
    assert!(page("downbeat.1").contains("downbeat-bag(1)"));
    let record = page("downbeat-bag-record.1");
    for words in ["--storage-preset-profile", "--slow-disk", "drop and count messages", "--exclude-regex"] {
        assert!(record.contains(words), "{words}: {record}");
    }
    assert!(!pages.join("downbeat-library-child.1").exists(), "hidden commands have no page");
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let output = downbeat(&["man", file.to_str().unwrap()]).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("cannot write the man pages into"), "{error}");
}
