//! A base with two wheels as Nav2 drives it: commands with stamps, odometry, its transform and a managed
//! node. rclpy stands for Nav2's servers. Cyclone DDS stands for its lifecycle manager and for a listener to
//! transforms, since no wheel on PyPI has the messages of `bond` and `tf2_msgs`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::time::{Duration, SystemTime};

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, wait_until};
use serde_json::{Value, json};
use test_machine::free_domain;

const ROBOT: &str = r#"
[robot]
name = "rover"

[[module]]
name = "emulator"
kind = "servo_emulator"
settings = { description = "wheels.toml", link = "memory:wheels" }

[[module]]
name = "wheels"
kind = "servo_bus"
settings = { description = "wheels.toml", port = "memory:wheels", hardware_id = "emulated" }

[[module]]
name = "base"
kind = "diff_drive"
settings = { left_wheel_names = ["left_wheel"], right_wheel_names = ["right_wheel"], wheel_separation = 0.2, wheel_radius = 0.03, use_stamped_vel = true, base_frame_id = "base_footprint" }

[expose]
out = ["odom", "tf"]
in = [{ topic = "cmd_vel", type = "geometry_msgs/msg/TwistStamped" }]
lifecycle = ["base"]
"#;

const WHEELS: &str = r#"
name = "rover"
[[bus]]
name = "wheels"
port = "/dev/ttyUSB0"
baud = 1_000_000
protocol = "dynamixel2"
cycle_ms = 10
[defaults]
model = "XL330-M288"
mode = "velocity"
max_velocity_rad_s = 8.0
[[joint]]
name = "left_wheel"
id = 1
[[joint]]
name = "right_wheel"
id = 2
sign = -1
"#;

/// What Nav2's controller server is to the base.
struct Nav2(Peer);

impl Nav2 {
    /// Sends a velocity whose stamp is this old.
    fn drive(&mut self, forward: f64, age: Duration) {
        let stamp = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap() - age;
        let header = json!({
            "stamp": { "sec": stamp.as_secs(), "nanosec": stamp.subsec_nanos() }, "frame_id": "base_footprint",
        });
        let twist = json!({ "linear": { "x": forward } });
        self.0.ask(
            json!({"do": "publish", "topic": "/cmd_vel", "fields": { "header": header, "twist": twist }}),
        );
    }

    /// The newest odometry.
    fn odometry(&mut self) -> Value {
        let mut newest = Value::Null;
        wait_until("odometry arrives", || {
            let heard = self.0.ask(json!({"do": "take", "topic": "/odom"}));
            newest =
                heard.as_array().unwrap().last().map(|heard| heard["fields"].clone()).unwrap_or_default();
            !newest.is_null()
        });
        newest
    }

    fn place(&mut self) -> f64 {
        self.odometry()["pose"]["pose"]["position"]["x"].as_f64().unwrap()
    }

    /// Waits until the base stands, and returns where.
    fn place_at_rest(&mut self) -> f64 {
        wait_until("the base stands", || {
            self.odometry()["twist"]["twist"]["linear"]["x"].as_f64().unwrap().abs() < 1e-3
        });
        self.place()
    }

    fn change(&mut self, label: &str) -> Value {
        let request = json!({"transition": {"label": label}});
        self.0.ask(json!({"do": "call", "service": "/base/change_state", "requests": [request]}))[0]["success"].clone()
    }
}

/// A peer of the base: Nav2's lifecycle manager, and a listener to transforms.
struct Watcher(Peer);

impl Watcher {
    fn of_base(mut peer: Peer) -> Self {
        let bond = json!({"topic": "/bond", "type": "bond/msg/Status", "qos": {"depth": 100}});
        let tf = json!({"topic": "/tf", "type": "tf2_msgs/msg/TFMessage", "qos": {"depth": 100}});
        for (what, mut endpoint) in [("subscribe", bond.clone()), ("advertise", bond), ("subscribe", tf)] {
            endpoint["do"] = json!(what);
            peer.ask(endpoint);
        }
        // The other one is that of this peer.
        wait_until("the base hears its manager", || {
            peer.ask(json!({"do": "matched", "topic": "/bond"})) == 2
        });
        Self(peer)
    }

    /// Sends a heartbeat with Nav2's time-out, and returns whether the base has said that it is alive, or
    /// that the bond is over, since the last call.
    fn bond(&mut self) -> Vec<bool> {
        let fields = json!({
            "header": {}, "id": "base", "instance_id": "manager", "active": true, "heartbeat_timeout": 4.0,
            "heartbeat_period": 0.1,
        });
        self.0.ask(json!({"do": "publish", "topic": "/bond", "fields": fields}));
        let heard = self.0.ask(json!({"do": "take", "topic": "/bond"}));
        let heard = heard.as_array().unwrap().iter().map(|heard| &heard["fields"]);
        heard
            .filter(|said| said["id"] == "base" && said["instance_id"] != "manager")
            .map(|said| said["active"].as_bool().unwrap())
            .collect()
    }

    /// Where the base is in the frame of the odometry, by the transform with this stamp.
    fn base_at(&mut self, stamp: &Value) -> Value {
        let mut found = Value::Null;
        wait_until("the transform of the odometry arrives", || {
            let heard = self.0.ask(json!({"do": "take", "topic": "/tf"}));
            let all = heard.as_array().unwrap().iter();
            let mut all = all.flat_map(|heard| heard["fields"]["transforms"].as_array().unwrap());
            let of_odometry = all.find(|one| one["header"]["stamp"] == *stamp);
            found = of_odometry.cloned().unwrap_or_default();
            !found.is_null()
        });
        assert_eq!(
            (&found["header"]["frame_id"], &found["child_frame_id"]),
            (&json!("odom"), &json!("base_footprint"))
        );
        found["transform"].clone()
    }
}

#[test]
fn a_base_is_driven_by_stamped_commands_and_stops_when_they_end() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(cyclone) = Peer::cyclonedds(domain) else { return };
    let _check3 = check("Topics", "the transform of a base, odom to base_footprint", With::Cyclone, Way::Out);
    let _check = check("Topics", "stamped velocities for a base", With::Rclpy, Way::In);
    let _check2 = check("Topics", "odometry of a base", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    std::fs::write(&robot, ROBOT).unwrap();
    std::fs::write(folder.path().join("wheels.toml"), WHEELS).unwrap();
    let mut running = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);

    peer.ask(json!({"do": "subscribe", "topic": "/odom", "type": "nav_msgs/msg/Odometry"}));
    peer.ask(json!({"do": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/msg/TwistStamped"}));
    let service = "/base/change_state";
    peer.ask(json!({"do": "client", "service": service, "type": "lifecycle_msgs/srv/ChangeState"}));
    assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service})), true);
    wait_until("rclpy has found the base", || {
        peer.ask(json!({"do": "matched", "topic": "/cmd_vel"})).as_u64().is_some_and(|count| count > 0)
    });
    let mut nav2 = Nav2(peer);
    let mut watcher = Watcher::of_base(cyclone);
    let mut alive = 0;
    wait_until("heartbeats of the base", || {
        let said = watcher.bond();
        assert!(said.iter().all(|is_active| *is_active), "{said:?}");
        alive += said.len();
        alive >= 3
    });

    let odometry = nav2.odometry();
    assert_eq!(
        (&odometry["header"]["frame_id"], &odometry["child_frame_id"]),
        (&json!("odom"), &json!("base_footprint"))
    );
    // Commands of now, at 20 Hz.
    let start = nav2.place_at_rest();
    wait_until("the base has driven 10 cm", || {
        nav2.drive(0.1, Duration::ZERO);
        std::thread::sleep(Duration::from_millis(50));
        nav2.place() > start + 0.1
    });
    // Nobody says stop.
    let stopped = nav2.place_at_rest();
    let odometry = nav2.odometry();
    let transform = watcher.base_at(&odometry["header"]["stamp"]);
    let pose = &odometry["pose"]["pose"];
    assert_eq!(
        (&transform["translation"], &transform["rotation"]),
        (&pose["position"], &pose["orientation"])
    );
    // Commands that were on their way for too long are none.
    for _ in 0..10 {
        nav2.drive(0.1, Duration::from_secs(2));
    }
    wait_until("the old commands are counted", || running.output().contains("its stamp is"));
    assert!((nav2.place_at_rest() - stopped).abs() < 0.005);
    // A managed node that is not active does not drive.
    watcher.bond();
    assert_eq!(nav2.change("deactivate"), true);
    wait_until("the bond is over", || watcher.bond().contains(&false));
    nav2.drive(0.1, Duration::ZERO);
    assert_eq!(nav2.change("activate"), true);
    wait_until("there is another bond", || watcher.bond().last() == Some(&true));
    assert!((nav2.place_at_rest() - stopped).abs() < 0.005);
    wait_until("it drives again", || {
        nav2.drive(-0.1, Duration::ZERO);
        std::thread::sleep(Duration::from_millis(50));
        nav2.place() < stopped - 0.05
    });
    running.interrupt();
    watcher.0.leave();
    nav2.0.leave();
}
