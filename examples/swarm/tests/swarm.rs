//! The swarm gathers and splits whatever the synchrony, gives the same result under every launcher, and
//! repeats from bags.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use downbeat::TestResult;
use downbeat::bags::Reader;
use downbeat::executor::{Inbox, Received};
use downbeat::replay::{ReplayOptions, replay};
use downbeat::running::{PreparedRobot, RecordPlan};
use swarm::{Light, Overview};
use tempfile::TempDir;

const LAUNCHERS: [&str; 3] =
    ["launcher = \"linear\"", "launcher = \"pool\"\nthreads = 3", "launcher = \"threads\""];

/// Simulated time in which every swarm of these tests has long split.
const RUN: Duration = Duration::from_secs(20);

/// Generous: the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(120);

/// A robot file in a scratch folder: this many robots, of these kinds in turn.
struct Swarm<'a> {
    kinds: &'a [&'a str],
    robots: usize,
    seed: i64,
    launcher: &'a str,
}

impl Swarm<'_> {
    fn write(&self, folder: &Path) -> PathBuf {
        let Self { kinds, robots, seed, launcher } = self;
        let mut text = format!(
            "[robot]\nname = \"swarm\"\n{launcher}\n[record]\ntopics = \"all\"\n\
             [[module]]\nkind = \"arena\"\nsettings = {{ robots = {robots}, seed = {seed} }}\n"
        );
        for (robot, kind) in (0..*robots).zip(kinds.iter().cycle()) {
            text += &format!(
                "[[module]]\nname = \"robot_{robot:02}\"\nkind = \"{kind}\"\nsettings = {{ seed = {seed} }}\n"
            );
        }
        let path = folder.join(format!("swarm_{seed}.toml"));
        std::fs::write(&path, text).unwrap();
        path
    }

    /// What the arena sees in a run in simulated time.
    fn run(&self) -> Vec<Arc<Overview>> {
        let folder = TempDir::new().unwrap();
        let file = swarm::app().robot_file(self.write(folder.path())).unwrap();
        let mut prepared = PreparedRobot::simulated(file, Some(RUN)).unwrap();
        let overviews = watch(&mut prepared);
        let running = prepared.start().unwrap();
        let watchdog = Instant::now() + PATIENCE;
        while !running.is_finished() {
            assert!(Instant::now() < watchdog, "the run has not ended");
            std::thread::yield_now();
        }
        running.stop().unwrap();
        overviews.try_iter().collect()
    }
}

/// Passes on the overviews of a robot that is about to start.
fn watch(prepared: &mut PreparedRobot) -> Receiver<Arc<Overview>> {
    let (sender, overviews) = channel();
    let pass = move |overview: Received<'_, Overview>| drop(sender.send(Arc::new(overview.clone())));
    prepared.core().outlet("overview", Inbox::KeepAll, pass).unwrap().keep();
    overviews
}

/// Asserts that the robots came together, and then stood in two groups of equal size, apart from each other.
fn assert_gathered_and_split<'a>(overviews: impl IntoIterator<Item = &'a Arc<Overview>>, robots: u32) {
    let overviews: Vec<_> = overviews.into_iter().collect();
    let (first, last) = (overviews[0], overviews[overviews.len() - 1]);
    let positions_of = |overview: &Overview, light| -> Vec<(f64, f64)> {
        let poses = overview.poses.iter().zip(&overview.lights).filter(|(_, shown)| **shown == light);
        poses.map(|(pose, _)| (pose.x, pose.y)).collect()
    };
    let distance =
        |one: (f64, f64), other: (f64, f64)| ((one.0 - other.0).powi(2) + (one.1 - other.1).powi(2)).sqrt();

    // Measured here from the poses, not taken from the arena.
    let widest = |overview: &Overview| {
        let all: Vec<_> = (0..=2).flat_map(|light| positions_of(overview, light)).collect();
        all.iter().flat_map(|one| all.iter().map(|other| distance(*one, *other))).fold(0.0, f64::max)
    };
    assert!(widest(first) > 0.9, "they start scattered: {}", widest(first));
    let together = overviews.iter().find(|overview| overview.have_gathered).expect("they gather");
    assert!(widest(together) < 0.3, "{}", widest(together));
    let early = overviews.iter().find(|overview| overview.sizes[0] < robots).expect("they decide");
    assert!(widest(early) < 0.6, "the first decides before the others have come: {}", widest(early));

    let (red, blue) = (positions_of(last, Light::RED), positions_of(last, Light::BLUE));
    assert_eq!([red.len(), blue.len()], [robots.div_ceil(2) as usize, robots as usize / 2], "balanced");
    assert_eq!(last.sizes, [0, red.len() as u32, blue.len() as u32]);
    for group in [&red, &blue] {
        let width = group.iter().flat_map(|one| group.iter().map(|other| distance(*one, *other)));
        assert!(width.clone().fold(0.0, f64::max) < 0.3, "a group is {} m wide", width.fold(0.0, f64::max));
    }
    let gap = red.iter().flat_map(|one| blue.iter().map(|other| distance(*one, *other)));
    assert!(gap.fold(f64::MAX, f64::min) > 0.6 && last.have_split, "{last:?}");
}

fn same_under_every_launcher(kinds: &[&str]) {
    let [linear, pool, threads] =
        LAUNCHERS.map(|launcher| Swarm { kinds, robots: 50, seed: 1, launcher }.run());
    assert!(linear.len() >= 199, "10 overviews a second, not {} in 20 s", linear.len());
    assert_gathered_and_split(&linear, 50);
    assert!(linear == pool && linear == threads, "the launchers give different results");
    let other = Swarm { kinds, robots: 50, seed: 2, launcher: LAUNCHERS[0] }.run();
    assert!(linear != other, "the seed has no effect");
}

#[test]
fn robots_that_act_in_every_cycle_do_the_same_under_every_launcher() {
    same_under_every_launcher(&["in_step"]);
}

#[test]
fn robots_that_act_by_timers_do_the_same_under_every_launcher() {
    same_under_every_launcher(&["by_timer"]);
}

#[test]
fn robots_of_both_kinds_do_the_same_under_every_launcher() {
    same_under_every_launcher(&["in_step", "by_timer"]);
}

#[test]
fn even_and_odd_swarms_split_evenly_for_every_seed() {
    for (seed, robots) in [(1, 50), (2, 49), (3, 2), (4, 31), (5, 50), (6, 50)] {
        for kinds in [&["in_step"][..], &["by_timer"], &["at_random"], &["in_step", "by_timer", "at_random"]]
        {
            let swarm = Swarm { kinds, robots, seed, launcher: LAUNCHERS[0] };
            assert_gathered_and_split(&swarm.run(), robots as u32);
        }
    }
}

/// Records a run in real time, in which detached robots have threads of their own, and replays it.
fn repeats_from_its_bag(kinds: &[&str], detached: usize) -> TestResult {
    let folder = TempDir::new()?;
    let swarm = Swarm { kinds, robots: 50, seed: 1, launcher: LAUNCHERS[0] };
    let (path, bag) = (swarm.write(folder.path()), folder.path().join("run"));
    let mut prepared = PreparedRobot::new(swarm::app().robot_file(&path)?)?;
    let received = watch(&mut prepared);
    let plan = RecordPlan::of_robot(&bag, prepared.file(), None);
    prepared.record(plan)?;
    let running = prepared.start()?;
    let watchdog = Instant::now() + PATIENCE;
    let mut overviews = Vec::new();
    while !overviews.last().is_some_and(|last: &Arc<Overview>| last.have_split && last.gap > 0.7) {
        let left = watchdog.saturating_duration_since(Instant::now());
        overviews.push(received.recv_timeout(left)?);
    }
    let summary = running.stop()?.expect("it was recorded");
    assert_eq!(summary.lost_count(), 0);
    assert_gathered_and_split(&overviews, 50);

    let report = swarm::app().replay(&path, &bag)?;
    assert_eq!(report.detached.len(), detached);
    assert!(report.detached.iter().all(|(_, runs)| *runs > 20), "{report}");
    assert!(report.compared() > 50 * 2 * 20, "{report}");
    report.assert_same()?;

    // Another seed in the file changes nothing: a replay uses the recorded settings.
    let file = swarm::app().robot_file(Swarm { seed: 2, ..swarm }.write(folder.path()))?;
    let (reader, options) = (Reader::open(&bag)?, ReplayOptions::of(&file));
    let report = replay(file, &reader, &options)?;
    assert_eq!(report.changed_settings.len(), 51, "{report}");
    report.assert_same()?;
    // Robots that choose differently are found out.
    let mut other = swarm::app().robot_file(&path)?;
    let names: Vec<String> = other.modules.iter().map(|module| module.name.clone()).collect();
    names.iter().try_for_each(|name| other.set_from_argument(&format!("{name}.seed:=2")))?;
    assert!(replay(other, &reader, &options)?.different() > 0);
    Ok(())
}

#[test]
fn detached_robots_repeat_from_a_bag() -> TestResult {
    repeats_from_its_bag(&["at_random"], 50)
}

#[test]
fn a_swarm_of_all_kinds_repeats_from_a_bag() -> TestResult {
    repeats_from_its_bag(&["in_step", "by_timer", "at_random"], 16)
}
