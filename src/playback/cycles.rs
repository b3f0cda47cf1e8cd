//! When the cycles of a recorded robot were.

use downbeat_bags::Reader;
use downbeat_msgs::cdr;
use downbeat_msgs::downbeat_interfaces::msg::CycleTimes;

use super::{Extract, PlaybackError};
use crate::journal;

/// What a bag tells of the cycles.
pub(crate) enum Cycles {
    /// The time of each cycle. If `is_whole`, up to that in which the robot began to stop, else its recording was interrupted.
    Recorded { times: Vec<i64>, is_whole: bool },
    /// The bag was recorded in a robot, but without these times: there were cycles at the times of its messages.
    OfMessages,
    /// The bag was recorded elsewhere, for example from ROS 2: timers fire at their exact times.
    Unknown,
}

/// The topic that tells it.
pub(crate) fn topic() -> String {
    format!("/{}", journal::CYCLES)
}

impl Cycles {
    pub(crate) fn read(reader: &Reader, extract: &mut Extract) -> Result<Self, PlaybackError> {
        let name = topic();
        let topic = reader.topic(&name).filter(|id| reader.topics()[id.index()].message_count > 0);
        let Some(id) = topic else {
            // What the recorder notes of each robot that it records.
            let is_of_robot =
                reader.metadata().is_some_and(|metadata| metadata.custom_data.contains_key("robot"));
            return Ok(if is_of_robot { Self::OfMessages } else { Self::Unknown });
        };
        let (mut times, mut is_whole) = (Vec::new(), false);
        for message in extract.of::<PlaybackError>(reader, id)? {
            let message = cdr::from_slice::<CycleTimes>(message)
                .map_err(|source| PlaybackError::Account { topic: name.clone(), source })?;
            if message.first != times.len() as u64 {
                return Err(PlaybackError::CyclesLost { expected: times.len() as u64, found: message.first });
            }
            times.extend_from_slice(&message.times);
            is_whole = message.is_end;
        }
        Ok(Self::Recorded { times, is_whole })
    }

    pub(crate) fn is_recorded(&self) -> bool {
        matches!(self, Self::Recorded { .. })
    }

    /// The time of the first cycle that the bag tells.
    pub(crate) fn first(&self) -> Option<i64> {
        match self {
            Self::Recorded { times, .. } => times.first().copied(),
            Self::OfMessages | Self::Unknown => None,
        }
    }

    /// What modules publish from this time on is in no bag. While the robot stopped there were more cycles, at times that are not
    /// recorded; of a recording that was interrupted the bag may lack what the last cycle published, too.
    pub(crate) fn end(&self) -> i64 {
        match self {
            Self::Recorded { times, is_whole } => {
                let last = times.last().copied().unwrap_or(i64::MIN);
                if *is_whole { last.saturating_add(1) } else { last }
            }
            Self::OfMessages | Self::Unknown => i64::MAX,
        }
    }
}
