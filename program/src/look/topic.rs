//! `downbeat topic`

use std::fmt::Write;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use downbeat_bridge::ros::{EndpointKind, Found, FoundEndpoint};
use downbeat_msgs::qos::Word;

use super::echo::{self, EchoArguments};
use super::network::{
    Environment, Look, LookArguments, NamesAndTypes, OF_TOPICS, Patience, count, is_hidden, joined,
    names_and_types, print_list, print_types, type_or_types,
};
use super::publish::{self, PublishArguments};
use super::rate::{self, HzArguments, RateArguments};

#[derive(Subcommand)]
pub(crate) enum TopicCommand {
    /// List topics.
    List(ListArguments),
    /// Print the type of a topic, its publishers and its subscribers.
    Info(InfoArguments),
    /// Print messages of a topic in YAML or CSV.
    Echo(Box<EchoArguments>),
    /// Print the rate of a topic's messages.
    Hz(HzArguments),
    /// Print the bandwidth of a topic in bytes per second.
    Bw(RateArguments),
    /// Print the age of a topic's messages on arrival, by their header.
    Delay(RateArguments),
    /// Publish messages on a topic.
    Pub(Box<PublishArguments>),
    /// Print the type of a topic.
    Type(NameArguments),
    /// List the topics of a type.
    Find(FindArguments),
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Also print the types.
    #[arg(short = 't', long)]
    show_types: bool,
    /// Print the numbers of publishers and subscribers of each topic.
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    names: NamesArguments,
}

/// Which topics are listed, and how.
#[derive(Args)]
struct NamesArguments {
    /// Print only the number.
    #[arg(short, long)]
    count_topics: bool,
    /// Also print topics whose name has a part that starts with an underscore.
    #[arg(short = 'a', long)]
    include_hidden_topics: bool,
    #[command(flatten)]
    look: LookArguments,
}

impl NamesArguments {
    fn topics(&self, found: &Found) -> NamesAndTypes {
        let mut topics = names_and_types(found, OF_TOPICS, None);
        topics.retain(|name, _| self.include_hidden_topics || !is_hidden(name));
        topics
    }
}

#[derive(Args)]
pub(crate) struct InfoArguments {
    /// The topic.
    topic: String,
    /// Print node, type hash, identity and quality of service of each endpoint.
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct NameArguments {
    /// The topic.
    topic: String,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct FindArguments {
    /// The type, for example sensor_msgs/msg/JointState.
    #[arg(value_name = "TYPE")]
    type_name: String,
    #[command(flatten)]
    names: NamesArguments,
}

pub(crate) fn topic(command: &TopicCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        TopicCommand::List(arguments) => list(arguments, environment),
        TopicCommand::Info(arguments) => info(arguments, environment),
        TopicCommand::Echo(arguments) => echo::echo(arguments, environment),
        TopicCommand::Hz(arguments) => rate::hz(arguments, environment),
        TopicCommand::Bw(arguments) => rate::bandwidth(arguments, environment),
        TopicCommand::Delay(arguments) => rate::delay(arguments, environment),
        TopicCommand::Pub(arguments) => publish::publish(arguments, environment),
        TopicCommand::Type(arguments) => type_of(arguments, environment),
        TopicCommand::Find(arguments) => find(arguments, environment),
    }
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let ListArguments { show_types, verbose, names } = arguments;
    let look = Look::join("topic", &names.look, environment)?;
    let found = look.all(Patience::Endpoints);
    let topics = names.topics(&found);
    if !verbose || names.count_topics {
        print_list(&topics, *show_types, names.count_topics);
    } else if !topics.is_empty() {
        println!("{}", counted("Published topics:", &topics, &found, EndpointKind::Publisher, "publisher"));
        println!(
            "{}",
            counted("Subscribed topics:", &topics, &found, EndpointKind::Subscription, "subscriber")
        );
    }
    Ok(())
}

fn counted(title: &str, topics: &NamesAndTypes, found: &Found, kind: EndpointKind, word: &str) -> String {
    let mut text = format!("{title}\n");
    for (name, types) in topics {
        let count = count(found, name, kind);
        if count > 0 {
            let plural = if count > 1 { "s" } else { "" };
            // Writing to a String cannot fail.
            let _ = writeln!(text, " * {name} [{}] {count} {word}{plural}", joined(types));
        }
    }
    text
}

fn info(arguments: &InfoArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("topic", &arguments.look, environment)?;
    let name = look.node.topic_name(&arguments.topic)?;
    let patience = if arguments.verbose { Patience::Nodes } else { Patience::Endpoints };
    let found =
        look.all_with(patience, |found| names_and_types(found, OF_TOPICS, None).contains_key(name.as_str()));
    let topics = names_and_types(&found, OF_TOPICS, None);
    let Some(types) = topics.get(name.as_str()) else { bail!("Unknown topic '{name}'") };
    let end = if arguments.verbose { "\n\n" } else { "\n" };
    print!("Type: {}{end}", type_or_types(types));
    for (title, kind) in
        [("Publisher", EndpointKind::Publisher), ("Subscription", EndpointKind::Subscription)]
    {
        print!("{title} count: {}{end}", count(&found, name.as_str(), kind));
        if arguments.verbose {
            let endpoints = found.endpoints.iter();
            for endpoint in
                endpoints.filter(|endpoint| endpoint.kind == kind && endpoint.name == name.as_str())
            {
                print!("{}{end}", details(endpoint));
            }
        }
    }
    Ok(())
}

/// Formats like a `TopicEndpointInfo` of rclpy. The depth is not transmitted on the network.
fn details(endpoint: &FoundEndpoint) -> String {
    let remote = &endpoint.remote;
    let (namespace, node) = match endpoint.node.as_deref().and_then(|node| node.rsplit_once('/')) {
        Some(("", node)) => ("/", node),
        Some(parts) => parts,
        None => ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_"),
    };
    let gid = remote.gid.0.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(".");
    let [reliability, durability, liveliness] =
        [remote.reliability.name(), remote.durability.name(), remote.liveliness.name()]
            .map(str::to_uppercase);
    let time = |time: Option<Duration>| match time {
        Some(time) => format!("{} nanoseconds", time.as_nanos()),
        None => "Infinite".to_owned(),
    };
    [
        format!("Node name: {node}"),
        format!("Node namespace: {namespace}"),
        format!("Topic type: {}", endpoint.type_name),
        format!("Topic type hash: {}", remote.type_hash.as_deref().unwrap_or("INVALID")),
        format!(
            "Endpoint type: {}",
            if endpoint.kind == EndpointKind::Publisher { "PUBLISHER" } else { "SUBSCRIPTION" }
        ),
        format!("GID: {gid}"),
        "QoS profile:".to_owned(),
        format!("  Reliability: {reliability}"),
        "  History (Depth): UNKNOWN".to_owned(),
        format!("  Durability: {durability}"),
        format!("  Lifespan: {}", time(remote.lifespan)),
        format!("  Deadline: {}", time(remote.deadline)),
        format!("  Liveliness: {liveliness}"),
        format!("  Liveliness lease duration: {}", time(remote.liveliness_lease_duration)),
    ]
    .join("\n")
}

fn type_of(arguments: &NameArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("topic", &arguments.look, environment)?;
    let name = look.node.topic_name(&arguments.topic)?;
    let types = |found: &Found| names_and_types(found, OF_TOPICS, None).remove(name.as_str());
    print_types(&look, types).with_context(|| format!("Unknown topic '{name}'"))
}

fn find(arguments: &FindArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let FindArguments { type_name, names } = arguments;
    let look = Look::join("topic", &names.look, environment)?;
    let mut topics = names.topics(&look.all(Patience::Endpoints));
    topics.retain(|_, types| types.contains(type_name));
    print_list(&topics, false, names.count_topics);
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_bridge::middleware::in_process::Hub;
    use downbeat_bridge::ros::{MessageType, NodeName, Participant};
    use downbeat_msgs::qos::QosProfile;
    use std::sync::Arc;

    #[test]
    fn an_endpoint_is_formatted_as_in_rclpy() {
        let hub = Hub::new();
        let join = || Participant::on(Arc::new(hub.join())).unwrap();
        let (robot, observer) = (join(), join());
        let node = robot.create_node(NodeName::new("/reference", "talker").unwrap()).unwrap();
        let qos = QosProfile { deadline: Some(Duration::from_millis(5)), ..QosProfile::ROSOUT };
        let string = MessageType::new("std_msgs/msg/String").unwrap();
        let _publisher = node.publish("chatter", &string, qos).unwrap();
        let found = observer.found();
        let chatter = found.endpoints.iter().find(|endpoint| endpoint.name == "/reference/chatter").unwrap();
        let shown = details(chatter);
        let lines: Vec<_> = shown.lines().filter(|line| !line.starts_with("GID: ")).collect();
        assert_eq!(
            lines,
            [
                "Node name: talker",
                "Node namespace: /reference",
                "Topic type: std_msgs/msg/String",
                "Topic type hash: RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
                "Endpoint type: PUBLISHER",
                "QoS profile:",
                "  Reliability: RELIABLE",
                "  History (Depth): UNKNOWN",
                "  Durability: TRANSIENT_LOCAL",
                "  Lifespan: 10000000000 nanoseconds",
                "  Deadline: 5000000 nanoseconds",
                "  Liveliness: AUTOMATIC",
                "  Liveliness lease duration: Infinite",
            ]
        );
        let unknown = FoundEndpoint { node: None, ..chatter.clone() };
        assert!(
            details(&unknown)
                .starts_with("Node name: _NODE_NAME_UNKNOWN_\nNode namespace: _NODE_NAMESPACE_UNKNOWN_\n")
        );
    }
}
