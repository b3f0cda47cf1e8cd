//! A DDS participant with security, by rustdds, for the tests of this package.
//!
//! usage: `secured-rustdds DOMAIN_ID ENCLAVE (publish TOPIC TEXT|subscribe TOPIC)...`
//!
//! Joins the domain with the files of an enclave of `ros2 security`; as the peers of Cyclone DDS and Fast DDS, it
//! publishes `TEXT 1`, `TEXT 2`, ... ten times a second as `std_msgs/msg/String`, prints `ready` and `heard TOPIC
//! TEXT`, and ends when its standard input ends.

use std::io::Read;
use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use rustdds::policy::{History, Reliability};
use rustdds::{DomainParticipantBuilder, DomainParticipantSecurityConfigFiles, QosPolicyBuilder, TopicKind};
use serde::{Deserialize, Serialize};

/// `std_msgs/msg/String`.
#[derive(Debug, Serialize, Deserialize)]
struct Text {
    data: String,
}

const USAGE: &str = "usage: secured-rustdds DOMAIN_ID ENCLAVE (publish TOPIC TEXT|subscribe TOPIC)...";
const PERIOD: Duration = Duration::from_millis(100);

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    env_logger::init();
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let [domain, enclave, commands @ ..] = &arguments[..] else { return Err(USAGE.into()) };
    static IS_OVER: AtomicBool = AtomicBool::new(false);
    thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        IS_OVER.store(true, Ordering::Relaxed);
    });

    let files = DomainParticipantSecurityConfigFiles::with_ros_default_names(enclave, String::new());
    let participant = DomainParticipantBuilder::new(domain.parse()?)
        .with_only_networks([Ipv4Addr::LOCALHOST])
        .builtin_security(files)
        .build()?;
    let reliable = Reliability::Reliable { max_blocking_time: rustdds::Duration::from_secs(1) };
    let qos = QosPolicyBuilder::new().reliability(reliable).history(History::KeepLast { depth: 10 }).build();
    let topic = |name: &str| {
        let kind = "std_msgs::msg::dds_::String_";
        participant.create_topic(format!("rt{name}"), kind.into(), &qos, TopicKind::NoKey)
    };
    let (mut writers, mut readers) = (Vec::new(), Vec::new());
    let mut commands = commands.iter();
    while let (Some(command), Some(name)) = (commands.next(), commands.next()) {
        match (&**command, topic(name)?) {
            ("publish", topic) => {
                let text = commands.next().ok_or(USAGE)?;
                let publisher = participant.create_publisher(&qos)?;
                writers.push((publisher.create_datawriter_no_key_cdr::<Text>(&topic, None)?, text));
            }
            ("subscribe", topic) => {
                let subscriber = participant.create_subscriber(&qos)?;
                readers.push((subscriber.create_datareader_no_key_cdr::<Text>(&topic, None)?, name));
            }
            _ => return Err(USAGE.into()),
        }
    }
    println!("ready");
    for count in 1_u64.. {
        for (writer, text) in &writers {
            let mut data = format!("{text} {count}");
            while (data.len() + 1) % 4 != 0 {
                data.push(' '); // see the README
            }
            writer.write(Text { data }, None)?;
        }
        for (reader, topic) in &mut readers {
            while let Some(sample) = reader.take_next_sample()? {
                println!("heard {topic} {}", sample.value().data.trim_end());
            }
        }
        if IS_OVER.load(Ordering::Relaxed) {
            break;
        }
        thread::sleep(PERIOD);
    }
    Ok(())
}
