//! `downbeat topic echo`

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;
use downbeat_bridge::middleware::{Direction, EndpointEvent, Sample};
use downbeat_bridge::ros::{EndpointKind, Found, MessageType, QosRequest, Subscription};
use downbeat_msgs::definitions::FieldType;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, MessageRef, ValueRef, YamlStyle, python};
use downbeat_msgs::qos::{Durability, Reliability};

use super::clock::LookClock;
use super::definitions::{Types, full_name};
use super::network::{Environment, Look, LookArguments};
use super::qos::{Preset, QosArguments};
use super::topic_type::{Absent, type_on_network};
use super::values::seconds;

#[derive(Args)]
pub(crate) struct EchoArguments {
    /// The topic.
    topic: String,
    /// The type of its messages; default is that of the topic on the network.
    #[arg(value_name = "TYPE")]
    type_name: Option<String>,
    /// Print each message as a line of comma-separated values.
    #[arg(long)]
    csv: bool,
    /// Print only this field: pose.pose.position
    #[arg(long, value_name = "FIELD")]
    field: Option<String>,
    #[command(flatten)]
    style: StyleArguments,
    /// Do not print that messages were lost.
    #[arg(long)]
    no_lost_messages: bool,
    /// Print the bytes of the message.
    #[arg(long)]
    raw: bool,
    /// Print the first message and exit.
    #[arg(long)]
    once: bool,
    /// Exit after this time: seconds, or with a unit.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    timeout: Option<Duration>,
    /// Print when a message was sent and received, and its number.
    #[arg(short = 'i', long)]
    include_message_info: bool,
    /// Search definitions here first: an ament prefix, a folder of packages, or a package.
    #[arg(long, value_name = "PATH")]
    from: Vec<PathBuf>,
    #[command(flatten)]
    qos: QosArguments,
    #[command(flatten)]
    look: LookArguments,
}

/// How messages are printed.
#[derive(Args)]
struct StyleArguments {
    /// Print arrays, bytes and strings completely.
    #[arg(short, long)]
    full_length: bool,
    /// Truncate arrays, bytes and strings to this length.
    #[arg(short = 'l', long, value_name = "N", default_value_t = 128)]
    truncate_length: usize,
    /// Print type and length of arrays only.
    #[arg(long)]
    no_arr: bool,
    /// Print the length of strings only.
    #[arg(long)]
    no_str: bool,
    /// Print arrays on one line.
    #[arg(long)]
    flow_style: bool,
}

impl StyleArguments {
    fn style(&self) -> YamlStyle {
        YamlStyle {
            truncate_length: (!self.full_length).then_some(self.truncate_length),
            no_arr: self.no_arr,
            no_str: self.no_str,
            flow_style: self.flow_style,
        }
    }
}

/// The maximum number of queued messages; further ones are dropped and counted as lost.
const MOST_WAITING: usize = 1024;

/// How soon Ctrl-C is noticed.
const POLL: Duration = Duration::from_millis(50);

/// An item to print.
enum Heard {
    Message { sample: Sample, received: i64 },
    Lost { change: u64 },
}

pub(super) fn echo(arguments: &EchoArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let path: Vec<&str> =
        arguments.field.iter().flat_map(|path| path.split('.')).filter(|name| !name.is_empty()).collect();
    if let Some(field) = arguments.field.as_deref().filter(|_| path.is_empty()) {
        bail!("Invalid field value '{field}'");
    }
    let look = Look::join("topic", &arguments.look, environment)?;
    let type_name = match &arguments.type_name {
        Some(name) => full_name(name, "msg"),
        None => match type_on_network(&look, &arguments.topic, Absent::Refuse)? {
            Some(name) => name,
            None => return Ok(()),
        },
    };
    let of = match arguments.raw {
        true => None,
        false => Some(Types::load(&look, &arguments.from)?.message(&look, &arguments.topic, &type_name)?),
    };
    if let Some(of) = &of {
        check_field(of, &path)?;
    }
    let (heard, _subscription) = subscribe(&look, arguments, &MessageType::new(&type_name)?)?;
    let end = arguments.timeout.map(|timeout| Instant::now() + timeout);
    let printer = Printer { arguments, of, path, style: arguments.style.style() };
    let (mut lost, mut failed) = (0, 0_u64);
    while !look.stop.is_due() && end.is_none_or(|end| Instant::now() < end) {
        let rest = end.map_or(POLL, |end| end.saturating_duration_since(Instant::now()).min(POLL));
        match heard.recv_timeout(rest) {
            Ok(Heard::Message { sample, received }) => match printer.print(&sample, received) {
                Ok(()) if arguments.once => break,
                Ok(()) => {}
                Err(error) => {
                    failed += 1;
                    if failed == 1 {
                        eprintln!("WARNING: a message on {} is not a {type_name}: {error}", arguments.topic);
                    }
                }
            },
            Ok(Heard::Lost { change }) => {
                lost += change;
                print!("A message was lost!!!\n\ttotal count change:{change}\n\ttotal count: {lost}---\n");
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    if failed > 1 {
        eprintln!("WARNING: {failed} messages on {} were not of type {type_name}", arguments.topic);
    }
    Ok(())
}

/// # Errors
/// Returns an error if the type has no such field.
fn check_field(of: &DynamicType, path: &[&str]) -> anyhow::Result<()> {
    let mut of = Some(of.clone());
    for name in path {
        let fields = of.as_ref().and_then(|of| of.fields().find(|field| field.name == *name));
        let Some(field) = fields else { bail!("Invalid field '{}': there is no '{name}'", path.join(".")) };
        let is_one = field.field_type.shape == downbeat_msgs::definitions::Shape::Single;
        let next = field.message.filter(|_| is_one);
        of = next;
    }
    Ok(())
}

fn subscribe(
    look: &Look,
    arguments: &EchoArguments,
    message_type: &MessageType,
) -> anyhow::Result<(Receiver<Heard>, Subscription)> {
    let topic = look.node.topic_name(&arguments.topic)?;
    let mut request = arguments.qos.request(Preset::SensorData);
    if !arguments.qos.has_policies() {
        let publishes = |found: &Found| publishers(found, topic.as_str()).next().is_some();
        suit(&mut request, &look.found_with(publishes), topic.as_str());
    }
    let qos = look.node.resolve_qos(&arguments.topic, Direction::In, &request)?;
    let (sender, heard) = sync_channel(MOST_WAITING);
    let (clock, dropped) = (LookClock::System, sender.clone());
    let on_sample = move |sample| {
        let message = Heard::Message { sample, received: clock.now() };
        // Drops messages if the output is not read.
        let _ = sender.try_send(message);
    };
    let subscription = look.node.subscribe(&arguments.topic, message_type, qos, Box::new(on_sample))?;
    if !arguments.no_lost_messages {
        subscription.on_event(lost_to(dropped));
    }
    Ok((heard, subscription))
}

fn lost_to(heard: SyncSender<Heard>) -> downbeat_bridge::middleware::EventHandler {
    Box::new(move |event| {
        if let EndpointEvent::MessagesLost { count, .. } = event {
            let _ = heard.try_send(Heard::Lost { change: *count });
        }
    })
}

fn publishers<'a>(
    found: &'a Found,
    topic: &'a str,
) -> impl Iterator<Item = &'a downbeat_bridge::middleware::RemoteEndpoint> {
    let endpoints = found.endpoints.iter();
    endpoints
        .filter(move |endpoint| endpoint.kind == EndpointKind::Publisher && endpoint.name == topic)
        .map(|endpoint| &endpoint.remote)
}

/// Requests what all publishers offer, if there are any.
fn suit(request: &mut QosRequest, found: &Found, topic: &str) {
    use downbeat_bridge::ros::Policy::Given;
    let count = publishers(found, topic).count();
    if count == 0 {
        return;
    }
    let reliable = publishers(found, topic).filter(|peer| peer.reliability == Reliability::Reliable).count();
    let latched =
        publishers(found, topic).filter(|peer| peer.durability == Durability::TransientLocal).count();
    let warn = |offered: &str, instead: &str| {
        eprintln!(
            "Some, but not all, publishers are offering {offered}. Falling back to {instead} as it will connect to all \
             publishers"
        );
    };
    request.reliability =
        Given(if reliable == count { Reliability::Reliable } else { Reliability::BestEffort });
    if (1..count).contains(&reliable) {
        warn("QoSReliabilityPolicy.RELIABLE", "QoSReliabilityPolicy.BEST_EFFORT");
    }
    request.durability =
        Given(if latched == count { Durability::TransientLocal } else { Durability::Volatile });
    if (1..count).contains(&latched) {
        warn("QoSDurabilityPolicy.TRANSIENT_LOCAL", "QoSDurabilityPolicy.VOLATILE");
    }
}

struct Printer<'a> {
    arguments: &'a EchoArguments,
    /// `None` if bytes are printed.
    of: Option<DynamicType>,
    path: Vec<&'a str>,
    style: YamlStyle,
}

impl Printer<'_> {
    fn print(&self, sample: &Sample, received: i64) -> Result<(), downbeat_msgs::cdr::Error> {
        let sent = sample.source_time_ns.unwrap_or(0);
        let number = sample.sequence_number;
        let with_info = self.arguments.include_message_info;
        let info = || {
            format!(
                "{{'source_timestamp': {sent}, 'received_timestamp': {received}, 'publication_sequence_number': {number}, \
                 'reception_sequence_number': None}}"
            )
        };
        let print_value = |value: &str| {
            if with_info {
                println!("---Got new message, message info:---\n{}\n---Message data:---", info());
            }
            print!("{value}\n---\n");
        };
        let Some(of) = &self.of else {
            let mut bytes = String::new();
            python::write_bytes(&mut bytes, &sample.cdr);
            print_value(&bytes);
            return Ok(());
        };
        let message = DynamicMessage::from_cdr(of, &sample.cdr)?;
        let message = match chosen(message.as_message(), &self.path) {
            Chosen::Message(message) => message,
            Chosen::Field(field_type, value) => {
                print_value(&value.to_python_str(field_type));
                return Ok(());
            }
        };
        if self.arguments.csv {
            let info = if with_info { format!("{sent},{received},{number},None,") } else { String::new() };
            println!("{info}{}", message.to_csv(&self.style));
            return Ok(());
        }
        if with_info {
            print!(
                "publication_sequence_number: {number}\nreceived_timestamp: {received}\nreception_sequence_number: null\n\
                 source_timestamp: {sent}\n---\n"
            );
        }
        print!("{}---\n", message.to_yaml(&self.style));
        Ok(())
    }
}

/// The target of a path of fields.
enum Chosen<'a> {
    Message(MessageRef<'a>),
    Field(&'a FieldType, ValueRef<'a>),
}

/// Follows a path, which was checked before.
fn chosen<'a>(mut message: MessageRef<'a>, path: &[&str]) -> Chosen<'a> {
    for name in path {
        let Some((_, field_type, value)) = message.fields_with_types().find(|(field, ..)| field == name)
        else {
            break;
        };
        match value {
            ValueRef::Message(inner) => message = inner,
            value => return Chosen::Field(field_type, value),
        }
    }
    Chosen::Message(message)
}
