//! `downbeat bag replay`

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use downbeat_bags::FieldDifference;
use downbeat_robot::replay::{
    Difference, ReplayReport, Strictness, TopicReport, What, replay as replay_robot,
};
use downbeat_robot::{Catalog, ChangedSetting, LauncherChoice, RosArgs};
use serde_json::{Value, json};

use super::replayed::ReplayedArguments;
use super::what_if::what_if;
use crate::logging::Log;

#[derive(Args)]
pub(crate) struct ReplayArguments {
    #[command(flatten)]
    pub(crate) replayed: ReplayedArguments,
    /// Fail if a topic of the chosen modules was not compared. Topics of --except and topics of plain Rust
    /// types, which no bag contains, are only listed.
    #[arg(long)]
    pub(crate) strict: bool,
    /// Run the modules on one thread (linear), on n threads (pool:4) or each on its own (threads), instead of
    /// the robot file's launcher. The result is the same.
    #[arg(long)]
    pub(crate) launcher: Option<LauncherChoice>,
    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// What if: replay twice, with this change and without, and say where the two runs part:
    /// gait.period=0.7, period=0.7 if only one module has it, brain=other.scxml for another version of a
    /// module's file, or robot=OTHER.toml. May be given more than once.
    #[arg(long, value_name = "CHANGE", conflicts_with_all = ["strict", "json", "launcher"])]
    pub(crate) with: Vec<String>,
    /// The new folder for a report of --with in Markdown, with plots of both runs over each other.
    #[arg(long, value_name = "FOLDER", requires = "with")]
    pub(crate) report: Option<PathBuf>,
}

pub(crate) fn replay(
    arguments: &ReplayArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    if !arguments.with.is_empty() {
        let report = arguments.report.as_deref();
        return what_if(&arguments.replayed, &arguments.with, report, catalog, ros, log);
    }
    let (mut file, reader, options) = arguments.replayed.open(catalog, ros, log)?;
    if let Some(launcher) = arguments.launcher.clone() {
        file.launcher.choice = launcher;
    }
    let report = replay_robot(file, &reader, &options)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&as_json(&report))?);
    } else {
        print!("{report}");
    }
    let strictness = if arguments.strict { Strictness::EveryTopic } else { Strictness::AnyTopic };
    report.check(strictness).map_err(|not_same| anyhow!("{}", not_same.problem()))
}

fn as_json(report: &ReplayReport) -> Value {
    let detached = report.detached.iter().map(|(module, runs)| json!({ "module": module, "runs": runs }));
    let left_out = report.left_out.iter().map(|left| json!({ "module": left.module, "reason": left.reason }));
    let topics = report.topics.iter().map(|topic| {
        let TopicReport { topic, modules, is_ignored, compared, different, first } = topic;
        json!({
            "topic": topic,
            "modules": modules,
            "is_ignored": is_ignored,
            "compared": compared,
            "different": different,
            "first_difference": first.as_ref().map(difference),
        })
    });
    let not_compared = report.not_compared.iter().map(
        |topic| json!({ "topic": topic.topic, "reason": topic.reason.to_string(), "is_gap": topic.is_gap() }),
    );
    json!({
        "robot": report.robot,
        "modules": report.modules,
        "cycles": report.cycles,
        "has_recorded_cycles": report.has_recorded_cycles,
        "detached": detached.collect::<Vec<_>>(),
        "left_out": left_out.collect::<Vec<_>>(),
        "changed_sources": report.changed_sources,
        "versions": report.versions,
        "changed_settings": report.changed_settings.iter().map(changed_setting).collect::<Vec<_>>(),
        "inputs": report.inputs,
        "missing_inputs": report.missing_inputs,
        "topics": topics.collect::<Vec<_>>(),
        "not_compared": not_compared.collect::<Vec<_>>(),
        "compared": report.compared(),
        "first_difference": report.first_difference().map(difference),
        "different": report.different(),
        "bag_seconds": report.bag_duration.as_secs_f64(),
        "seconds": report.took.as_secs_f64(),
    })
}

fn changed_setting(changed: &ChangedSetting) -> Value {
    json!({
        "module": changed.module,
        "setting": changed.setting,
        "recorded": changed.recorded.as_ref().map(ToString::to_string),
        "now": changed.now.as_ref().map(ToString::to_string),
        "replayed": if changed.is_explicit { "now" } else { "recorded" },
    })
}

fn difference(difference: &Difference) -> Value {
    let Difference { topic, number, time, what } = difference;
    let what = match what {
        What::Field(FieldDifference { path, first, second }) => {
            json!({ "kind": "field", "field": path, "recorded": first, "replayed": second })
        }
        What::Time { replayed } => json!({ "kind": "time", "replayed_ns": replayed }),
        What::Missing => json!({ "kind": "missing" }),
        What::Extra => json!({ "kind": "extra" }),
    };
    json!({ "topic": topic, "message": number, "time_ns": time, "what": what })
}
