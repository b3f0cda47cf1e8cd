//! A participant in another process, which can be killed.

use std::io::{BufRead, BufReader};
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

/// The process, as the one that started it sees it. It ends with the value.
pub(crate) struct PeerProcess {
    child: Child,
}

impl PeerProcess {
    pub(crate) fn start(
        program: &Path,
        environment: &[(&'static str, String)],
        domain_id: u16,
        role: Role,
    ) -> Self {
        let role = match role {
            Role::Reads => "reads",
            Role::Writes => "writes",
        };
        let mut command = Command::new(program);
        command.args([&domain_id.to_string(), role]).stdin(Stdio::piped()).stdout(Stdio::piped());
        command.envs(environment.iter().map(|(name, value)| (name, value)));
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
