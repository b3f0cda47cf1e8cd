//! What viewers may change.

use crate::support::{Viewer, WATCHDOG, robot};
use downbeat_msgs::geometry_msgs::msg::{Twist, Vector3};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use downbeat_msgs::{Message, cdr};
use downbeat_view::Access;
use serde_json::{Value, json};

fn advertise(id: u32, topic: &str, encoding: &str, schema_name: &str) -> Value {
    let channel = json!({ "id": id, "topic": topic, "encoding": encoding, "schemaName": schema_name });
    json!({ "op": "advertise", "channels": [channel] })
}

fn publish(channel_id: u32, data: &[u8]) -> Vec<u8> {
    [&[1][..], &channel_id.to_le_bytes(), data].concat()
}

fn call(viewer: &mut Viewer, call_id: u32, data: &[u8]) {
    let numbers = [1, call_id, 3].map(u32::to_le_bytes).concat();
    viewer.send_binary([&[2][..], &numbers, b"cdr", data].concat());
}

fn twist(x: f64) -> Twist {
    Twist { linear: Vector3 { x, ..Vector3::default() }, ..Twist::default() }
}

fn get(viewer: &mut Viewer, name: &str) -> Value {
    viewer.send(json!({ "op": "getParameters", "parameterNames": [name], "id": "get" }));
    loop {
        let values = viewer.json("parameterValues");
        if values["id"] == "get" {
            return values["parameters"][0]["value"].clone();
        }
    }
}

#[test]
fn a_viewer_publishes_in_cdr_and_in_json() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    assert!(viewer.info["capabilities"].as_array().unwrap().contains(&json!("clientPublish")));
    viewer.send(advertise(1, "/cmd_vel", "cdr", "geometry_msgs/msg/Twist"));
    viewer.send_binary(publish(1, &cdr::to_vec(&twist(0.25))));
    assert_eq!(robot.heard.recv_timeout(WATCHDOG), Ok(0.25));
    viewer.send(advertise(2, "cmd_vel", "json", "geometry_msgs/Twist"));
    viewer.send_binary(publish(
        2,
        br#"{"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}"#,
    ));
    assert_eq!(robot.heard.recv_timeout(WATCHDOG), Ok(0.5));
    viewer.send(json!({ "op": "unadvertise", "channelIds": [1] }));
    viewer.send_binary(publish(1, &cdr::to_vec(&twist(0.75))));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("was not advertised"));
    assert!(robot.heard.try_recv().is_err());
}

#[test]
fn what_is_published_wrongly_is_refused_with_the_reason() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    for (topic, encoding, schema_name, words) in [
        (
            "/cmd_vel",
            "cdr",
            "std_msgs/msg/String",
            "it carries geometry_msgs/msg/Twist, not std_msgs/msg/String",
        ),
        ("/new", "cdr", "std_msgs/msg/Strin", "did you mean \"std_msgs/msg/String\"?"),
        ("/cmd_vel", "protobuf", "geometry_msgs/msg/Twist", "neither \"cdr\" nor \"json\""),
    ] {
        viewer.send(advertise(1, topic, encoding, schema_name));
        let status = viewer.json("status");
        let message = status["message"].as_str().unwrap();
        assert!(
            message.starts_with(&format!("cannot publish on {topic}: ")) && message.contains(words),
            "{message}"
        );
    }
    viewer.send(advertise(1, "/cmd_vel", "cdr", "geometry_msgs/msg/Twist"));
    viewer.send_binary(publish(1, &[0, 1, 0, 0, 9]));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("was not published"));
}

#[test]
fn each_kind_of_refused_message_has_a_status_and_repetitions_have_none() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    viewer.send(advertise(5, "/cmd_vel", "json", "geometry_msgs/msg/Twist"));
    let good = |x: f64| {
        format!(r#"{{"linear": {{"x": {x}, "y": 0, "z": 0}}, "angular": {{"x": 0, "y": 0, "z": 0}}}}"#)
    };
    let mut told = Vec::new();
    for wrong in [
        r#"{"linear": {"x": NaN}}"#,
        r#"{"linar": {"x": 1}}"#,
        r#"{"linear": {"x": "fast"}}"#,
        "[1]",
        "\u{7f}",
    ] {
        for _ in 0..3 {
            viewer.send_binary(publish(5, wrong.as_bytes()));
        }
        told.push(viewer.json("status")["message"].as_str().unwrap().to_owned());
    }
    assert!(told.iter().all(|text| text.starts_with("a message was not published: ")), "{told:?}");
    assert!(
        told[1].contains("missing field `linear`") && told[2].contains("field `linear`: field `x`"),
        "{told:?}"
    );
    assert!(told[1].ends_with("(2 more were refused since the last report)"), "{told:?}");
    // The next status is that of the second advertisement, so repetitions had none; the first advertisement
    // still counts.
    viewer.send(advertise(5, "/other", "json", "std_msgs/msg/Bool"));
    let status = viewer.json("status");
    assert_eq!(
        (&status["level"], &status["message"]),
        (&json!(1), &json!("channel 5 is advertised already: this advertisement is ignored"))
    );
    viewer.send_binary(publish(5, good(0.5).as_bytes()));
    assert_eq!(robot.heard.recv_timeout(WATCHDOG), Ok(0.5));

    // A viewer may use an id again after it has unadvertised it; for an unknown id it receives a warning.
    viewer.send(json!({"op": "unadvertise", "channelIds": [5, 6]}));
    let status = viewer.json("status");
    assert_eq!(
        (&status["level"], &status["message"]),
        (&json!(1), &json!("channel 6 is not advertised: this unadvertisement is ignored"))
    );
    viewer.send_binary(publish(5, good(0.5).as_bytes()));
    assert_eq!(viewer.json("status")["message"], json!("channel 5 was not advertised"));
    viewer.send(advertise(5, "/cmd_vel", "json", "geometry_msgs/msg/Twist"));
    viewer.send_binary(publish(5, good(0.25).as_bytes()));
    assert_eq!(robot.heard.recv_timeout(WATCHDOG), Ok(0.25));
}

#[test]
fn a_viewer_calls_a_service_with_its_schemas() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    let services = viewer.json("advertiseServices");
    let service = &services["services"][0];
    assert_eq!((&service["name"], &service["type"]), (&json!("/stand"), &json!("std_srvs/srv/SetBool")));
    assert_eq!(service["request"]["schemaName"], SetBoolRequest::TYPE_NAME);
    assert_eq!(service["request"]["encoding"], "cdr");
    assert!(service["request"]["schema"].as_str().unwrap().contains("bool data"));
    assert!(service["response"]["schema"].as_str().unwrap().contains("string message"));
    call(&mut viewer, 7, &cdr::to_vec(&SetBoolRequest { data: true }));
    let response = viewer.binary(3);
    assert_eq!(response[..15], *b"\x01\0\0\0\x07\0\0\0\x03\0\0\0cdr");
    let response: SetBoolResponse = cdr::from_slice(&response[15..]).unwrap();
    assert_eq!(response, SetBoolResponse { success: true, message: "up".into() });
    call(&mut viewer, 8, &cdr::to_vec(&SetBoolRequest { data: false }));
    let failure = viewer.json("serviceCallFailure");
    assert_eq!((&failure["serviceId"], &failure["callId"]), (&json!(1), &json!(8)));
    assert!(failure["message"].as_str().unwrap().contains("there is no chair"));
    call(&mut viewer, 9, &[]);
    assert_eq!(viewer.json("serviceCallFailure")["callId"], 9);
}

#[test]
fn a_viewer_reads_and_sets_parameters_and_others_see_it() {
    let robot = robot(|_| ());
    let (mut viewer, mut other) = (robot.viewer(), robot.spectator());
    viewer.send(json!({ "op": "getParameters", "parameterNames": [], "id": "all" }));
    let all = viewer.json("parameterValues");
    assert_eq!(all["id"], "all");
    assert!(all["parameters"].as_array().unwrap().contains(&json!({
        "name": "legs.gain", "value": 1.0, "type": "float64"
    })));
    other.send(json!({ "op": "subscribeParameterUpdates", "parameterNames": ["legs.gain"] }));
    assert_eq!(other.json("parameterValues")["parameters"][0]["value"], 1.0);
    let set = |value: Value| json!({ "op": "setParameters", "id": "set", "parameters": [{ "name": "legs.gain", "value": value }] });
    viewer.send(set(json!(2)));
    let answer = viewer.json("parameterValues");
    assert_eq!((&answer["id"], &answer["parameters"][0]["value"]), (&json!("set"), &json!(2.0)));
    assert_eq!(other.json("parameterValues")["parameters"][0]["value"], 2.0);
    // Refused by the range of the setting, and by its type: the answer shows the value in force.
    for (value, words) in [(json!(11), "0 to 10 is allowed"), (json!("fast"), "expected a number")] {
        viewer.send(set(value));
        assert!(viewer.json("status")["message"].as_str().unwrap().contains(words));
        assert_eq!(viewer.json("parameterValues")["parameters"][0]["value"], 2.0);
    }
}

#[test]
fn a_viewer_without_the_token_changes_nothing() {
    for (access, path, words) in [
        (None, "/", "connect with the token"),
        (None, "/?token=wrong-secret", "connect with the token"),
        (Some(Access::ReadOnly), "/?token=secret-of-the-test", "read-only"),
    ] {
        let robot = robot(|options| options.access = access.unwrap_or(options.access.clone()));
        let mut viewer = Viewer::connect(robot.address(), path).unwrap();
        let capabilities = viewer.info["capabilities"].as_array().unwrap().clone();
        assert!(
            !capabilities.contains(&json!("clientPublish")) && !capabilities.contains(&json!("services"))
        );
        if path.contains("wrong") {
            let status = viewer.json("status");
            assert!(status["message"].as_str().unwrap().contains("is not that of this server"));
        }
        viewer.send(advertise(1, "/cmd_vel", "cdr", "geometry_msgs/msg/Twist"));
        assert!(viewer.json("status")["message"].as_str().unwrap().contains(words));
        viewer.send_binary(publish(1, &cdr::to_vec(&twist(1.0))));
        viewer.json("status");
        call(&mut viewer, 1, &cdr::to_vec(&SetBoolRequest { data: true }));
        assert!(viewer.json("serviceCallFailure")["message"].as_str().unwrap().contains(words));
        let parameters = json!([{ "name": "legs.gain", "value": 5.0 }]);
        viewer.send(json!({ "op": "setParameters", "parameters": parameters }));
        assert!(viewer.json("status")["message"].as_str().unwrap().contains(words));
        assert_eq!(get(&mut viewer, "legs.gain"), 1.0);
        assert!(robot.heard.try_recv().is_err());
    }
}
