//! `downbeat bag replay --with`: two replays of a bag, one of them with changes.

mod report;
mod side;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use downbeat_bags::{BagMessage, Comparer, FieldDifference, FieldRule, Reader, ReaderError, Selection};
use downbeat_robot::replay::{ReplaySession, Simulators};
use downbeat_robot::{Catalog, RobotFile, RosArgs};
use tempfile::TempDir;

use super::replayed::ReplayedArguments;
use crate::logging::Log;
use side::Side;

/// Replays with changes and without, and says where the two part.
pub(super) fn what_if(
    arguments: &ReplayedArguments,
    changes: &[String],
    report: Option<&Path>,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    let (file, reader, mut options) = arguments.open(catalog, ros, log)?;
    if options.modules.is_empty() && options.simulators == Simulators::LeftOut {
        // The recorded answers of devices are to what was asked then.
        let others = file.modules.iter().filter(|module| !module.kind.uses_device());
        options.modules = others.map(|module| module.name.clone()).collect();
    }
    // One after the other: simulated devices of two robots would have the same names.
    let plain = ReplaySession::open(file, &reader, &options)?;
    let names = plain.about().modules.iter().chain(&plain.about().detached);
    let settings = |module: &String| -> BTreeSet<String> {
        plain.settings(module).into_iter().flatten().map(|setting| setting.name).collect()
    };
    let settings: BTreeMap<_, _> = names.map(|module| (module.clone(), settings(module))).collect();
    // Before the first run: a mistake in a change should not take long to show.
    let changed = changed(arguments, changes, &settings, catalog, ros)?;
    let folder = match report {
        Some(report) => Folder::Report(new_folder(report)?),
        None => Folder::Temporary(TempDir::with_prefix("downbeat_what_if_")?),
    };
    let plain = Side::record(plain, &folder.path().join("before"))?;
    let changed =
        Side::record(ReplaySession::open(changed, &reader, &options)?, &folder.path().join("after"))?;
    let runs = Runs::compare(plain, changed, &options.rules)?;
    let title = changes.join(", ");
    print!("{}", runs.text(&title));
    if let Folder::Report(folder) = &folder {
        report::write(folder, &title, &reader, &runs, &catalog.interfaces)?;
        println!("\nreport: {}", folder.join(report::FILE).display());
    }
    Ok(())
}

/// The robot with the changes. `robot=FILE` is another robot file, which the others then change.
fn changed(
    arguments: &ReplayedArguments,
    changes: &[String],
    settings: &BTreeMap<String, BTreeSet<String>>,
    catalog: &Catalog,
    ros: &RosArgs,
) -> anyhow::Result<RobotFile> {
    let other = |change: &String| change.strip_prefix("robot=").map(PathBuf::from);
    let robot = changes.iter().find_map(other);
    let robot = robot.as_ref().unwrap_or(&arguments.robot);
    let mut file = arguments.parameters.read_robot(robot, catalog, ros)?;
    let has_setting =
        |module: &str, setting: &str| settings.get(module).is_some_and(|known| known.contains(setting));
    for change in changes.iter().filter(|change| other(change).is_none()) {
        file.change(change, has_setting)?;
    }
    Ok(file)
}

enum Folder {
    Report(PathBuf),
    Temporary(TempDir),
}

impl Folder {
    fn path(&self) -> &Path {
        match self {
            Self::Report(path) => path,
            Self::Temporary(folder) => folder.path(),
        }
    }
}

fn new_folder(path: &Path) -> anyhow::Result<PathBuf> {
    std::fs::create_dir(path)
        .with_context(|| format!("cannot create the folder {} for the report", path.display()))?;
    Ok(path.to_owned())
}

/// Two runs, side by side.
struct Runs {
    plain: Side,
    changed: Side,
    topics: BTreeMap<String, Topic>,
    /// Where they part.
    first: Option<Parting>,
}

/// A topic in the two runs.
#[derive(Default)]
struct Topic {
    /// How many messages there are in both, and how many of these differ.
    compared: u64,
    different: u64,
    /// How many more there are with the changes; negative: fewer.
    more: i64,
}

/// The first message in which the runs differ.
struct Parting {
    topic: String,
    number: usize,
    time_ns: i64,
    /// The cycle of the changed run, and the modules that published on the topic in it.
    origin: Option<(u64, Vec<String>)>,
    /// `None` if only one of the runs has the message.
    field: Option<FieldDifference>,
}

impl Runs {
    fn compare(plain: Side, changed: Side, rules: &[FieldRule]) -> anyhow::Result<Self> {
        let (before, after) = (plain.reader()?, changed.reader()?);
        let names: BTreeSet<&String> = plain.topics.keys().chain(changed.topics.keys()).collect();
        if names.is_empty() {
            bail!("neither of the two replays has a message: there is nothing to compare");
        }
        let (mut topics, mut first) = (BTreeMap::new(), None::<Parting>);
        for name in names {
            let mut topic = Topic::default();
            let info = plain.topics.get(name).or(changed.topics.get(name)).map(|topic| &topic.info);
            let Some(info) = info else { continue };
            let comparer = Comparer::new(info, rules);
            let [mut one, mut other] = [messages_of(&before, name)?, messages_of(&after, name)?];
            for number in 0.. {
                let (found, time_ns) = match (one.next().transpose()?, other.next().transpose()?) {
                    (None, None) => break,
                    (Some(one), Some(other)) => {
                        topic.compared += 1;
                        (comparer.compare(&one.data, &other.data).map(Some), other.log_time)
                    }
                    (Some(message), None) => {
                        topic.more -= 1;
                        (Some(None), message.log_time)
                    }
                    (None, Some(message)) => {
                        topic.more += 1;
                        (Some(None), message.log_time)
                    }
                };
                let Some(field) = found else { continue };
                topic.different += u64::from(field.is_some());
                if !comparer.ignores_all() && first.as_ref().is_none_or(|first| time_ns < first.time_ns) {
                    let origin = changed.origin(name, number);
                    let origin = origin.map(|(cycle, modules)| (cycle, modules.to_vec()));
                    first = Some(Parting { topic: name.clone(), number, time_ns, origin, field });
                }
            }
            topics.insert(name.clone(), topic);
        }
        Ok(Self { plain, changed, topics, first })
    }

    /// What is said on the terminal.
    fn text(&self, title: &str) -> String {
        let mut text = format!("{} cycles with and without {title}\n", self.changed.cycles);
        match &self.first {
            None => text += "the two runs are the same, message by message\n",
            Some(first) => text += &format!("they part {}\n", first.sentence(self.plain.start_ns)),
        }
        let width = self.topics.keys().map(String::len).max().unwrap_or(0).max(5);
        text += &format!("\n  {:width$}  compared  different  more\n", "topic");
        for (name, Topic { compared, different, more }) in &self.topics {
            text += &format!("  {name:width$}  {compared:>8}  {different:>9}  {more:>+4}\n");
        }
        text
    }
}

impl Parting {
    fn sentence(&self, start_ns: i64) -> String {
        let Self { topic, number, time_ns, origin, field } = self;
        let seconds = (time_ns - start_ns) as f64 / 1e9;
        let origin = match origin {
            None => String::new(),
            Some((cycle, modules)) if modules.is_empty() => format!(", in cycle #{cycle}"),
            Some((cycle, modules)) => format!(", in cycle #{cycle} from {}", modules.join(" and ")),
        };
        match field {
            Some(FieldDifference { path, first, second }) => format!(
                "{seconds:.6} s into the bag{origin}: in {topic} #{number}, {path} is {second}, and {first} without the change"
            ),
            None => format!("{seconds:.6} s into the bag{origin}: only one of them has {topic} #{number}"),
        }
    }
}

/// The messages of a topic, none if the bag lacks it.
fn messages_of(
    bag: &Reader,
    topic: &str,
) -> anyhow::Result<impl Iterator<Item = Result<BagMessage, ReaderError>>> {
    let messages = bag.topic(topic).map(|id| bag.messages(Selection::all().topics([id]))).transpose()?;
    Ok(messages.into_iter().flatten())
}
