//! The client class of Foxglove's own package, in every capability that it knows. Messages are decoded by
//! Foxglove's packages with the schemas that the server sent.

use crate::support::{TOKEN, robot};
use downbeat_msgs::std_msgs::msg::String as Text;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

#[test]
fn the_client_class_uses_every_capability() {
    let Some(modules) = test_machine::node_modules() else { return };
    let robot = robot(|_| ());
    robot.description.publish(Text { data: "<robot/>".into() }).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node/look.mjs");
    let mut node = Command::new("node")
        .arg(script)
        .arg(format!("ws://{}/?token={TOKEN}", robot.address()))
        .env("DOWNBEAT_NODE_MODULES", modules)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut found = Value::Null;
    for line in BufReader::new(node.stdout.take().unwrap()).lines() {
        match line.unwrap().as_str() {
            // It has subscribed.
            "ready" => robot.move_to(0.5),
            line => found = serde_json::from_str(line).unwrap(),
        }
    }
    assert!(node.wait().unwrap().success());
    assert_eq!(found["info"]["name"], "test robot");
    let capabilities = found["info"]["capabilities"].as_array().unwrap();
    for capability in
        ["clientPublish", "parameters", "parametersSubscribe", "services", "connectionGraph", "assets"]
    {
        assert!(capabilities.contains(&json!(capability)), "{capability}");
    }
    assert_eq!(found["unparsed"], json!([]), "schemas that Foxglove's parser refuses");
    assert_eq!(found["description"], json!({ "data": "<robot/>" }));
    let joint_state = &found["jointState"];
    assert_eq!((&joint_state["name"], &joint_state["position"]), (&json!(["pan"]), &json!({ "0": 0.5 })));
    assert_eq!(found["response"], json!({ "success": true, "message": "up" }));
    assert!(found["failure"].as_str().unwrap().contains("there is no chair"));
    assert_eq!(found["parameters"]["legs.gain"], 1.0);
    assert_eq!(found["set"], json!([{ "name": "legs.gain", "value": 2.5, "type": "float64" }]));
    assert_eq!(found["watched"], 2.5);
    assert_eq!(found["asset"], "solid arm");
    assert!(found["noAsset"].as_str().unwrap().contains("leaves the folder"));
    assert_eq!(found["subscribers"]["/cmd_vel"], json!(["legs"]));
    assert_eq!(found["providers"]["/stand"], json!(["legs"]));
    assert_eq!(robot.heard.try_iter().collect::<Vec<_>>(), [0.25, 0.75], "in CDR and in JSON");
    assert_eq!(found["errors"], json!([]));
}
