//! `downbeat bag info`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::output::Progress;
use downbeat_bags::{BagInfo, Reader, TopicSizes};

#[derive(Args)]
pub(crate) struct InfoArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// Print only the names of the topics.
    #[arg(long, short, conflicts_with_all = ["verbose", "json"])]
    pub(crate) topic_name: bool,
    /// Also print the size of each topic, and the numbers of requests and responses of services. Reads the
    /// whole bag.
    #[arg(long, short)]
    pub(crate) verbose: bool,
    /// The order of topics and services, if not that of the bag.
    #[arg(long, value_enum)]
    pub(crate) sort: Option<Order>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// What topics and services are sorted by; those that are equal keep the order of the bag.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Order {
    Name,
    Type,
    /// The fewest messages first.
    Count,
}

impl Order {
    fn sort(self, BagInfo { topics, services, .. }: &mut BagInfo) {
        match self {
            Self::Name => {
                topics.sort_by(|a, b| a.info.name.cmp(&b.info.name));
                services.sort_by(|a, b| a.name.cmp(&b.name));
            }
            Self::Type => {
                topics.sort_by(|a, b| a.info.type_name.cmp(&b.info.type_name));
                services.sort_by(|a, b| a.type_name.cmp(&b.type_name));
            }
            Self::Count => {
                topics.sort_by_key(|topic| topic.message_count);
                services.sort_by_key(|service| service.event_count);
            }
        }
    }
}

/// Prints the contents of a bag, and losses on standard error.
pub(crate) fn info(arguments: &InfoArguments) -> anyhow::Result<()> {
    let reader = Reader::open(&arguments.bag)?;
    super::warn_of_oddities(&reader);
    let mut info = BagInfo::of(&reader)?;
    if let Some(order) = arguments.sort {
        order.sort(&mut info);
    }
    if arguments.verbose {
        let mut progress = Progress::new("reading", reader.message_count());
        info.sizes = Some(TopicSizes::read(&reader, |read| progress.at(read))?);
    }
    if arguments.topic_name {
        info.topics.iter().for_each(|topic| println!("{}", topic.info.name));
    } else if arguments.json {
        println!("{}", serde_json::to_string_pretty(&as_json(&info, &reader))?);
    } else {
        print!("{info}");
    }
    for truncation in reader.truncation() {
        eprintln!("downbeat: {truncation}");
    }
    Ok(())
}

fn as_json(info: &BagInfo, reader: &Reader) -> Value {
    let bytes = |topic: &str| info.sizes.as_ref().map(|sizes| sizes.bytes_of(topic));
    let topics = info.topics.iter().map(|topic| {
        let qos = topic.info.offered_qos.iter().map(|qos| format!("{qos:?}"));
        json!({
            "name": topic.info.name,
            "type": topic.info.type_name,
            "message_count": topic.message_count,
            "serialization_format": topic.serialization_format,
            "type_description_hash": topic.info.type_hash,
            "offered_qos_profiles": qos.collect::<Vec<_>>(),
            "has_definition": !topic.info.definition.is_empty() || topic.info.format.is_some(),
            "bytes": bytes(&topic.info.name),
        })
    });
    let services = info.services.iter().map(|service| {
        let sizes = info.sizes.as_ref().map(|sizes| sizes.calls_of(&service.name));
        json!({
            "name": service.name,
            "type": service.type_name,
            "event_count": service.event_count,
            "serialization_format": service.serialization_format,
            "request_count": sizes.map(|calls| calls.requests),
            "response_count": sizes.map(|calls| calls.responses),
            "bytes": bytes(&service.event_topic()),
        })
    });
    json!({
        "files": info.files,
        "size": info.size,
        "storage_identifier": info.storage_identifier,
        "ros_distro": info.ros_distro,
        "metadata_version": reader.metadata().map(|metadata| metadata.version),
        "duration_ns": u64::try_from(info.duration.as_nanos()).unwrap_or(u64::MAX),
        "starting_time_ns": reader.start_time(),
        "end_time_ns": reader.end_time(),
        "message_count": info.message_count,
        "topics": topics.collect::<Vec<_>>(),
        "services": services.collect::<Vec<_>>(),
        "custom_data": reader.metadata().map(|metadata| &metadata.custom_data),
        "missing": info.truncation.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}
