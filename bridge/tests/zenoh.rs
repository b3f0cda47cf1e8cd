//! Nodes on Zenoh, seen and used by Zenoh's own Python package, which speaks as `rmw_zenoh_cpp` does.
#![allow(clippy::unwrap_used)]

use bytes::Bytes;
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Exposure, expose};
mod common;

use common::matrix::{Check, Way, With, check};
use downbeat_bridge::middleware::zenoh::ZenohParticipant;
use downbeat_bridge::middleware::{
    Direction, DiscoveryRange, EndpointEvent, ParticipantOptions, Priority, Sample, SendOptions,
};
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_executor::Core;
use downbeat_msgs::qos::{History, QosProfile};
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use downbeat_msgs::{Message, Service, cdr};
use downbeat_zenoh::Settings;
use downbeat_zenoh::wire::{Attachment, Token, gid};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

const WATCHDOG: Duration = Duration::from_secs(30);
const DOMAIN: u16 = 85;

/// The router, and what it does for a test.
struct Router {
    child: Child,
    input: ChildStdin,
    said: Receiver<Value>,
    kept: Vec<Value>,
    port: u16,
}

impl Router {
    /// `None` without Python.
    fn start() -> Option<Self> {
        Self::start_with(&[])
    }

    fn start_with(arguments: &[&str]) -> Option<Self> {
        let python = test_machine::interpreter("DOWNBEAT_PYTHON")?;
        // Another program may take a free port before the router does.
        let started = (0..5).find_map(|_| Self::start_by(&python, arguments));
        Some(started.expect("a router starts"))
    }

    /// The same for a check.
    fn start_for(check: Check) -> Option<(Self, Check)> {
        match Self::start() {
            Some(router) => Some((router, check)),
            None => {
                check.skipped();
                None
            }
        }
    }

    /// `None` if it ended before it was ready.
    fn start_by(python: &OsStr, arguments: &[&str]) -> Option<Self> {
        let port = TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port();
        let mut command = Command::new(python);
        command.args(["-B", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/zenoh/peer.py"), &port.to_string()]);
        command.args(arguments);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (sender, said) = channel();
        let output = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                if sender.send(serde_json::from_str(&line).unwrap()).is_err() {
                    return;
                }
            }
        });
        let input = child.stdin.take().unwrap();
        let router = Self { child, input, said, kept: Vec::new(), port };
        let ready: Value = router.said.recv_timeout(WATCHDOG).ok()?;
        assert_eq!(ready["kind"], "ready");
        Some(router)
    }

    fn act(&mut self, what: &Value) {
        writeln!(self.input, "{what}").unwrap();
        self.input.flush().unwrap();
    }

    /// The next thing of this kind that it says. Others are kept: its threads say theirs in between.
    fn next(&mut self, kind: &str) -> Value {
        if let Some(position) = self.kept.iter().position(|said| said["kind"] == kind) {
            return self.kept.remove(position);
        }
        loop {
            let said = self.said.recv_timeout(WATCHDOG).expect("the router says something");
            if said["kind"] == kind {
                return said;
            }
            self.kept.push(said);
        }
    }

    /// Does something and waits until it is done.
    fn done(&mut self, what: &Value) {
        self.act(what);
        self.next("done");
    }

    /// Publishes until the router has the sample: the publisher hears of the subscription some time later.
    fn heard(&mut self, cdr: &[u8], mut publish: impl FnMut()) -> Value {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < WATCHDOG, "the router does not hear it");
            publish();
            if let Ok(said) = self.said.recv_timeout(Duration::from_millis(200))
                && said["kind"] == "sample"
                && unhex(&said["payload"]) == cdr
            {
                return said;
            }
        }
    }

    fn tokens(&mut self) -> Vec<String> {
        self.act(&json!({"do": "tokens", "key": format!("@ros2_lv/{DOMAIN}/**")}));
        let tokens = self.next("tokens");
        tokens["tokens"].as_array().unwrap().iter().map(|token| token.as_str().unwrap().to_owned()).collect()
    }

    /// The token with this part, once it is there.
    fn token(&mut self, part: &str) -> String {
        let mut found = None;
        wait_until("the token is there", || {
            found = self.tokens().into_iter().find(|token| token.contains(part));
            found.is_some()
        });
        found.unwrap()
    }

    fn join(&self) -> Participant {
        Participant::on(self.session()).unwrap()
    }

    fn session(&self) -> Arc<ZenohParticipant> {
        Self::session_through(self.port, "listen/endpoints=[\"tcp/127.0.0.1:0\"]")
    }

    /// A session that connects to a port, with more of its configuration.
    fn session_through(port: u16, more: &str) -> Arc<ZenohParticipant> {
        let overrides = format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"];{more}");
        let zenoh = Settings { overrides: Some(overrides), router_check_attempts: 20, ..Settings::default() };
        let options = ParticipantOptions {
            discovery_range: DiscoveryRange::Localhost,
            zenoh,
            ..ParticipantOptions::new(DOMAIN)
        };
        Arc::new(ZenohParticipant::new(&options).unwrap())
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < WATCHDOG, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn golden() -> NodeName {
    NodeName::new("/ns1", "golden").unwrap()
}

fn text_type() -> MessageType {
    MessageType::new(Text::TYPE_NAME).unwrap()
}

fn text(data: &str) -> Vec<u8> {
    cdr::to_vec(&Text { data: data.to_owned() })
}

fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &Value) -> Vec<u8> {
    let digits = text.as_str().unwrap().as_bytes();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn key_of_text(name: &str) -> String {
    format!("{DOMAIN}/{name}/std_msgs::msg::dds_::String_/{}", Text::TYPE_HASH)
}

fn key_of_service(name: &str) -> String {
    format!("{DOMAIN}/{name}/std_srvs::srv::dds_::SetBool_/{}", SetBool::TYPE_HASH)
}

#[test]
fn the_tokens_of_a_node_are_those_of_rmw_zenoh() {
    let check = check(
        "Graph",
        "names, tokens, hashes and QoS of a node, byte for byte",
        With::EclipseZenoh,
        Way::Out,
    );
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let participant = router.join();
    let node = participant.create_node(golden()).unwrap();
    let kind = text_type();
    let _chatter = node.publish("chatter", &kind, QosProfile::DEFAULT).unwrap();
    let latched =
        QosProfile { durability: QosProfile::LATCHED.durability, ..QosProfile::DEFAULT.keep_last(3) };
    let _latched = node.publish("/latched", &kind, latched).unwrap();
    let sensor = QosProfile::SENSOR_DATA.keep_last(5);
    let _heard = node.subscribe("/abs/be", &kind, sensor, Box::new(|_| ())).unwrap();
    let answer = |_| SetBoolResponse::default();
    let _server = node.serve::<SetBool>("/sb", QosProfile::SERVICES, answer).unwrap();
    let _client = node.client::<SetBool>("~/other", QosProfile::SERVICES).unwrap();

    wait_until("all tokens are there", || router.tokens().len() == 7);
    let tokens = router.tokens();
    let session = tokens[0].split('/').nth(2).unwrap().to_owned();
    let description = downbeat_msgs::type_description_interfaces::srv::GetTypeDescription::TYPE_HASH;
    let string = format!("std_msgs::msg::dds_::String_/{}", Text::TYPE_HASH);
    let set_bool = format!("std_srvs::srv::dds_::SetBool_/{}", SetBool::TYPE_HASH);
    let mut expected: Vec<String> = [
        "0/NN/%/%ns1/golden".to_owned(),
        format!(
            "1/SS/%/%ns1/golden/%ns1%golden%get_type_description/type_description_interfaces::srv::dds_::\
             GetTypeDescription_/{description}/::,10:,:,:,,"
        ),
        format!("2/MP/%/%ns1/golden/%ns1%chatter/{string}/::,10:,:,:,,"),
        format!("3/MP/%/%ns1/golden/%latched/{string}/:1:,3:,:,:,,"),
        format!("4/MS/%/%ns1/golden/%abs%be/{string}/2::,5:,:,:,,"),
        format!("5/SS/%/%ns1/golden/%sb/{set_bool}/::,10:,:,:,,"),
        format!("6/SC/%/%ns1/golden/%ns1%golden%other/{set_bool}/::,10:,:,:,,"),
    ]
    .into_iter()
    .map(|rest| format!("@ros2_lv/{DOMAIN}/{session}/0/{rest}"))
    .collect();
    expected.sort();
    assert_eq!(tokens, expected);

    drop((_chatter, _latched, _heard, _server, _client, node));
    wait_until("all tokens are gone", || router.tokens().is_empty());
}

#[test]
fn samples_go_both_ways_with_the_attachments_of_rmw_zenoh() {
    let check = check("Topics", "reliable messages, byte for byte", With::EclipseZenoh, Way::Both);
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let session = router.session();
    let participant = Participant::on(Arc::<ZenohParticipant>::clone(&session)).unwrap();
    let node = participant.create_node(golden()).unwrap();
    let publisher = node.publish("chatter", &text_type(), QosProfile::DEFAULT).unwrap();
    let (sender, samples) = channel::<Sample>();
    let hear = Box::new(move |sample| drop(sender.send(sample)));
    let _heard = node.subscribe("/sensor", &text_type(), QosProfile::DEFAULT, hear).unwrap();

    router.done(&json!({"do": "subscribe", "key": key_of_text("ns1/chatter")}));
    let token = router.token("/MP/%/%ns1/golden/%ns1%chatter/");
    let hello = text("hello");
    let sample = router.heard(&hello, || publisher.publish(hello.clone().into()).unwrap());
    assert_eq!(sample["key"], *key_of_text("ns1/chatter"));
    assert_eq!((&sample["congestion"], &sample["encoding"]), (&json!("DROP"), &json!("zenoh/bytes")));
    assert_eq!((&sample["priority"], &sample["express"]), (&json!("DATA"), &json!(false)));
    assert_eq!(sample["has_time"], true);
    let attachment = unhex(&sample["attachment"]);
    assert_eq!(attachment.len(), 33);
    let attachment = Attachment::parse(&attachment).unwrap();
    assert!(attachment.sequence_number >= 1);
    assert_eq!(attachment.gid, gid(&token));

    // What is no sample of ROS 2 is skipped.
    let (key, good) = (key_of_text("sensor"), hex(text("good")));
    let whole = hex(Attachment { sequence_number: 3, source_time_ns: 7, gid: [0x22; 16] }.to_bytes());
    for (attachment, payload) in [
        ("none", &*good),
        ("010203", &*good),
        ("", &*good),
        (&*whole, ""),
        (&*whole, "0102"),
        (&whole[..64], &*good),
    ] {
        router.done(&json!({"do": "put", "key": key, "payload": payload, "attachment": attachment}));
    }
    let other_hash = key.replace("RIHS01_df", "RIHS01_00");
    router.done(&json!({"do": "put", "key": other_hash, "payload": good, "attachment": whole}));
    router.done(&json!({"do": "put", "key": key, "payload": good, "attachment": whole}));
    let received = samples.recv_timeout(WATCHDOG).unwrap();
    assert_eq!((&received.cdr[..], received.sequence_number), (&text("good")[..], 3));
    assert_eq!((received.source_time_ns, received.writer.0), (Some(7), [0x22; 16]));
    assert!(samples.recv_timeout(Duration::from_millis(300)).is_err(), "it comes once");
    assert_eq!(session.skipped(), 6);
}

#[test]
fn samples_have_the_priority_that_their_topic_is_exposed_with() {
    let check = check("Quality of service", "the priority of a topic", With::EclipseZenoh, Way::Out);
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let node = router.join().create_node(golden()).unwrap();
    let mut core = Core::new();
    let message_type = Interfaces::carried().message(Text::TYPE_NAME).unwrap();
    let topics = Priority::ALL.map(|(name, priority)| {
        let send = SendOptions { priority, is_express: priority == Priority::RealTime };
        let qos = QosProfile { history: History::KeepAll, ..QosProfile::DEFAULT };
        let exposure = Exposure::new(name, message_type, Direction::Out);
        (core.inlet::<Text>(name).unwrap(), Exposure { send, qos: qos.into(), ..exposure })
    });
    expose(&mut core, &node, &topics.each_ref().map(|(_, exposure)| exposure.clone())).unwrap();
    router.done(&json!({"do": "subscribe", "key": key_of_text("ns1/*")}));
    for (number, (inlet, Exposure { topic, send, .. })) in topics.iter().enumerate() {
        let token = format!(
            "@ros2_lv/{DOMAIN}/abc/0/{number}/MS/%/%/listener/%ns1%{topic}/std_msgs::msg::dds_::String_/{}/::,10:,:,:,,",
            Text::TYPE_HASH
        );
        router.done(&json!({"do": "announce", "token": token}));
        let sample = router.heard(&text(topic), || {
            inlet.publish(Text { data: topic.clone() }).unwrap();
            core.cycle().unwrap();
        });
        assert_eq!(sample["priority"], topic.to_uppercase());
        assert_eq!(sample["express"], send.is_express);
        assert_eq!(sample["congestion"], "BLOCK", "priorities do not change what may be dropped");
    }
}

/// Forwards a connection to the router, with a pause after every 8 kB, and counts the bytes.
fn relay(port: u16, pause: Duration) -> (u16, Arc<AtomicUsize>) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let own = listener.local_addr().unwrap().port();
    let bytes = Arc::<AtomicUsize>::default();
    let count = Arc::clone(&bytes);
    std::thread::spawn(move || {
        let (mut session, _) = listener.accept().unwrap();
        let mut router = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let (mut from_router, mut to_session) = (router.try_clone().unwrap(), session.try_clone().unwrap());
        std::thread::spawn(move || std::io::copy(&mut from_router, &mut to_session));
        let mut buffer = [0; 8192];
        while let Ok(read @ 1..) = session.read(&mut buffer) {
            count.fetch_add(read, Ordering::Relaxed);
            if router.write_all(&buffer[..read]).is_err() {
                return;
            }
            std::thread::sleep(pause);
        }
    });
    (own, bytes)
}

#[test]
fn small_messages_of_a_high_priority_pass_a_stream_that_fills_a_slow_link() {
    const PINGS: usize = 20;
    /// How many of them arrive.
    fn arrived(priority: Priority) -> Option<usize> {
        let mut router = Router::start()?;
        // 800 kB/s, with small buffers in front.
        let (port, bytes) = relay(router.port, Duration::from_millis(10));
        let session = Router::session_through(port, "mode=\"client\";transport/link/tcp/so_sndbuf=65536");
        let node = Participant::on(session).unwrap().create_node(golden()).unwrap();
        router.done(&json!({"do": "ignore", "key": key_of_text("stream")}));
        router.done(&json!({"do": "subscribe", "key": key_of_text("ping")}));
        let publish = |topic, priority| {
            let send = SendOptions { priority, ..SendOptions::default() };
            node.publish_with(topic, &text_type(), QosProfile::SENSOR_DATA, send).unwrap()
        };
        let (stream, ping) = (publish("/stream", Priority::Data), publish("/ping", priority));
        let first = text("first");
        router.heard(&first, || ping.publish(first.clone().into()).unwrap());
        let is_over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let large = Bytes::from(text(&"x".repeat(200_000)));
                while !is_over.load(Ordering::Relaxed) {
                    stream.publish(large.clone()).unwrap();
                }
            });
            wait_until("the link is full", || bytes.load(Ordering::Relaxed) > 500_000);
            for number in 0..PINGS {
                ping.publish(text(&number.to_string()).into()).unwrap();
                std::thread::sleep(Duration::from_millis(50));
            }
            is_over.store(true, Ordering::Relaxed);
        });
        let mut heard = BTreeSet::new();
        let start = Instant::now();
        while !heard.contains(&text("last")) {
            assert!(start.elapsed() < WATCHDOG, "the last one does not arrive");
            ping.publish(text("last").into()).unwrap();
            heard.extend(
                router.said.recv_timeout(Duration::from_millis(50)).map(|said| unhex(&said["payload"])),
            );
        }
        Some((0..PINGS).filter(|number| heard.contains(&text(&number.to_string()))).count())
    }
    let (Some(high), Some(same)) = (arrived(Priority::RealTime), arrived(Priority::Data)) else { return };
    assert_eq!(high, PINGS);
    assert!(same < PINGS, "the link is not full");
}

#[test]
fn a_link_is_compressed_if_both_sides_say_so() {
    const LENGTH: usize = 1 << 20;
    let sent = |compression: bool| {
        let mut router = Router::start_with(&[&compression.to_string()])?;
        let (port, bytes) = relay(router.port, Duration::ZERO);
        let more = format!("transport/unicast/compression/enabled={compression};mode=\"client\"");
        let participant = Participant::on(Router::session_through(port, &more)).unwrap();
        let node = participant.create_node(golden()).unwrap();
        router.done(&json!({"do": "subscribe", "key": key_of_text("map")}));
        let qos = QosProfile { history: History::KeepAll, ..QosProfile::DEFAULT };
        let publisher = node.publish("/map", &text_type(), qos).unwrap();
        let map = text(&"free ".repeat(LENGTH / 5));
        router.heard(&map, || publisher.publish(map.clone().into()).unwrap());
        Some(bytes.load(Ordering::Relaxed))
    };
    let (Some(plain), Some(compressed)) = (sent(false), sent(true)) else { return };
    assert!(plain > LENGTH && compressed < LENGTH / 10, "{plain} and {compressed} bytes");
}

#[test]
fn services_are_called_both_ways() {
    let check = check("Services", "calls", With::EclipseZenoh, Way::Both);
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let participant = router.join();
    let node = participant.create_node(golden()).unwrap();
    let answer = |request: SetBoolRequest| SetBoolResponse { success: request.data, message: "done".into() };
    let _server = node.serve::<SetBool>("/sb", QosProfile::SERVICES, answer).unwrap();
    let request = hex(cdr::to_vec(&SetBoolRequest { data: true }));
    let expected = SetBoolResponse { success: true, message: "done".into() };

    let key = key_of_service("sb");
    wait_until("the server is announced", || router.tokens().iter().any(|token| token.contains("/%sb/")));
    router.act(&json!({"do": "get", "key": key, "payload": request, "number": 7}));
    let replies = router.next("replies");
    assert_eq!(replies["replies"].as_array().unwrap().len(), 1, "{replies}");
    let reply = &replies["replies"][0];
    assert_eq!((&reply["key"], unhex(&reply["payload"])), (&json!(key), cdr::to_vec(&expected)));
    let attachment = Attachment::parse(&unhex(&reply["attachment"])).unwrap();
    assert_eq!((attachment.sequence_number, attachment.gid), (7, [0x11; 16]));

    // A query without attachment and payload ends at once, without an answer.
    router.act(&json!({"do": "get", "key": key, "payload": "", "number": 8, "is_bare": true}));
    let replies = router.next("replies");
    assert_eq!(replies["replies"], json!([]));
    assert!(replies["seconds"].as_f64().unwrap() < 10.0, "{replies}");

    // A server of another definition is not called.
    let client = node.client::<SetBool>("/theirs", QosProfile::SERVICES).unwrap();
    let token = format!(
        "@ros2_lv/{DOMAIN}/abc/0/1/SS/%/%/other/%theirs/std_srvs::srv::dds_::SetBool_/{}/::,10:,:,:,,",
        SetBool::TYPE_HASH
    );
    assert!(token.parse::<Token>().is_ok());
    router.done(&json!({"do": "announce", "token": token.replace("RIHS01_abe9", "RIHS01_0000")}));
    router
        .done(&json!({"do": "serve", "key": key_of_service("theirs"), "reply": hex(cdr::to_vec(&expected))}));
    wait_until("the other is listed", || {
        participant.found().endpoints.iter().any(|endpoint| endpoint.name == "/theirs")
    });
    assert!(!client.is_available(), "its definition is another one");
    router.done(&json!({"do": "announce", "token": token}));
    assert!(client.wait_for_service(WATCHDOG));
    let answer = client.call_and_wait(&SetBoolRequest { data: false }, WATCHDOG).unwrap();
    assert_eq!(answer, expected);
    let query = router.next("query");
    assert_eq!(unhex(&query["payload"]), cdr::to_vec(&SetBoolRequest { data: false }));
    let attachment = Attachment::parse(&unhex(&query["attachment"])).unwrap();
    let own = router.tokens().into_iter().find(|token| token.contains("/SC/%/%ns1/golden/%theirs/")).unwrap();
    assert_eq!((attachment.sequence_number, attachment.gid), (1, gid(&own)));

    // A request that finds no way is sent again.
    let lossy = node.client::<SetBool>("/lossy", QosProfile::SERVICES).unwrap();
    router.done(
        &json!({"do": "announce", "token": token.replace("theirs", "lossy").replace("/0/1/SS", "/0/2/SS")}),
    );
    let reply = hex(cdr::to_vec(&expected));
    router.done(&json!({"do": "serve", "key": key_of_service("lossy"), "reply": reply, "lost": 2}));
    assert!(lossy.wait_for_service(WATCHDOG));
    assert_eq!(lossy.call_and_wait(&SetBoolRequest { data: true }, WATCHDOG).unwrap(), expected);
    let attachment = Attachment::parse(&unhex(&router.next("query")["attachment"])).unwrap();
    assert_eq!(attachment.sequence_number, 1);
}

#[test]
fn late_subscriptions_get_the_last_samples_both_ways() {
    let check = check("Topics", "latched messages to late joiners", With::EclipseZenoh, Way::Both);
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let participant = router.join();
    let node = participant.create_node(golden()).unwrap();
    let latched =
        QosProfile { durability: QosProfile::LATCHED.durability, ..QosProfile::DEFAULT.keep_last(3) };
    let publisher = node.publish("/latched", &text_type(), latched).unwrap();
    for number in 1..=5 {
        publisher.publish(text(&number.to_string()).into()).unwrap();
    }
    router.done(&json!({"do": "latched_subscription", "key": key_of_text("latched"), "depth": 3}));
    // Those before the last three may still have been on their way to the router.
    let mut heard = Vec::new();
    while heard.last() != Some(&text("5")) {
        heard.push(unhex(&router.next("sample")["payload"]));
    }
    assert!(heard.ends_with(&["3", "4", "5"].map(text)) && heard.is_sorted(), "{heard:?}");

    let payloads: Vec<_> = (1..=5).map(|number| hex(text(&number.to_string()))).collect();
    router.done(&json!({"do": "latched_publisher", "key": key_of_text("theirs"), "payloads": payloads}));
    let (sender, samples) = channel::<Sample>();
    let hear = Box::new(move |sample| drop(sender.send(sample)));
    let _late = node.subscribe("/theirs", &text_type(), latched, hear).unwrap();
    let mut heard = Vec::new();
    while heard.last() != Some(&text("5")) {
        heard.push(samples.recv_timeout(WATCHDOG).unwrap().cdr.to_vec());
    }
    assert!(heard.ends_with(&["3", "4", "5"].map(text)) && heard.is_sorted(), "{heard:?}");
    assert!(samples.recv_timeout(Duration::from_millis(300)).is_err(), "each comes once");
}

#[test]
fn another_definition_of_a_topic_is_reported() {
    let check = check("Graph", "another definition of a type is reported", With::EclipseZenoh, Way::In);
    let Some((mut router, _check)) = Router::start_for(check) else { return };
    let participant = router.join();
    let node = participant.create_node(golden()).unwrap();
    let publisher = node.publish("/chatter", &text_type(), QosProfile::DEFAULT).unwrap();
    let (sender, events) = channel();
    publisher.on_event(Box::new(move |event| drop(sender.send(event.clone()))));
    let other = Text::TYPE_HASH.replace("RIHS01_df", "RIHS01_00");
    let token = format!(
        "@ros2_lv/{DOMAIN}/abc/0/1/MS/%/%ns2/listener/%chatter/std_msgs::msg::dds_::String_/{other}/::,10:,:,:,,"
    );
    router.done(&json!({"do": "announce", "token": token}));
    let expected = EndpointEvent::IncompatibleDefinition {
        peer: downbeat_bridge::middleware::Gid(gid(&token)),
        type_hash: Some(other[..].into()),
    };
    assert_eq!(events.recv_timeout(WATCHDOG).unwrap(), expected);
    let nodes: Vec<_> = participant.found().nodes.into_iter().map(|node| (node.name, node.vendor)).collect();
    assert_eq!(nodes, [("/ns2/listener".to_owned(), "Zenoh".to_owned())]);
}

#[test]
fn nodes_of_two_processes_find_and_describe_each_other() {
    let Some(router) = Router::start() else { return };
    let (robot, observer) = (router.join(), router.join());
    let node = robot.create_node(golden()).unwrap();
    let _text = node.publish("chatter", &text_type(), QosProfile::DEFAULT).unwrap();
    let answer = |_| SetBoolResponse::default();
    let server = node.serve::<SetBool>("light", QosProfile::SERVICES, answer).unwrap();
    let watching = observer.create_node(NodeName::new("/", "observer").unwrap()).unwrap();
    wait_until("the node is found with its endpoints", || {
        observer.remote_nodes().iter().any(|node| node.name == "/ns1/golden" && node.endpoints.len() == 1)
            && observer.found().endpoints.iter().any(|endpoint| endpoint.name == "/ns1/light")
    });
    let light =
        observer.found().endpoints.into_iter().find(|endpoint| endpoint.name == "/ns1/light").unwrap();
    assert_eq!((&*light.type_name, light.node.as_deref()), (SetBool::TYPE_NAME, Some("/ns1/golden")));
    assert_eq!(light.remote.type_hash.as_deref(), Some(SetBool::TYPE_HASH));
    let topic = watching.topic_name("/ns1/chatter").unwrap();
    let described = watching.describe(&topic, &text_type(), WATCHDOG).unwrap();
    assert!(described.text.contains("string data"), "{}", described.text);
    let [request, response] =
        watching.describe_service(server.name(), server.service_type(), WATCHDOG).unwrap();
    assert!(request.text.contains("bool data"), "{}", request.text);
    assert!(response.text.contains("string message"), "{}", response.text);
    drop((_text, server, node, robot));
    wait_until("it has left", || observer.found().nodes.is_empty());
}
