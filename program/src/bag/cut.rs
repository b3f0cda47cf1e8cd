//! `downbeat bag cut`

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use clap::Args;

use super::open;
use super::output::{OutputArguments, write};
use super::select::{TopicArguments, carried_over};
use downbeat_bags::{Copy, Reader, Storage};
use downbeat_files::duration::parse as duration;

#[derive(Args)]
pub(crate) struct CutArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// Start of the part: an offset into the bag (10s, 1.5min), or seconds since the epoch (1795230923.877).
    #[arg(long, value_parser = place, value_name = "TIME")]
    pub(crate) from: Option<Place>,
    /// End of the part, in the same form as --from.
    #[arg(long, value_parser = place, value_name = "TIME")]
    pub(crate) until: Option<Place>,
    /// Leave out the last messages of latched (transient local) topics before the part: by default they are
    /// kept at the time of the start, as a subscriber joining then would receive them.
    #[arg(long)]
    pub(crate) no_latched: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
}

/// A time in a bag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Place {
    /// After the first message.
    Offset(Duration),
    /// Nanoseconds since the epoch.
    Time(i64),
}

impl Place {
    pub(crate) fn in_bag(self, start: i64) -> i64 {
        match self {
            Self::Offset(offset) => {
                start.saturating_add(i64::try_from(offset.as_nanos()).unwrap_or(i64::MAX))
            }
            Self::Time(time) => time,
        }
    }
}

/// `10s`, or `1795230923.877473869` to the nanosecond.
pub(crate) fn place(text: &str) -> Result<Place, String> {
    if let Ok(offset) = duration(text) {
        return Ok(Place::Offset(offset));
    }
    let (seconds, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let wrong = || {
        format!("\"{text}\" is not a time; write 10s or 1.5min from the start, or seconds since the epoch")
    };
    if !is_number(seconds) || !is_number(fraction) || fraction.len() > 9 {
        return Err(wrong());
    }
    let seconds: i64 = seconds.parse().map_err(|_| wrong())?;
    let nanoseconds: i64 = format!("{fraction:0<9}").parse().map_err(|_| wrong())?;
    let time = seconds.checked_mul(1_000_000_000).and_then(|time| time.checked_add(nanoseconds));
    time.map(Place::Time).ok_or_else(wrong)
}

pub(crate) fn cut(arguments: &CutArguments) -> anyhow::Result<()> {
    let bags = [open(&arguments.bag)?];
    let [bag] = &bags;
    let (Some(start), Some(end)) = (bag.start_time(), bag.end_time()) else {
        bail!("{} has no messages", arguments.bag.display());
    };
    let from = match arguments.from {
        // Also messages with a damaged time, which are before what the bag declares as its start.
        None | Some(Place::Offset(Duration::ZERO)) => i64::MIN,
        Some(place) => place.in_bag(start),
    };
    let until = arguments.until.map_or(i64::MAX, |place| place.in_bag(start));
    if from > end || until < start || from > until {
        let length = bag.duration().as_secs_f64();
        bail!("there is nothing between --from and --until: the bag is {length:.3} s long");
    }
    let filter = arguments.topics.filter()?;
    arguments.topics.check(bags.iter().flat_map(Reader::topics).map(|topic| &topic.info))?;
    let mut copy = Copy::of(&bags, |topic| filter.is_wanted(topic))?.times(from, until);
    if !arguments.no_latched {
        copy = copy.keep_latched();
    }
    let copied = write(copy, &bags, &arguments.output.output, &arguments.output.layout, Storage::default())?;
    carried_over(&bags, copied.unreadable.len() + copied.undecodable.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_offsets_or_seconds_since_the_epoch() {
        assert_eq!(place("1.5s"), Ok(Place::Offset(Duration::from_millis(1500))));
        assert_eq!(place("1795230923.877473869"), Ok(Place::Time(1_795_230_923_877_473_869)));
        assert_eq!(place("12"), Ok(Place::Time(12_000_000_000)));
        for wrong in ["", "1.2.3", "1.0000000001", "soon", "-1", "99999999999999"] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
        assert_eq!(Place::Offset(Duration::from_secs(1)).in_bag(5), 1_000_000_005);
    }
}
