//! The type that a topic has on the network.

use anyhow::bail;
use downbeat_bridge::ros::Found;

use super::network::{Look, OF_TOPICS, joined, names_and_types};

/// What to do if a topic does not exist yet.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Absent {
    /// Wait until the command is stopped.
    Wait,
    /// Fail after the time of discovery.
    Refuse,
}

/// The type of a topic; `None` if the command is stopped before it exists.
///
/// # Errors
/// Returns an error if the topic does not exist, or has several types.
pub(super) fn type_on_network(look: &Look, topic: &str, absent: Absent) -> anyhow::Result<Option<String>> {
    let name = look.node.topic_name(topic)?;
    let types = |found: &Found| names_and_types(found, OF_TOPICS, None).remove(name.as_str());
    let mut is_told = false;
    loop {
        match types(&look.found_with(|found| types(found).is_some())) {
            Some(types) if types.len() > 1 => {
                bail!("Cannot echo topic '{topic}', as it contains more than one type: [{}]", joined(&types))
            }
            Some(types) => return Ok(types.into_iter().next()),
            None if look.stop.is_due() => return Ok(None),
            None => {}
        }
        if !is_told {
            eprintln!("WARNING: topic [{name}] does not appear to be published yet");
            is_told = true;
        }
        if absent == Absent::Refuse {
            bail!("Could not determine the type for the passed topic");
        }
    }
}
