//! `downbeat bag export --format lerobot`

use std::num::NonZeroU32;

use anyhow::{Context, bail};

use super::{DatasetArguments, ExportArguments};
use crate::bag::open;
use crate::bag::output::Progress;
use crate::bag::select::{absolute, carried_over};
use crate::new_output::Output;
use crate::unfinished::Unfinished;
use downbeat_bags::Reader;
use downbeat_bridge::edge::Interfaces;
use downbeat_robot::dataset::{self, Demonstration, NumberTopic, PictureTopic};

/// Frames per second of most data sets.
const FPS: NonZeroU32 = NonZeroU32::new(30).expect("it is not 0");

pub(super) fn export(arguments: &ExportArguments, interfaces: &Interfaces) -> anyhow::Result<()> {
    if !arguments.topics.is_everything() {
        bail!("--state, --action and --images say which topics a data set has, not --topics and the like");
    }
    let what = demonstration(&arguments.dataset)?;
    let bags = arguments.bags.iter().map(|bag| open(bag)).collect::<anyhow::Result<Vec<Reader>>>()?;
    let output = &arguments.output;
    let replaces = (arguments.force, Output::Dataset);
    let unfinished = Unfinished::directory(output, replaces, bags.iter().map(Reader::path))?;
    let counted = [&what.state.topic, &what.action.topic];
    let counted = counted.into_iter().chain(what.pictures.iter().map(|pictures| &pictures.topic));
    let total = counted.flat_map(|name| {
        bags.iter().filter_map(move |bag| Some(bag.topics()[bag.topic(name)?.index()].message_count))
    });
    let mut progress = Progress::new("writing", total.sum());
    let mut seen = 0;
    let exported = dataset::export(&bags, &what, unfinished.written(), interfaces, || {
        seen += 1;
        progress.at(seen);
    })?;
    drop(progress);
    unfinished.finish()?;
    for late in &exported.late {
        tracing::warn!(
            "{}: {} of {} frames have something older than 0.25 s, at most {:.2} s: it paused, or is slower than the frames",
            late.topic,
            late.late,
            late.frames,
            late.oldest().as_secs_f64()
        );
    }
    let (episodes, frames) = (exported.episodes, exported.frames);
    println!("wrote {episodes} episodes with {frames} frames into {}", output.display());
    carried_over(&bags, exported.damaged)
}

fn demonstration(arguments: &DatasetArguments) -> anyhow::Result<Demonstration> {
    let DatasetArguments { fps, state, action, images, task, robot_type } = arguments;
    let picture = |text: &String| -> anyhow::Result<PictureTopic> {
        let (name, topic) = text
            .split_once('=')
            .with_context(|| format!("--images {text}: write NAME=TOPIC, such as front=camera/image_raw"))?;
        if name.is_empty()
            || !name.chars().all(|letter| letter.is_ascii_alphanumeric() || "_-.".contains(letter))
        {
            bail!("--images {text}: the name of a camera consists of letters, digits, _, - and .");
        }
        Ok(PictureTopic { name: name.to_owned(), topic: absolute(topic) })
    };
    let pictures = images.iter().map(picture).collect::<anyhow::Result<Vec<_>>>()?;
    for (index, one) in pictures.iter().enumerate() {
        if pictures[..index].iter().any(|other| other.name == one.name) {
            bail!("--images: two cameras are called {}", one.name);
        }
    }
    Ok(Demonstration {
        fps: fps.unwrap_or(FPS),
        state: numbers(state.as_deref().unwrap_or("joint_states")),
        action: numbers(action.as_deref().unwrap_or("joint_commands")),
        pictures,
        task: task.clone().unwrap_or_default(),
        robot_type: robot_type.clone(),
    })
}

/// `TOPIC` or `TOPIC:FIELD,FIELD`.
fn numbers(text: &str) -> NumberTopic {
    let (topic, fields) = text.split_once(':').unwrap_or((text, ""));
    let fields = fields.split(',').map(str::trim).filter(|field| !field.is_empty());
    NumberTopic { topic: absolute(topic), fields: fields.map(str::to_owned).collect() }
}
