//! The program of a participant in another process.

use crate::engine::{Join, on_loopback};
use downbeat_bridge::middleware::Endpoint;
use downbeat_msgs::qos::QosProfile;
use std::io::{Read, Write};

/// The topic of all cases.
pub(crate) fn chatter(qos: QosProfile) -> Endpoint {
    Endpoint::new("rt/chatter", "std_msgs::msg::dds_::String_", qos)
}

/// The `main` of a program that is the other process for an engine: `program DOMAIN reads|writes`.
pub fn main(join: &Join) {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, domain, role] = arguments.as_slice() else {
        return eprintln!("expected a domain and `reads` or `writes`");
    };
    let Ok(domain) = domain.parse() else { return eprintln!("{domain} is no domain") };
    let participant = match join(&on_loopback(domain)) {
        Ok(participant) => participant,
        Err(error) => return eprintln!("{error}"),
    };
    let endpoint = chatter(QosProfile::DEFAULT);
    let reader = (role == "reads").then(|| participant.create_reader(&endpoint, Box::new(|_| ())));
    let writer = (role == "writes").then(|| participant.create_writer(&endpoint));
    println!("ready");
    // Ends when the other process closes it, or ends itself.
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    drop((reader, writer));
    drop(participant);
    let _ = std::io::stdout().flush();
}
