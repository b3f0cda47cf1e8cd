//! A DDS participant with security, by rustdds: `secured-rustdds ENCLAVE DOMAIN [TEXT]`.
//!
//! Joins the domain with the files of an enclave of `ros2 security`. With a text, publishes `TEXT 1`,
//! `TEXT 2`, ... as `std_msgs/msg/String` on `chatter`; without one, prints each message of that topic, one per
//! line. Ends when its standard input ends.

use std::io::{Read, Write};
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

const PERIOD: Duration = Duration::from_millis(100);

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    env_logger::init();
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let (enclave, domain, text) = match &arguments[..] {
        [enclave, domain] => (enclave, domain, None),
        [enclave, domain, text] => (enclave, domain, Some(text)),
        _ => return Err("usage: secured-rustdds ENCLAVE DOMAIN [TEXT]".into()),
    };
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
    let (name, kind) = ("rt/chatter", "std_msgs::msg::dds_::String_");
    let topic = participant.create_topic(name.into(), kind.into(), &qos, TopicKind::NoKey)?;
    match text {
        Some(text) => {
            let writer =
                participant.create_publisher(&qos)?.create_datawriter_no_key_cdr::<Text>(&topic, None)?;
            for count in 1_u64.. {
                if IS_OVER.load(Ordering::Relaxed) {
                    break;
                }
                let mut data = format!("{text} {count}");
                while (data.len() + 1) % 4 != 0 {
                    data.push(' '); // see the README
                }
                writer.write(Text { data }, None)?;
                thread::sleep(PERIOD);
            }
        }
        None => {
            let mut reader =
                participant.create_subscriber(&qos)?.create_datareader_no_key_cdr::<Text>(&topic, None)?;
            while !IS_OVER.load(Ordering::Relaxed) {
                while let Some(sample) = reader.take_next_sample()? {
                    println!("{}", sample.value().data.trim_end());
                    std::io::stdout().flush()?;
                }
                thread::sleep(PERIOD / 10);
            }
        }
    }
    Ok(())
}
