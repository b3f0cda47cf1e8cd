//! The module `Mqtt` against mosquitto. Without it, these tests are skipped.
#![cfg(feature = "mqtt")]
#![allow(clippy::unwrap_used)]

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use downbeat_device::DeviceLink;
use downbeat_edge::Interfaces;
use downbeat_executor::{Core, Inbox, Inlet, ManualClock, ModuleOptions, OutletInbox, SettingValue, Time};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_msgs::std_msgs::msg::{Bool, Float64, String as Text};
use downbeat_network::mqtt::Mqtt;
use downbeat_network::mqtt::broker::{Broker, MOST_WAITING};
use rumqttc::{Client, Event, MqttOptions, Packet, QoS};

const WATCHDOG: Duration = Duration::from_secs(20);
const MOSQUITTO: &str = "/usr/sbin/mosquitto";

/// A broker on a free port of this machine, which can be stopped and started again.
struct Mosquitto {
    port: u16,
    folder: tempfile::TempDir,
    process: Option<Child>,
}

impl Mosquitto {
    /// `None` if it is not installed, which is reported.
    fn start() -> Option<Self> {
        if !std::path::Path::new(MOSQUITTO).exists() {
            test_machine::missing(MOSQUITTO, "Debian: the package mosquitto");
            return None;
        }
        let mut broker = Self { port: free_port(), folder: tempfile::tempdir().unwrap(), process: None };
        broker.restart();
        Some(broker)
    }

    fn restart(&mut self) {
        self.stop();
        let file = self.folder.path().join("mosquitto.conf");
        let port = self.port;
        std::fs::write(
            &file,
            format!("listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n"),
        )
        .unwrap();
        let mut command = Command::new(MOSQUITTO);
        command.arg("-c").arg(&file).stdout(Stdio::null()).stderr(Stdio::null());
        self.process = Some(command.spawn().unwrap());
        until("the broker listens", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    }

    fn stop(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.kill().unwrap();
            process.wait().unwrap();
        }
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        self.stop();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + WATCHDOG;
    while !is_so() {
        assert!(Instant::now() < end, "waited in vain: {what}");
        sleep(Duration::from_millis(5));
    }
}

/// Topic, payload, and whether it was retained.
type Heard = (String, Vec<u8>, bool);

/// Another client of the broker.
struct Peer {
    client: Client,
    heard: Arc<Mutex<Vec<Heard>>>,
}

impl Peer {
    fn new(broker: &Mosquitto, filter: &str) -> Self {
        let options = MqttOptions::new("peer", "127.0.0.1", broker.port);
        let (client, mut connection) = Client::new(options, 10);
        client.subscribe(filter, QoS::AtLeastOnce).unwrap();
        let heard = Arc::new(Mutex::new(Vec::new()));
        let (all, is_subscribed) = (Arc::clone(&heard), Arc::new(Mutex::new(false)));
        let subscribed = Arc::clone(&is_subscribed);
        std::thread::spawn(move || {
            for event in connection.iter() {
                match event {
                    Ok(Event::Incoming(Packet::SubAck(_))) => *subscribed.lock().unwrap() = true,
                    Ok(Event::Incoming(Packet::Publish(publish))) => {
                        let message = (publish.topic, publish.payload.to_vec(), publish.retain);
                        all.lock().unwrap().push(message);
                    }
                    Ok(_) => {}
                    Err(_) => return,
                }
            }
        });
        until("the peer is subscribed", || *is_subscribed.lock().unwrap());
        Self { client, heard }
    }

    fn heard(&self) -> Vec<Heard> {
        self.heard.lock().unwrap().clone()
    }

    fn say(&self, topic: &str, payload: &[u8]) {
        self.client.publish(topic, QoS::AtLeastOnce, false, payload).unwrap();
    }
}

type Collected<T> = Arc<Mutex<Vec<T>>>;

/// A core with the module.
struct Robot {
    core: Core,
    clock: ManualClock,
    cycles: usize,
}

impl Robot {
    fn new() -> Self {
        let clock = ManualClock::new(Time::ZERO);
        Self { core: Core::new().with_clock(clock.clone()), clock, cycles: 0 }
    }

    fn collect<T: Clone + Send + Sync + 'static>(&mut self, topic: &str) -> Collected<T> {
        let collected = Arc::new(Mutex::new(Vec::new()));
        let all = Arc::clone(&collected);
        let inbox = OutletInbox::new(topic, Inbox::KeepAll);
        let take =
            move |received: downbeat_executor::Received<'_, T>| all.lock().unwrap().push((*received).clone());
        self.core.outlet(topic, &inbox, take).unwrap().keep();
        collected
    }

    fn add(&mut self, link: DeviceLink<Broker>, options: ModuleOptions) {
        self.core.add_with("mqtt", Mqtt::new(link, Interfaces::carried()), options).unwrap();
    }

    fn cycle(&mut self) {
        self.clock.advance(Duration::from_millis(20));
        self.core.cycle().unwrap();
        self.cycles += 1;
    }

    fn until(&mut self, what: &str, mut is_so: impl FnMut() -> bool) {
        until(what, || {
            self.cycle();
            is_so()
        });
    }
}

fn options(port: u16, version: &str, settings: &[(&str, SettingValue)]) -> ModuleOptions {
    let common = [("port", i64::from(port).into()), ("version", version.to_owned().into())];
    let settings = common.iter().chain(settings);
    let settings = settings.map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

fn texts<const N: usize>(lines: [&str; N]) -> SettingValue {
    SettingValue::Texts(lines.map(str::to_owned).into())
}

fn last<T: Copy>(collected: &Collected<T>) -> Option<T> {
    collected.lock().unwrap().last().copied()
}

fn is_connected(connected: &Collected<Bool>) -> bool {
    connected.lock().unwrap().last().is_some_and(|connected| connected.data)
}

fn twist(forward: f64, turning: f64) -> String {
    format!(
        r#"{{"linear": {{"x": {forward}, "y": 0, "z": 0}}, "angular": {{"x": 0, "y": 0, "z": {turning}}}}}"#
    )
}

#[test]
fn topics_pass_both_ways_in_both_versions_and_encodings_and_a_recording_repeats_what_came() {
    let Some(broker) = Mosquitto::start() else { return };
    for version in ["3.1.1", "5"] {
        let peer = Peer::new(&broker, &format!("robot/{version}/#"));
        let send = [
            format!("height std_msgs/msg/Float64 robot/{version}/height qos2 retain"),
            format!("height std_msgs/msg/Float64 robot/{version}/height_cbor cbor qos1 hz=5"),
        ];
        let receive = [
            format!("cmd_vel geometry_msgs/msg/Twist to_robot/{version}/cmd_vel qos2"),
            format!("words std_msgs/msg/String to_robot/{version}/+/words cbor"),
        ];
        let settings =
            [("send", SettingValue::Texts(send.into())), ("receive", SettingValue::Texts(receive.into()))];
        let options = || options(broker.port, version, &settings);
        let mut robot = Robot::new();
        let (twists, words) = (robot.collect::<Twist>("cmd_vel"), robot.collect::<Text>("words"));
        let exchanges = robot.collect::<BusExchange>("mqtt/exchanges");
        let connected = robot.collect::<Bool>("mqtt/connected");
        robot.add(DeviceLink::new(Broker::default()), options());
        let height: Inlet<Float64> = robot.core.inlet("height").unwrap();
        robot.until("the robot is connected", || is_connected(&connected));
        for _ in 0..3 {
            height.publish(Float64 { data: 0.25 }).unwrap(); // within 200 ms: one of them in CBOR
        }
        robot.until("messages in both encodings", || peer.heard().len() >= 4);
        let heard = peer.heard();
        let named = |topic: &str| heard.iter().filter(|(name, ..)| name.ends_with(topic)).collect::<Vec<_>>();
        let json = named("/height");
        assert_eq!(json.len(), 3);
        assert_eq!(std::str::from_utf8(&json[0].1).unwrap().replace(' ', ""), r#"{"data":0.25}"#);
        // RFC 8949: a map with one entry, the text "data", a float of 64, 32 or 16 bits.
        let cbor = named("/height_cbor");
        assert_eq!(cbor.len(), 1, "more often than five times a second");
        assert!(cbor[0].1.starts_with(b"\xa1\x64data"), "{:x?}", cbor[0].1);

        let to = format!("to_robot/{version}");
        peer.say(&format!("{to}/cmd_vel"), twist(0.5, 0.0).as_bytes());
        for malformed in [
            &br#"{"linear": {"x": 1}}"#[..],
            b"{",
            b"",
            b"[1]",
            br#"{"linear": 1}"#,
            b"\xff\xff",
            &[b'['; 5000],
        ] {
            peer.say(&format!("{to}/cmd_vel"), malformed);
        }
        peer.say(&format!("{to}/cmd_vel"), twist(0.75, -1.0).as_bytes());
        peer.say(&format!("{to}/a/words"), b"\xa1\x64data\x62hi");
        robot.until("a text", || !words.lock().unwrap().is_empty());
        assert_eq!(twists.lock().unwrap().len(), 2, "the others are malformed");
        assert_eq!((last(&twists).unwrap().linear.x, last(&twists).unwrap().angular.z), (0.75, -1.0));
        assert_eq!(words.lock().unwrap()[0].data, "hi");

        let late = Peer::new(&broker, &format!("robot/{version}/#"));
        until("what is retained", || late.heard().iter().any(|(.., is_retained)| *is_retained));

        // A replay of what came: no broker, the same messages.
        let only_received: Vec<_> = {
            let exchanges = exchanges.lock().unwrap();
            exchanges.iter().filter(|exchange| exchange.instruction.is_empty()).cloned().collect()
        };
        let mut again = Robot::new();
        let repeated = again.collect::<Twist>("cmd_vel");
        again.add(DeviceLink::recorded(only_received), options());
        for _ in 0..robot.cycles {
            again.cycle();
        }
        assert_eq!(*repeated.lock().unwrap(), *twists.lock().unwrap());
    }
}

#[test]
fn a_broker_that_is_away_or_restarts_is_found_again_and_nothing_that_waited_is_lost() {
    let Some(mut broker) = Mosquitto::start() else { return };
    broker.stop();
    for version in ["3.1.1", "5"] {
        let mut robot = Robot::new();
        let connected = robot.collect::<Bool>("mqtt/connected");
        let exchanges = robot.collect::<BusExchange>("mqtt/exchanges");
        let received = robot.collect::<Text>("orders");
        let settings = [
            ("send", texts(["count std_msgs/msg/Float64 count qos1"])),
            ("receive", texts(["orders std_msgs/msg/String orders qos1"])),
        ];
        robot.add(DeviceLink::new(Broker::default()), options(broker.port, version, &settings));
        let count: Inlet<Float64> = robot.core.inlet("count").unwrap();
        robot.until("the absence is reported", || {
            exchanges.lock().unwrap().iter().any(|exchange| exchange.kind == BusExchange::CLOSE)
        });
        assert!(connected.lock().unwrap().is_empty());
        // More than fit: the oldest are dropped, and that is said.
        for number in 0..MOST_WAITING + 3 {
            count.publish(Float64 { data: number as f64 }).unwrap();
            robot.cycle();
        }
        (0..3).for_each(|_| robot.cycle());
        let dropped =
            exchanges.lock().unwrap().iter().filter(|exchange| exchange.error.contains("dropped")).count();
        assert_eq!(dropped, 3);

        for round in 0..2 {
            broker.restart();
            let peer = Peer::new(&broker, "count");
            robot.until("connected", || is_connected(&connected));
            count.publish(Float64 { data: 1000.0 + f64::from(round) }).unwrap();
            let newest = format!("{}", 1000 + round);
            let is_newest = |(_, payload, _): &Heard| String::from_utf8_lossy(payload).contains(&newest);
            robot.until("the newest message", || peer.heard().iter().any(is_newest));
            peer.say("orders", br#"{"data": "go"}"#);
            robot.until("subscribed again", || received.lock().unwrap().len() == round as usize + 1);
            broker.stop();
            robot.until("the loss is noticed", || !is_connected(&connected));
        }
    }
}

#[test]
fn all_that_waited_arrives_in_order() {
    let Some(mut broker) = Mosquitto::start() else { return };
    broker.stop();
    let mut robot = Robot::new();
    let connected = robot.collect::<Bool>("mqtt/connected");
    let settings = [
        ("send", texts(["count std_msgs/msg/Float64 count qos1 retain"])),
        ("status_topic", "up".to_owned().into()),
    ];
    robot.add(DeviceLink::new(Broker::default()), options(broker.port, "5", &settings));
    let count: Inlet<Float64> = robot.core.inlet("count").unwrap();
    for number in 0..100 {
        count.publish(Float64 { data: f64::from(number) }).unwrap();
        robot.cycle();
    }
    broker.restart();
    let peer = Peer::new(&broker, "count");
    robot.until("connected", || is_connected(&connected));
    robot.until("the last message", || peer.heard().last().is_some_and(|last| last.1 == b"{\"data\":99.0}"));
    let numbers: Vec<_> =
        peer.heard().iter().map(|(_, payload, _)| String::from_utf8(payload.clone()).unwrap()).collect();
    // The peer subscribed before the robot came, or found one retained message: what follows is without gaps.
    assert!(numbers.len() >= 2, "{numbers:?}");
    let first = 100 - numbers.len();
    let expected: Vec<_> = (first..100).map(|number| format!("{{\"data\":{number}.0}}")).collect();
    assert_eq!(numbers, expected);
}

#[test]
fn the_broker_tells_others_that_a_robot_is_there_has_left_or_is_lost() {
    let Some(mut broker) = Mosquitto::start() else { return };
    for version in ["3.1.1", "5"] {
        let status = || Peer::new(&broker, "darwin/status");
        let says = |peer: &Peer, text: &[u8]| peer.heard().last().is_some_and(|(_, last, _)| last == text);
        let settings = [("status_topic", "darwin/status".to_owned().into())];
        let mut robot = Robot::new();
        robot.add(DeviceLink::new(Broker::default()), options(broker.port, version, &settings));
        let peer = status();
        robot.until("the robot is there", || says(&peer, b"online"));
        drop(robot);
        until("the robot has left", || says(&peer, b"offline"));

        // Lost: a process that ends without a farewell. Its side of the connection is a relay, which is cut.
        let relay = TcpListener::bind("127.0.0.1:0").unwrap();
        let relay_port = relay.local_addr().unwrap().port();
        let broker_port = broker.port;
        let cut = std::thread::spawn(move || {
            let (mut robot, _) = relay.accept().unwrap();
            let mut broker = TcpStream::connect(("127.0.0.1", broker_port)).unwrap();
            let (mut from_broker, mut to_robot) = (broker.try_clone().unwrap(), robot.try_clone().unwrap());
            std::thread::spawn(move || std::io::copy(&mut from_broker, &mut to_robot));
            let end = robot.try_clone().unwrap();
            let there = broker.try_clone().unwrap();
            std::thread::spawn(move || std::io::copy(&mut robot, &mut broker));
            (end, there)
        });
        let mut robot = Robot::new();
        robot.add(DeviceLink::new(Broker::default()), options(relay_port, version, &settings));
        robot.until("the robot is there again", || says(&peer, b"online"));
        let (robot_side, broker_side) = cut.join().unwrap();
        broker_side.shutdown(std::net::Shutdown::Both).unwrap();
        until("the will", || says(&peer, b"offline"));
        robot_side.shutdown(std::net::Shutdown::Both).unwrap();
    }
    broker.stop();
}

#[test]
fn wrong_settings_are_refused_with_the_remedy() {
    for (settings, reason) in [
        (("send", texts(["a sensor_msgs/msg/Imus b"])), "did you mean \"sensor_msgs/msg/Imu\""),
        (("send", texts(["a std_msgs/msg/Bool b/#"])), "is a filter"),
        (("receive", texts(["a"])), "begin with a topic"),
        (("port", 0.into()), "between 1 and 65535"),
        (("keep_alive", 1.into()), "between 5 and 3600"),
        (("version", "4".to_owned().into()), "none of 3.1.1, 5"),
        (("status_topic", "a/+".to_owned().into()), "wildcards"),
    ] {
        let settings = [(settings.0.to_owned(), settings.1)].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        let module = Mqtt::new(DeviceLink::new(Broker::default()), Interfaces::carried());
        let refused = Core::new().add_with("mqtt", module, options).unwrap_err().to_string();
        assert!(refused.contains(reason), "{refused}");
    }
    let both = [
        ("send", texts(["a std_msgs/msg/Bool robot/a"])),
        ("receive", texts(["a std_msgs/msg/Bool robot/#"])),
    ];
    let module = Mqtt::new(DeviceLink::new(Broker::default()), Interfaces::carried());
    let refused = Core::new().add_with("mqtt", module, options(1883, "5", &both)).unwrap_err().to_string();
    assert!(refused.contains("for ever"), "{refused}");
}
