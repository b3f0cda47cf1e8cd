//! Kinds describe themselves, and robots are composed.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::process::Stdio;

use common::browser::script;
use common::{Running, downbeat, output_of, text_of};
use serde_json::{Value, json};

fn described(arguments: &[&str]) -> Value {
    let line = [&["describe", "--json"], arguments].concat();
    let output = output_of(&line);
    assert!(output.status.success(), "{line:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn refused(arguments: &[&str]) -> String {
    let output = output_of(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn kinds_describe_themselves() {
    let all = described(&[]);
    assert_eq!(all["schema"], 1);
    assert!(all["kinds"].as_array().unwrap().len() > 10);
    let one = described(&["joint_command_mux", "-p", "sources:=[walk, kick]"]);
    let mux = &one["kinds"][0];
    let received: Vec<_> = mux["ports"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|port| port["does"] == "subscribes")
        .map(|port| (port["name"].as_str().unwrap(), port["type"].as_str().unwrap()))
        .collect();
    assert_eq!(received, [("walk", "sensor_msgs/msg/JointState"), ("kick", "sensor_msgs/msg/JointState")]);
    let hold =
        mux["settings"].as_array().unwrap().iter().find(|setting| setting["name"] == "hold_s").unwrap();
    assert_eq!(
        (&hold["type"], &hold["default"], &hold["range"]),
        (&json!("double"), &json!(2.0), &json!([0.0, 3600.0]))
    );

    let text = text_of(&["describe", "forward_command"]);
    for words in ["joints (required)", "its ports are not known", "names no joint"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let text = text_of(&["describe", "forward_command", "-p", "joints:=[left, right]"]);
    for words in ["position | velocity | effort", "publishes     joint_commands", "forward_command/commands"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(refused(&["describe", "gaits"]).contains("did you mean \"gait\"?"));
    assert!(refused(&["describe", "-p", "a:=1"]).contains("name the kind"));
    assert!(refused(&["describe", "gait", "-p", "period=1"]).contains("NAME:=VALUE"));
}

#[test]
fn the_modules_of_a_robot_are_described_with_their_settings() {
    let robot = described(&["--robot", "robots/so101.toml", "hardware"]);
    let [hardware] = robot["modules"].as_array().unwrap().as_slice() else { panic!("{robot}") };
    assert_eq!((&hardware["name"], &hardware["profile"]["kind"]), (&json!("hardware"), &json!("servo_bus")));
    assert!(hardware["profile"].get("needs").is_none(), "{hardware}");
    assert!(refused(&["describe", "--robot", "robots/so101.toml", "gait"]).contains("no module \"gait\""));
}

#[test]
fn an_editor_asks_by_lines() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    let mut editor = downbeat(&["compose", path.to_str().unwrap(), "--stdio"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut questions = editor.stdin.take().unwrap();
    let mut answers = BufReader::new(editor.stdout.take().unwrap()).lines();
    let mut ask = |question: &str| -> Value {
        writeln!(questions, "{question}").unwrap();
        serde_json::from_str(&answers.next().unwrap().unwrap()).unwrap()
    };
    let answer = ask(r#"{"id": 1, "ask": "edit", "edits": [{"op": "add_module", "kind": "imu_filter"}]}"#);
    assert_eq!((&answer["id"], &answer["ok"]["revision"]), (&json!(1), &json!(1)));
    assert!(ask("what?")["error"].as_str().unwrap().contains("no JSON"));
    assert!(ask(r#"{"id": 2, "ask": "dance"}"#)["error"].as_str().unwrap().contains("\"dance\""));
    assert_eq!(ask(r#"{"id": 3, "ask": "save"}"#)["ok"]["is_dirty"], false);
    drop(questions);
    assert!(editor.wait().unwrap().success());
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("[[module]]\nname = \"imu_filter\"\nkind = \"imu_filter\""), "{text}");
}

/// A user composes a robot from scratch in a browser, and checks, saves, runs, records and inspects it. Needs
/// node modules and a browser, named by the variables `DOWNBEAT_NODE_MODULES` and `DOWNBEAT_CHROMIUM`.
#[test]
fn a_robot_is_composed_in_a_browser() {
    let Some(mut script) = script("compose.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let status = script.arg(folder.path()).current_dir(env!("CARGO_MANIFEST_DIR")).status().unwrap();
    assert!(status.success());
}

/// A foreign page that knows the token can neither edit nor run the robot, because browsers report the origin
/// of a page.
#[test]
fn a_hostile_page_with_the_token_reaches_no_editor() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    let mut editor = Running::start(&["compose", path.to_str().unwrap(), "--port", "0"]);
    editor.wait_for_output("#token=");
    let output = editor.output();
    let (_, url) = output.split_once("open in a browser: http://").unwrap();
    let (address, token) = url.trim().split_once("/#token=").unwrap();
    let port = address.rsplit_once(':').unwrap().1;
    let ask = |method: &str, host: &str, origin: &str| -> String {
        let mut stream = TcpStream::connect(address).unwrap();
        let request = format!(
            "{method} /?token={token} HTTP/1.1\r\nHost: {host}\r\n{origin}Connection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: downbeat.view.v1\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut status = String::new();
        BufReader::new(stream).read_line(&mut status).unwrap();
        status.split_whitespace().nth(1).unwrap_or_default().to_owned()
    };
    for (host, origin, expected) in [
        (address.to_owned(), format!("Origin: http://{address}\r\n"), "101"),
        (address.to_owned(), "Origin: https://evil.example\r\n".to_owned(), "403"),
        (address.to_owned(), "Origin: http://evil.example\r\n".to_owned(), "403"),
        (address.to_owned(), "Origin: null\r\n".to_owned(), "403"),
        // Another server on this machine.
        (address.to_owned(), "Origin: http://127.0.0.1:1\r\n".to_owned(), "403"),
        (address.to_owned(), format!("Origin: http://localhost:{port}\r\n"), "403"),
        // A name that an attacker resolves to this machine.
        (format!("evil.example:{port}"), format!("Origin: http://evil.example:{port}\r\n"), "421"),
    ] {
        assert_eq!(ask("GET", &host, &origin), expected, "{host}, {origin}");
    }
    // A form needs no script and can be sent to any server.
    assert_eq!(ask("POST", address, "Origin: https://evil.example\r\n"), "405");
    assert!(!path.exists());
    editor.interrupt();
}
