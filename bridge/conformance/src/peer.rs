//! A participant in a process of its own, which can be killed.

use crate::engine::{Join, on_loopback};
use downbeat_bridge::middleware::Endpoint;
use downbeat_msgs::qos::QosProfile;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// What the process does until its standard input ends; then it leaves in order.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Role {
    /// Reads reliably.
    Reads,
    /// Writes nothing, but could.
    Writes,
}

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

/// The process, as the one that started it sees it. It ends with the value.
pub(crate) struct PeerProcess {
    child: Child,
}

impl PeerProcess {
    pub(crate) fn start(program: &Path, domain_id: u16, role: Role) -> Self {
        let role = match role {
            Role::Reads => "reads",
            Role::Writes => "writes",
        };
        let mut command = Command::new(program);
        command.args([&domain_id.to_string(), role]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child =
            command.spawn().unwrap_or_else(|error| panic!("cannot start {}: {error}", program.display()));
        let mut line = String::new();
        if let Some(output) = child.stdout.take() {
            // Ends at the latest when the process does.
            let _ = BufReader::new(output).read_line(&mut line);
        }
        assert_eq!(line.trim(), "ready", "the other process is no peer");
        Self { child }
    }

    /// Ends it as a power cut would.
    pub(crate) fn kill(&mut self) {
        // It may have ended already; nothing to do then.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Has it leave in order, and waits until it has ended.
    pub(crate) fn leave(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        self.kill();
    }
}
