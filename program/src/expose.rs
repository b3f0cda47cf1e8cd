//! `downbeat expose`

use downbeat_robot::inspect::Client;
use downbeat_robot::{EndpointReport, toml_string as text};

use super::choose::choose;
use super::cli::{ExposeAddArguments, ExposeArguments, ExposeCommand, ExposeDirection};

pub(crate) fn expose(arguments: &ExposeArguments) -> anyhow::Result<()> {
    let mut client = Client::connect(&choose(Some(&arguments.robot))?)?;
    match &arguments.change {
        ExposeCommand::List { json: true } => {
            println!("{}", serde_json::to_string_pretty(&client.exposed()?)?)
        }
        ExposeCommand::List { json: false } => print("", &client.exposed()?),
        ExposeCommand::Add(added) => print("added ", &client.expose(entries(added))?),
        ExposeCommand::Remove { topics } => print("removed ", &client.take_back(topics.clone())?),
    }
    Ok(())
}

fn print(what: &str, endpoints: &[EndpointReport]) {
    for report in endpoints {
        println!("{what}{report}   of {}", report.endpoint.node);
    }
}

/// The arguments in the syntax of robot files, so that the same parser handles both.
fn entries(arguments: &ExposeAddArguments) -> String {
    let list = |names: &[String]| names.iter().map(|name| text(name)).collect::<Vec<_>>().join(", ");
    let mut keys = String::new();
    let mut key = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            keys.push_str(&format!(", {name} = {value}"));
        }
    };
    let ExposeAddArguments { ros_topic, type_name, node, except, qos, rate_hz, every, .. } = arguments;
    key("as", ros_topic.as_deref().map(text));
    key("type", type_name.as_deref().map(text));
    key("node", node.as_deref().map(text));
    key("except", (!except.is_empty()).then(|| format!("[{}]", list(except))));
    key(
        "qos",
        qos.as_deref().map(|qos| if qos.trim_start().starts_with('{') { qos.into() } else { text(qos) }),
    );
    key("rate_hz", rate_hz.map(|rate| format!("{rate:?}")));
    key("every", every.map(|every| every.to_string()));
    key("latest_only", arguments.latest_only.then(|| "true".into()));
    key("priority", arguments.priority.as_deref().map(text));
    key("express", arguments.express.then(|| "true".into()));
    let topics: Vec<_> =
        arguments.topics.iter().map(|topic| format!("{{ topic = {}{keys} }}", text(topic))).collect();
    let direction = match arguments.direction {
        ExposeDirection::Out => "out",
        ExposeDirection::In => "in",
    };
    format!("{direction} = [{}]", topics.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_become_an_entry_of_a_robot_file() {
        let arguments = ExposeAddArguments {
            direction: ExposeDirection::Out,
            topics: vec!["camera/*".into(), "a\"b".into()],
            ros_topic: Some("/cam/*".into()),
            type_name: None,
            except: vec!["camera/raw".into()],
            qos: Some("sensor_data".into()),
            rate_hz: Some(10.0),
            every: None,
            latest_only: true,
            priority: Some("data_high".into()),
            express: true,
            node: None,
        };
        let keys = "as = \"/cam/*\", except = [\"camera/raw\"], qos = \"sensor_data\", rate_hz = 10.0, latest_only = true, \
            priority = \"data_high\", express = true";
        let expected =
            format!("out = [{{ topic = \"camera/*\", {keys} }}, {{ topic = \"a\\\"b\", {keys} }}]");
        assert_eq!(entries(&arguments), expected);
    }
}
