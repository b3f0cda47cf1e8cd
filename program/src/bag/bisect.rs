//! `downbeat bag bisect`

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use anyhow::{Context, bail};
use clap::Args;
use serde_json::Value;
use tempfile::TempDir;

use crate::own_command::own_command;

#[derive(Args)]
pub(crate) struct BisectArguments {
    /// The robot file of the recording, in a repository of git.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// A rosbag2 directory or an MCAP file.
    pub(crate) bag: PathBuf,
    /// A revision whose replay is the same as the bag.
    #[arg(long, value_name = "REV")]
    pub(crate) good: String,
    /// A later revision whose replay differs.
    #[arg(long, value_name = "REV", default_value = "HEAD")]
    pub(crate) bad: String,
    /// Builds a revision, in its folder: "cargo build --release". Revisions that do not build are skipped.
    #[arg(long, value_name = "COMMAND")]
    pub(crate) build: Option<String>,
    /// The program that the build makes, in the folder of the revision: target/release/my_robot. If not
    /// given, this program replays, with the robot file and the files of its modules as they were.
    #[arg(long, value_name = "FILE")]
    pub(crate) program: Option<PathBuf>,
    /// Further options of `bag replay`.
    #[arg(last = true, value_name = "OPTIONS")]
    pub(crate) options: Vec<OsString>,
}

/// What the replay of a revision came to.
#[derive(Debug)]
enum Outcome {
    Same,
    /// With the first difference.
    Differs(String),
    /// It cannot be replayed.
    Fails(String),
}

pub(crate) fn bisect(arguments: &BisectArguments) -> anyhow::Result<()> {
    let robot = std::path::absolute(&arguments.robot)?;
    let folder = robot.parent().context("the robot file has no folder")?;
    if !robot.is_file() {
        bail!("there is no robot file {}; a carried robot has no revisions", arguments.robot.display());
    }
    let top = git(folder, ["rev-parse", "--show-toplevel"])
        .with_context(|| format!("{} is in no repository of git", arguments.robot.display()))?;
    let inside = robot.canonicalize()?;
    let inside = inside.strip_prefix(Path::new(&top).canonicalize()?)?.to_owned();
    let revision = |name: &str| {
        let found = git(folder, ["rev-parse", "--verify", &format!("{name}^{{commit}}")]);
        found.with_context(|| format!("there is no revision {name}"))
    };
    let (good, bad) = (revision(&arguments.good)?, revision(&arguments.bad)?);
    let place = TempDir::with_prefix("downbeat_bisect_")?;
    let tree = place.path().join("tree");
    let path = tree.to_string_lossy();
    git(folder, ["worktree", "add", "--quiet", "--detach", &*path, &bad])?;
    let replays =
        Replays { arguments, tree: &tree, robot: inside, bag: std::path::absolute(&arguments.bag)? };
    let found = replays.first_bad(&good, &bad);
    // Also after an error.
    let removed = git(folder, ["worktree", "remove", "--force", &*path]);
    let (commit, difference) = found?;
    removed?;
    println!(
        "{}",
        git(
            folder,
            [
                "show",
                "--no-patch",
                "--format=%nthe first revision that differs:%n%n  %h %s%n  %an, %ad",
                &commit
            ]
        )?
    );
    println!("\n{difference}");
    Ok(())
}

struct Replays<'a> {
    arguments: &'a BisectArguments,
    tree: &'a Path,
    /// In the repository.
    robot: PathBuf,
    bag: PathBuf,
}

impl Replays<'_> {
    fn first_bad(&self, good: &str, bad: &str) -> anyhow::Result<(String, String)> {
        let mut difference = match self.outcome()? {
            Outcome::Differs(difference) => difference,
            Outcome::Same => bail!("the replay of {} does not differ from the bag", self.arguments.bad),
            Outcome::Fails(problem) => bail!("{} cannot be replayed: {problem}", self.arguments.bad),
        };
        git(self.tree, ["checkout", "--quiet", "--detach", good])?;
        match self.outcome()? {
            Outcome::Same => {}
            Outcome::Differs(difference) => {
                bail!("the replay of {} differs from the bag too: {difference}", self.arguments.good)
            }
            Outcome::Fails(problem) => bail!("{} cannot be replayed: {problem}", self.arguments.good),
        }
        git(self.tree, ["bisect", "start", bad, good])?;
        loop {
            let commit = git(self.tree, ["rev-parse", "HEAD"])?;
            let outcome = self.outcome()?;
            let term = match &outcome {
                Outcome::Same => "good",
                Outcome::Differs(_) => "bad",
                Outcome::Fails(_) => "skip",
            };
            println!("{}", self.line(&commit, &outcome)?);
            if let Outcome::Differs(found) = outcome {
                difference = found;
            }
            let output = git_output(self.tree, ["bisect", term])?;
            let said = String::from_utf8_lossy(&output.stdout);
            if let Some((first, _)) = said.split_once(" is the first bad commit") {
                let first = first.lines().next_back().unwrap_or_default().to_owned();
                return Ok((first, difference));
            }
            if said.contains("only 'skip'ped commits left") {
                bail!(
                    "the revisions that are left cannot be replayed; the first that differs is one of these:\n{}",
                    said.trim_end()
                );
            }
            if !output.status.success() {
                bail!("git bisect: {}", String::from_utf8_lossy(&output.stderr).trim_end());
            }
        }
    }

    fn line(&self, commit: &str, outcome: &Outcome) -> anyhow::Result<String> {
        let about = git(self.tree, ["show", "--no-patch", "--format=%h %s", commit])?;
        Ok(match outcome {
            Outcome::Same => format!("same:    {about}"),
            Outcome::Differs(_) => format!("differs: {about}"),
            Outcome::Fails(problem) => format!("skipped: {about} ({problem})"),
        })
    }

    /// Builds and replays the revision in the folder.
    fn outcome(&self) -> anyhow::Result<Outcome> {
        if let Some(build) = &self.arguments.build {
            let (shell, option) = if cfg!(windows) { ("cmd", "/C") } else { ("sh", "-c") };
            let built = Command::new(shell).args([option, build]).current_dir(self.tree).output();
            let built = built.with_context(|| format!("cannot run {build}"))?;
            if !built.status.success() {
                return Ok(Outcome::Fails(format!("{build}: {}", last_line(&built.stderr))));
            }
        }
        let mut replay = match &self.arguments.program {
            Some(program) => Command::new(self.tree.join(program)),
            None => {
                let (program, script) = own_command("bag")?;
                let mut command = Command::new(program);
                command.args(script);
                command
            }
        };
        // Some options take all names that follow, so they come last.
        replay.args(["bag", "replay", "--json"]).arg(self.tree.join(&self.robot)).arg(&self.bag);
        replay.args(&self.arguments.options).current_dir(self.tree);
        let output = replay.output().with_context(|| format!("cannot run {replay:?}"))?;
        let Ok(report) = serde_json::from_slice::<Value>(&output.stdout) else {
            return Ok(Outcome::Fails(last_line(&output.stderr)));
        };
        let first = &report["first_difference"];
        Ok(match (output.status.success(), first) {
            (true, _) => Outcome::Same,
            (false, Value::Null) => Outcome::Fails(last_line(&output.stderr)),
            (false, first) => Outcome::Differs(sentence(first)),
        })
    }
}

/// A first difference of a report, as a sentence.
fn sentence(first: &Value) -> String {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let (topic, number) = (text(&first["topic"]), &first["message"]);
    let what = &first["what"];
    let kind = match what["kind"].as_str() {
        Some("field") => format!(
            "{}: recorded {}, replayed {}",
            text(&what["field"]),
            text(&what["recorded"]),
            text(&what["replayed"])
        ),
        Some("time") => "published in another cycle".to_owned(),
        Some("missing") => "recorded, and not published in the replay".to_owned(),
        _ => "published in the replay, and not recorded".to_owned(),
    };
    format!("{topic} message {number} at {}: {kind}", first["time_ns"])
}

fn last_line(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(text);
    text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it says nothing").to_owned()
}

fn git_output<'a>(folder: &Path, arguments: impl IntoIterator<Item = &'a str>) -> anyhow::Result<Output> {
    let mut git = Command::new("git");
    git.arg("-C").arg(folder).args(arguments);
    git.output().context("cannot run git")
}

/// What git prints.
fn git<'a>(folder: &Path, arguments: impl IntoIterator<Item = &'a str>) -> anyhow::Result<String> {
    let output = git_output(folder, arguments)?;
    if !output.status.success() {
        bail!("git: {}", last_line(&output.stderr));
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim_end().to_owned())
}
