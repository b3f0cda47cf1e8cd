//! `cargo xtask football`

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use serde_json::Value;

use crate::steps::workspace;

#[derive(Args)]
pub(crate) struct FootballArguments {
    /// Only this proof; may be repeated
    #[arg(long, value_enum)]
    only: Vec<Proof>,
    /// How many seeds each proof takes, in place of its own number: walks, placements, matches; of vision 100
    /// pictures for each
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: Option<u64>,
    /// The first seed of the matches and of the placements at the empty goal
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// The simulated length of the recorded matches, in s
    #[arg(long, default_value_t = 300)]
    recorded: u64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Proof {
    /// Balls and landmarks in simulated pictures, against the truth
    Vision,
    /// Where a walking robot is, and a kidnapped one
    Localisation,
    /// One robot that believes the truth with noise, an empty goal
    EmptyGoal,
    /// The same by what its camera shows
    SeeingEmptyGoal,
    /// Two against two who believe the truth with noise, two halves of five minutes
    Match,
    /// The same with players who know only what their cameras show and their mates say
    SeeingMatch,
    /// Recorded matches, replayed under several launchers
    Replay,
}

/// A figure beside its goal.
struct Finding {
    what: &'static str,
    found: String,
    goal: String,
    is_met: bool,
}

/// Runs the long proofs of the football player; `cargo xtask test` runs short versions of them.
pub(crate) fn football(arguments: &FootballArguments) -> anyhow::Result<()> {
    let all = Proof::value_variants();
    let chosen = if arguments.only.is_empty() { all } else { &arguments.only };
    let mut rows = Vec::new();
    for &proof in chosen {
        let name = proof.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        eprintln!("\n== {name}");
        let findings = proof.run(arguments).unwrap_or_else(|error| {
            let found = format!("{error:#}");
            vec![Finding { what: "it runs", found, goal: "to its end".to_owned(), is_met: false }]
        });
        rows.extend(findings.into_iter().map(|finding| (name.clone(), finding)));
    }
    let width = |of: fn(&(String, Finding)) -> &str| {
        rows.iter().map(|row| of(row).chars().count()).max().unwrap_or_default()
    };
    let widths =
        [width(|row| &row.0), width(|row| row.1.what), width(|row| &row.1.found), width(|row| &row.1.goal)];
    println!();
    for (name, Finding { what, found, goal, is_met }) in &rows {
        let verdict = if *is_met { "met" } else { "MISSED" };
        let [a, b, c, d] = widths;
        println!("{name:<a$}  {what:<b$}  {found:<c$}  goal: {goal:<d$}  {verdict}");
    }
    let missed = rows.iter().filter(|(_, finding)| !finding.is_met).count();
    if missed > 0 {
        bail!("{missed} of {} goals are missed", rows.len());
    }
    Ok(())
}

impl Proof {
    fn run(self, arguments: &FootballArguments) -> anyhow::Result<Vec<Finding>> {
        let seeds = |default| arguments.seeds.unwrap_or(default);
        match self {
            Self::Vision => vision(seeds(20) * 100),
            Self::Localisation => localisation(seeds(20)),
            Self::EmptyGoal => empty_goal(&[], seeds(20), arguments.first_seed),
            Self::SeeingEmptyGoal => empty_goal(&["--eyes"], seeds(20), arguments.first_seed),
            Self::Match => two_against_two(seeds(5), arguments.first_seed),
            Self::SeeingMatch => seeing_teams(seeds(10), arguments.first_seed),
            Self::Replay => (1..=seeds(1)).try_fold(Vec::new(), |mut findings, seed| {
                findings.extend(replay(seed, arguments.recorded)?);
                Ok(findings)
            }),
        }
    }
}

fn vision(pictures: u64) -> anyhow::Result<Vec<Finding>> {
    let example = ["run", "--release", "--package", "downbeat-vision", "--example", "evaluate", "--"];
    let printed = output_of(cargo(&example).arg(pictures.to_string()))?.text;
    let [recall, precision, error] =
        ["recall ", "precision ", "median error "].map(|before| number_after(&printed, before));
    Ok(vec![
        at_least("recall of balls", recall?, 0.95),
        at_least("precision of balls", precision?, 0.98),
        at_most("median error, of the distance", error?, 0.05),
    ])
}

fn localisation(walks: u64) -> anyhow::Result<Vec<Finding>> {
    let test = ["test", "--release", "--package", "downbeat-localisation", "--test", "walks", "--"];
    let tests =
        ["--nocapture", "--test-threads=1", "twenty_walks_are_followed", "a_kidnapped_robot_finds_back"];
    let printed = output_of(cargo(&test).args(tests).env("DOWNBEAT_WALKS", walks.to_string()))?.text;
    // The name of the test may be on the same line.
    let line =
        printed.lines().find(|line| line.contains("heading: median ")).context("no line of the walks")?;
    let heading = line.split_once("heading: ").map_or("", |(_, heading)| heading);
    let back =
        printed.lines().find_map(|line| line.strip_suffix(" are back")?.split(' ').next()?.parse().ok());
    let back: u64 = back.context("no line of the kidnapped robots")?;
    Ok(vec![
        at_most("position, median, m", number_after(line, "median ")?, 0.10),
        at_most("position, 95 %, m", number_after(line, "95 % ")?, 0.30),
        at_most("heading, 95 %, degrees", number_after(heading, "95 % ")?, 5.0),
        Finding {
            what: "kidnapped, back within 10 s",
            found: format!("{back} of {walks}"),
            goal: "18 of 20".to_owned(),
            is_met: back * 20 >= walks * 18,
        },
    ])
}

fn empty_goal(options: &[&str], tries: u64, first_seed: u64) -> anyhow::Result<Vec<Finding>> {
    let chart = ["--chart", "robots/football/shooter.scxml", "--seed", &first_seed.to_string()];
    let game = ["--game", "empty_goal", "--robots", "blue_2", "--count", &tries.to_string()];
    let games = play(&[game.as_slice(), &chart, options].concat())?;
    let goals: u64 = games.iter().filter_map(|game| game["blue"].as_u64()).sum();
    Ok(vec![Finding {
        what: "goals within 90 s each",
        found: format!("{goals} of {tries}"),
        goal: "18 of 20".to_owned(),
        is_met: goals * 20 >= tries * 18,
    }])
}

fn two_against_two(matches: u64, first_seed: u64) -> anyhow::Result<Vec<Finding>> {
    let [count, seed] = [matches, first_seed].map(|number| number.to_string());
    let games = play(&["--count", &count, "--seed", &seed, "--threads", "2"])?;
    Ok(findings_of_matches(&games, matches))
}

/// Two against two with eyes: also whether it is worth watching.
fn seeing_teams(matches: u64, first_seed: u64) -> anyhow::Result<Vec<Finding>> {
    let [count, seed] = [matches, first_seed].map(|number| number.to_string());
    let games = play(&["--eyes", "--count", &count, "--seed", &seed, "--threads", "2"])?;
    let mut findings = findings_of_matches(&games, matches);
    let sum = |game: &Value, key: &str| -> f64 {
        game["players"].as_array().into_iter().flatten().filter_map(|player| player[key].as_f64()).sum()
    };
    let all = |key: &str| games.iter().map(|game| sum(game, key)).sum::<f64>();
    let goals: f64 =
        games.iter().flat_map(|game| [&game["blue"], &game["red"]]).filter_map(Value::as_f64).sum();
    let players = games.iter().filter_map(|game| game["players"].as_array()).flatten().count();
    // Median and 95 % of a player.
    let pose_error = |which: usize| {
        let errors = games.iter().filter_map(|game| game["players"].as_array()).flatten();
        errors.filter_map(|player| player["pose_error_m"][which].as_f64()).sum::<f64>() / players as f64
    };
    let without_shot = games.iter().filter(|game| sum(game, "shots") == 0.0).count();
    findings.extend([
        at_least("goals in a match, mean", goals / games.len() as f64, 3.0),
        Finding {
            what: "matches without a shot",
            found: without_shot.to_string(),
            goal: "0".to_owned(),
            is_met: without_shot == 0,
        },
        // Of two halves.
        at_most("falls of a robot in a half, mean", all("falls") / (2 * players) as f64, 2.0),
        at_least("share of falls after which it got up", all("get_ups") / all("falls"), 0.9),
        at_most("position, median, mean of the players, m", pose_error(0), 0.08),
        at_most("position, 95 %, mean of the players, m", pose_error(1), 0.25),
    ]);
    Ok(findings)
}

fn findings_of_matches(games: &[Value], matches: u64) -> Vec<Finding> {
    let players = || games.iter().filter_map(|game| game["players"].as_array()).flatten();
    let most = |key: &str| players().filter_map(|player| player[key].as_f64()).fold(0.0, f64::max);
    let count = |key: &str| players().filter_map(|player| player[key].as_u64()).sum::<u64>();
    let (falls, get_ups) = (count("falls"), count("get_ups"));
    let of_games = |key: &str| games.iter().filter_map(|game| game[key].as_u64()).sum::<u64>();
    let stopped: Vec<&str> = games
        .iter()
        .filter_map(|game| game["stopped_modules"].as_array())
        .flatten()
        .filter_map(Value::as_str)
        .collect();
    let scores: Vec<_> = games.iter().map(|game| format!("{}:{}", game["blue"], game["red"])).collect();
    let speed = games.iter().filter_map(|game| game["speed"].as_f64()).fold(f64::MAX, f64::min);
    let dropped = of_games("dropped");
    vec![
        Finding {
            what: "matches played to the end",
            found: games.len().to_string(),
            goal: matches.to_string(),
            // A game without modules has not told how it ended.
            is_met: games.len() as u64 == matches && games.iter().all(|game| game["modules"] != 0),
        },
        Finding {
            what: "goals",
            found: scores.join(" "),
            goal: "some".to_owned(),
            is_met: of_games("blue") + of_games("red") > 0,
        },
        at_most("longest stand of who may move, s", most("still_s"), 60.0),
        Finding {
            what: "falls, and times up again",
            found: format!("{falls}, {get_ups}"),
            goal: "most get up".to_owned(),
            is_met: get_ups * 2 >= falls,
        },
        at_most("moved when penalised, after 0.5 s, m", most("strayed_m"), 0.05),
        Finding {
            what: "modules stopped",
            found: if stopped.is_empty() { "none".to_owned() } else { stopped.join(" ") },
            goal: "none".to_owned(),
            is_met: stopped.is_empty(),
        },
        Finding {
            what: "messages dropped by bounded inboxes",
            found: dropped.to_string(),
            goal: "0".to_owned(),
            is_met: dropped == 0,
        },
        at_least("times real time, the slowest", speed, 1.0),
    ]
}

/// Records a match without vision and one with, and replays them.
fn replay(seed: u64, seconds: u64) -> anyhow::Result<Vec<Finding>> {
    let folder = workspace().join("target/football");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let seed_of = |seed: u64| format!("match.seed:={seed}");
    let bag = |name: &str| folder.join(format!("{name}_{seed}"));
    let record = |file: &str, seconds: u64, name: &str| -> anyhow::Result<()> {
        let length = format!("{seconds}s");
        let mut command = downbeat();
        command.args([
            "match",
            file,
            "--fast",
            "--duration",
            &length,
            "-p",
            &seed_of(seed),
            "--force",
            "--record",
        ]);
        let output = output_of(command.arg(bag(name)))?;
        if !output.is_success {
            bail!("{file} was not recorded")
        }
        Ok(())
    };
    let replayed = |file: &str, seed: u64, name: &str, more: &[&str]| -> anyhow::Result<Value> {
        let mut command = downbeat();
        command.args(["bag", "replay", file]).arg(bag(name)).args(["--json", "-p", &seed_of(seed)]);
        let printed = output_of(command.args(more))?.text;
        let report = printed.find('{').map_or("", |start| &printed[start..]);
        serde_json::from_str(report).with_context(|| format!("the replay of {file} has no report"))
    };
    let same = |what, report: &Value| {
        let (compared, different) = (&report["compared"], &report["different"]);
        Finding {
            what,
            found: format!("{different} of {compared}"),
            goal: "0".to_owned(),
            is_met: *different == 0 && compared.as_u64() > Some(0),
        }
    };
    let (file, seeing) = ("robots/match.toml", "robots/seeing_match.toml");
    record(file, seconds, "match")?;
    let linear = replayed(file, seed, "match", &["--launcher", "linear"])?;
    let pool = replayed(file, seed, "match", &["--launcher", "pool:2"])?;
    let speed = |report: &Value| {
        report["bag_seconds"].as_f64().unwrap_or(0.0) / report["seconds"].as_f64().unwrap_or(f64::INFINITY)
    };
    let mut findings = vec![
        same("different messages, linear", &linear),
        same("different messages, pool:2", &pool),
        at_least("times real time without vision", speed(&linear).max(speed(&pool)), 20.0),
    ];
    let worlds = replayed(file, seed, "match", &["--launcher", "pool:2", "--simulators"])?;
    findings.push(same("different messages, world and referee again", &worlds));
    record(seeing, seconds.min(60), "seeing")?;
    for (what, launcher) in
        [("different pictures, linear", "linear"), ("different pictures, pool:2", "pool:2")]
    {
        let report = replayed(seeing, seed, "seeing", &["--launcher", launcher, "--simulators"])?;
        let topics = report["topics"].as_array().into_iter().flatten();
        let pictures = topics
            .filter(|topic| topic["topic"].as_str().is_some_and(|name| name.ends_with("/camera/image_raw")));
        let [compared, different] = pictures.fold([0, 0], |[compared, different], topic| {
            let count = |key: &str| topic[key].as_u64().unwrap_or(0);
            [compared + count("compared"), different + count("different")]
        });
        findings.push(Finding {
            what,
            found: format!("{different} of {compared}"),
            goal: "0".to_owned(),
            is_met: different == 0 && compared > 0 && report["different"] == 0,
        });
    }
    let other = replayed(seeing, seed + 1, "seeing", &["--simulators"])?;
    findings.push(Finding {
        what: "different messages with another seed",
        found: other["different"].to_string(),
        goal: "some".to_owned(),
        is_met: other["different"].as_u64() > Some(0),
    });
    Ok(findings)
}

/// Plays with the example of the match; each game is a line of JSON.
fn play(options: &[&str]) -> anyhow::Result<Vec<Value>> {
    let example = ["run", "--release", "--package", "downbeat-match", "--example", "play", "--", "--json"];
    let printed = output_of(cargo(&example).args(options))?;
    if !printed.is_success {
        bail!("the example `play` failed");
    }
    let games = printed.text.lines().filter(|line| line.starts_with('{'));
    games.map(|line| serde_json::from_str(line).context("a game is not JSON")).collect()
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO"));
    command.args(arguments);
    command
}

/// The program, with football.
fn downbeat() -> Command {
    let mut command = cargo(&["run", "--release", "--features", "football", "--bin", "downbeat", "--"]);
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command
}

struct Output {
    is_success: bool,
    text: String,
}

/// Runs a command in the workspace, shows what it prints, and returns it.
fn output_of(command: &mut Command) -> anyhow::Result<Output> {
    let name = format!("{command:?}");
    eprintln!("{name}");
    let started = command.current_dir(workspace()).stdout(Stdio::piped()).spawn();
    let mut child = started.with_context(|| format!("cannot run {name}"))?;
    let mut text = String::new();
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).lines() {
            let line = line.with_context(|| format!("cannot read the output of {name}"))?;
            eprintln!("{line}");
            text.push_str(&line);
            text.push('\n');
        }
    }
    let status = child.wait().with_context(|| format!("cannot wait for {name}"))?;
    Ok(Output { is_success: status.success(), text })
}

fn at_least(what: &'static str, found: f64, goal: f64) -> Finding {
    Finding { what, found: format!("{found:.3}"), goal: format!("at least {goal}"), is_met: found >= goal }
}

fn at_most(what: &'static str, found: f64, goal: f64) -> Finding {
    Finding { what, found: format!("{found:.3}"), goal: format!("at most {goal}"), is_met: found <= goal }
}

/// The first number after this text.
fn number_after(text: &str, before: &str) -> anyhow::Result<f64> {
    let (_, rest) = text.split_once(before).with_context(|| format!("\"{before}\" was not printed"))?;
    let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
    let number = rest[..end].trim_end_matches('.');
    number.parse().with_context(|| format!("\"{number}\" after \"{before}\" is not a number"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn numbers_are_found_in_what_the_proofs_print() {
        let line = "median 0.035 m, 95 % 0.125 m; heading: median 0.90, 95 % 2.75 degrees";
        assert_eq!(number_after(line, "95 % ").unwrap(), 0.125);
        assert_eq!(number_after("recall 0.991; ", "recall ").unwrap(), 0.991);
        assert!(number_after(line, "precision ").unwrap_err().to_string().contains("precision"));
        assert!(number_after("recall none", "recall ").is_err());
    }

    #[test]
    fn a_figure_that_is_no_number_misses_its_goal() {
        assert!(!at_least("recall", f64::NAN, 0.95).is_met && !at_most("error", f64::NAN, 0.05).is_met);
        assert!(at_least("recall", 0.95, 0.95).is_met && at_most("error", 0.05, 0.05).is_met);
    }
}
