//! The page of our own: its files, its questions, and who may use it.

use crate::support::{Robot, TOKEN, Viewer, WATCHDOG, open, robot, until};
use downbeat_view::{Ask, Host, PageOptions, Panel, PanelScript, ViewOptions, ViewServer};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;

const PROTOCOL: &str = "downbeat.view.v1";

/// Knows one question that changes something, and one that does not.
struct Counter;

impl Host for Counter {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        match ask.name {
            "double" => {
                Some(ask.arguments["number"].as_i64().map(|n| json!(2 * n)).ok_or("no number".into()))
            }
            "erase" => Some(ask.check_access().map(|()| json!("erased"))),
            _ => None,
        }
    }
}

fn page(change: impl FnOnce(&mut PageOptions)) -> Robot {
    let panel = Panel {
        name: "legs".into(),
        title: "Legs".into(),
        module: "legs".into(),
        script: PanelScript::Text("export default { title: 'Legs', create() {} };".into()),
        topics: vec!["joint_states".into()],
    };
    let mut options = PageOptions {
        port: Some(0),
        hosts: vec!["robot.local".into()],
        panels: vec![panel],
        host: Some(Arc::new(Counter)),
        ..PageOptions::default()
    };
    change(&mut options);
    robot(|view| view.page = Some(options))
}

fn address(robot: &Robot) -> SocketAddr {
    robot.server.as_ref().unwrap().page_address().unwrap()
}

/// Sends a request with these lines, and returns the whole answer.
fn request(address: SocketAddr, path: &str, lines: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(WATCHDOG)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\n{lines}Connection: close\r\n\r\n").unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

fn status(answer: &str) -> &str {
    answer.split(' ').nth(1).unwrap_or_default()
}

/// A question and its answer.
fn ask(viewer: &mut Viewer, question: Value) -> Result<Value, String> {
    let mut question = question;
    (question["op"], question["id"]) = (json!("ask"), json!(7));
    viewer.send(question);
    let mut answer = viewer.json("answer");
    assert_eq!(answer["id"], 7);
    match answer["error"].as_str() {
        Some(error) => Err(error.to_owned()),
        None => Ok(answer["ok"].take()),
    }
}

#[test]
fn the_page_is_served_and_nothing_else() {
    let robot = page(|_| ());
    let host = format!("Host: {}\r\n", address(&robot));
    let index = request(address(&robot), "/", &host);
    assert_eq!(status(&index), "200");
    assert!(index.contains("default-src 'none'") && !index.contains("unsafe-inline"));
    assert!(index.contains("Content-Type: text/html") && index.contains("<script"));
    assert!(request(address(&robot), "/panels/legs/panel.js", &host).ends_with("create() {} };"));
    let version = index.lines().find_map(|line| line.strip_prefix("ETag: ")).unwrap();
    assert_eq!(status(&request(address(&robot), "/", &format!("{host}If-None-Match: {version}\r\n"))), "304");
    for path in [
        "/../Cargo.toml",
        "/..%2fCargo.toml",
        "//etc/passwd",
        "/panels/../app.js",
        "/panels/other/panel.js",
        "/nothing.js",
    ] {
        assert_eq!(status(&request(address(&robot), path, &host)), "404", "{path}");
    }
}

#[test]
fn other_names_and_pages_are_refused() {
    let robot = page(|_| ());
    let at = address(&robot);
    let websocket = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                     Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: downbeat.view.v1\r\n";
    for (lines, expected) in [
        ("Host: localhost\r\n".to_owned(), "200"),
        ("Host: robot.local:80\r\n".to_owned(), "200"),
        (format!("Host: {at}\r\nOrigin: http://{at}\r\n"), "200"),
        (String::new(), "421"),
        ("Host: evil.example\r\n".to_owned(), "421"),
        (format!("Host: {at}\r\nOrigin: http://evil.example\r\n"), "403"),
        (format!("Host: {at}\r\nOrigin: https://{at}\r\n"), "403"),
        (format!("Host: {at}\r\nOrigin: null\r\n"), "403"),
    ] {
        assert_eq!(status(&request(at, "/", &lines)), expected, "{lines}");
        let of_websocket = if expected == "200" { "101" } else { expected };
        assert_eq!(status(&request(at, "/ws", &format!("{lines}{websocket}"))), of_websocket, "{lines}");
    }
}

#[test]
fn questions_are_answered_by_the_core_and_by_the_host() {
    let robot = page(|_| ());
    let mut viewer = Viewer::of(open(address(&robot), &format!("/ws?token={TOKEN}"), PROTOCOL).unwrap());
    let info = ask(&mut viewer, json!({ "ask": "robot" })).unwrap();
    assert_eq!((&info["name"], &info["mayChange"]), (&json!("test robot"), &json!(true)));
    assert_eq!(info["panels"][0]["script"], "/panels/legs/panel.js");
    let snapshot = ask(&mut viewer, json!({ "ask": "snapshot" })).unwrap();
    assert_eq!(snapshot["modules"][0]["name"], "legs");
    let graph = ask(&mut viewer, json!({ "ask": "graph" })).unwrap();
    assert!(graph["topics"].as_array().unwrap().iter().any(|topic| topic["name"] == "cmd_vel"));
    assert_eq!(ask(&mut viewer, json!({ "ask": "latencies" })), Ok(json!([])), "no robot file names chains");
    let settings = ask(&mut viewer, json!({ "ask": "settings" })).unwrap();
    let gain = settings.as_array().unwrap().iter().find(|setting| setting["name"] == "gain").unwrap();
    assert_eq!(
        (&gain["type"], &gain["value"], &gain["range"]),
        (&json!("double"), &json!(1.0), &json!([0.0, 10.0]))
    );
    ask(&mut viewer, json!({ "ask": "set", "module": "legs", "name": "gain", "value": 2 })).unwrap();
    let refused = ask(&mut viewer, json!({ "ask": "set", "module": "legs", "name": "gain", "value": 11 }));
    assert!(refused.unwrap_err().contains("out of range"));
    assert_eq!(ask(&mut viewer, json!({ "ask": "double", "number": 21 })), Ok(json!(42)));
    assert_eq!(ask(&mut viewer, json!({ "ask": "erase" })), Ok(json!("erased")));
    assert!(ask(&mut viewer, json!({ "ask": "fly" })).unwrap_err().contains("\"fly\""));
    let lifecycle = ask(&mut viewer, json!({ "ask": "lifecycle" })).unwrap();
    assert_eq!(lifecycle, json!([{ "module": "legs", "state": "active" }]));
    ask(&mut viewer, json!({ "ask": "transition", "module": "legs", "transition": "deactivate" })).unwrap();
    let lifecycle = ask(&mut viewer, json!({ "ask": "lifecycle" })).unwrap();
    assert_eq!(lifecycle[0]["state"], "inactive");
}

#[test]
fn a_trace_names_the_messages_that_caused_runs() {
    let robot = page(|_| ());
    let mut viewer = Viewer::of(open(address(&robot), "/ws", PROTOCOL).unwrap());
    let cmd_vel = robot.core.inlet::<downbeat_msgs::geometry_msgs::msg::Twist>("cmd_vel");
    let cmd_vel = cmd_vel.wait(WATCHDOG).unwrap().unwrap();
    let caused = until(|| {
        cmd_vel.publish(Default::default()).unwrap();
        let asked = std::thread::scope(|scope| {
            let publishing = scope.spawn(|| {
                for _ in 0..200 {
                    let _ = cmd_vel.publish(Default::default());
                    std::thread::sleep(std::time::Duration::from_millis(1));
                }
            });
            let trace = ask(&mut viewer, json!({ "ask": "trace", "cycles": 20 })).unwrap();
            publishing.join().unwrap();
            trace
        });
        let run = asked["events"].as_array()?.iter().find(|event| event["module"] == "legs")?.clone();
        (run["causes"][0] == "message on cmd_vel").then_some(run)
    });
    assert_eq!(caused["kind"], "run");
}

#[test]
fn a_step_answers_with_its_cycle() {
    let robot = page(|_| ());
    let mut viewer = Viewer::of(open(address(&robot), &format!("/ws?token={TOKEN}"), PROTOCOL).unwrap());
    ask(&mut viewer, json!({ "ask": "pause" })).unwrap();
    for _ in 0..20 {
        let trace = ask(&mut viewer, json!({ "ask": "step", "trace": true })).unwrap();
        let mut cycles: Vec<_> = trace["events"]
            .as_array()
            .unwrap()
            .iter()
            .map(|event| event["cycle"].as_u64().unwrap())
            .collect();
        cycles.dedup();
        assert_eq!(cycles.len(), 1, "{trace}");
    }
}

#[test]
fn without_the_token_a_page_only_looks() {
    let robot = page(|_| ());
    let mut viewer = Viewer::of(open(address(&robot), "/ws?token=wrong-token", PROTOCOL).unwrap());
    for question in ["pause", "resume", "step", "set", "transition", "erase"] {
        let refused =
            ask(&mut viewer, json!({ "ask": question, "module": "legs", "transition": "shutdown" }));
        assert!(refused.unwrap_err().contains("may only look"), "{question}");
    }
    let info = ask(&mut viewer, json!({ "ask": "robot" })).unwrap();
    assert_eq!(info["mayChange"], false);
    assert_eq!(ask(&mut viewer, json!({ "ask": "snapshot" })).unwrap()["is_paused"], false);
}

#[test]
fn questions_belong_to_the_port_of_the_page() {
    let robot = page(|_| ());
    assert!(open(robot.address(), "/", PROTOCOL).unwrap_err().contains("400"));
    assert!(open(address(&robot), "/ws", "foxglove.sdk.v1").unwrap_err().contains("400"));
}

#[test]
fn a_thousand_connections_for_files_leave_room_for_a_viewer() {
    let robot = page(|_| ());
    let mut held = Vec::new();
    for _ in 0..1000 {
        held.extend(TcpStream::connect(address(&robot)));
    }
    robot.move_to(1.0);
    robot.spectator();
    drop(held);
    until(|| open(address(&robot), "/ws", PROTOCOL).ok());
}

#[test]
fn a_page_without_a_core_has_what_its_host_answers() {
    let options = ViewOptions {
        foxglove: None,
        page: Some(PageOptions { port: Some(0), host: Some(Arc::new(Counter)), ..PageOptions::default() }),
        ..ViewOptions::new("nothing").unwrap()
    };
    let server = ViewServer::start_page(options).unwrap();
    let mut viewer = Viewer::of(open(server.page_address().unwrap(), "/ws", PROTOCOL).unwrap());
    assert_eq!(ask(&mut viewer, json!({ "ask": "double", "number": 4 })), Ok(json!(8)));
    assert!(ask(&mut viewer, json!({ "ask": "snapshot" })).unwrap_err().contains("no robot"));
}
