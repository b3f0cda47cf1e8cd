//! A fleet on Zenoh: robots on two hosts, each host with a router, and a base on a third. One of the hosts is
//! far away, behind a cable that is pulled and gets worse. Network namespaces stand for the hosts, so this
//! needs root.
#![allow(clippy::unwrap_used)]

mod base;
#[path = "../common/mod.rs"]
mod common;
mod heard;
mod robot;
mod router;
mod usage;

use base::Base;
use common::hosts::{Cable, Hosts, Plugged};
use fuzzing::Random;
use robot::Robot;
use router::Router;
use std::fmt::Display;
use std::time::{Duration, Instant};
use usage::Usage;

/// The host behind the cable.
const FAR: usize = 1;
/// The host of the base.
const BASE: usize = 2;

/// A lease of `rmw_zenoh_cpp`, and the time to try again; on a busy machine.
const WATCHDOG: Duration = Duration::from_secs(180);

/// After this long without a word a link is given up.
const LEASE: Duration = Duration::from_secs(60);

const GOOD: Cable = Cable { delay_ms: 1.0, loss: 0.0, mbit_per_s: None };

/// How much is tried.
struct Trial {
    robots: usize,
    joins: usize,
    /// How long the fleet is looked at in each state.
    look: Duration,
    /// How long the cable is out.
    cut: Duration,
    /// Whether it is also out for longer than a lease.
    is_given_up: bool,
    map_bytes: usize,
}

struct Fleet<'a> {
    trial: Trial,
    hosts: &'a Hosts,
    routers: [Option<Router>; 2],
    cable: Option<Plugged>,
    robots: Vec<Option<Robot>>,
    incarnations: u64,
    base: Base,
    random: Random,
}

/// The host of a robot, which is that of its router.
fn host_of(robot: usize) -> usize {
    robot % 2
}

fn is_far(robot: usize) -> bool {
    host_of(robot) == FAR
}

/// A line of the result.
fn note(what: &str, found: impl Display) {
    println!("  {what}: {found}");
}

impl<'a> Fleet<'a> {
    fn begin(hosts: &'a Hosts, trial: Trial) -> Self {
        let cable = Some(hosts.plug(GOOD));
        let routers = [0, FAR].map(|host| Some(Router::start(hosts, host)));
        let base = Base::join(trial.robots);
        let robots = (0..trial.robots).map(|_| None).collect();
        Self { trial, hosts, routers, cable, robots, incarnations: 0, base, random: Random::new(1) }
    }

    fn join(&mut self, robot: usize) {
        let Trial { map_bytes, .. } = self.trial;
        self.incarnations += 1;
        self.robots[robot] =
            Some(Robot::start(self.hosts, host_of(robot), robot, self.incarnations, map_bytes));
    }

    fn running(&self) -> impl Iterator<Item = &Robot> {
        self.robots.iter().flatten()
    }

    /// Waits until the base and each robot see every endpoint, and none that is gone.
    fn wait_until_whole(&self) -> Duration {
        let all = self.running().count() * base::ENDPOINTS;
        let others = all - base::ENDPOINTS;
        let is_whole = || self.base.sees() == all && self.running().all(|robot| robot.sees() == others);
        let seen = || {
            let by_robots: Vec<_> = self.running().map(|robot| (robot.number, robot.sees())).collect();
            format!(
                "of {all} endpoints the base sees {}, of {others} robots see {by_robots:?}",
                self.base.sees()
            )
        };
        wait_until("everybody sees everything", is_whole, seen)
    }

    /// Waits until the base has heard each event of the robots that run.
    fn wait_until_all_is_heard(&self) -> Duration {
        let has_all =
            || self.base.events().missing() == 0 && self.running().all(|robot| self.base.hears(robot));
        wait_until("all events are heard", has_all, || self.base.what_is_missing())
    }

    /// What the base hears in some time, and how old it is then.
    fn look(&self, what: &str) {
        let mut odometry = self.base.odometry();
        odometry.ages(|_| true);
        let missing = odometry.missing();
        drop(odometry);
        std::thread::sleep(self.trial.look);
        let mut odometry = self.base.odometry();
        note(&format!("{what}, odometry lost"), odometry.missing() - missing);
        let ages = odometry.ages(is_far);
        assert!(ages.count() > 0, "nothing comes from the far host");
        note(&format!("{what}, age of odometry from the far host"), ages);
    }

    /// The robots come in a random order.
    fn start(&mut self) {
        let mut waiting: Vec<_> = (0..self.trial.robots).collect();
        while !waiting.is_empty() {
            let next = self.random.below(waiting.len());
            self.join(waiting.swap_remove(next));
        }
        note(
            &format!("{} robots start: until the graph is whole", self.trial.robots),
            seconds(self.wait_until_whole()),
        );
    }

    /// Robots go, in order or not, and come back.
    fn come_and_go(&mut self) {
        let mut longest = Duration::ZERO;
        for join in 1..=self.trial.joins {
            let robot = self.random.below(self.trial.robots);
            let gone = self.robots[robot].take().unwrap();
            if self.random.one_in(2) {
                gone.leave();
            } else {
                drop(gone);
            }
            self.join(robot);
            if join % 5 == 0 || join == self.trial.joins {
                longest = longest.max(self.wait_until_whole());
            }
        }
        note(
            &format!("{} joins: longest until the graph is whole, after each 5", self.trial.joins),
            seconds(longest),
        );
    }

    fn cost(&self) {
        let ids: Vec<_> = self.running().map(Robot::id).collect();
        let routers: Vec<_> = self.routers.iter().flatten().map(Router::id).collect();
        let before = [Usage::of_all(&ids), Usage::of_all(&routers)];
        let began = Instant::now();
        self.look("in peace");
        let wall = began.elapsed();
        for ((name, ids), before) in [("a robot", &ids), ("a router", &routers)].into_iter().zip(before) {
            note(name, Usage::of_all(ids).since(&before, wall));
        }
    }

    /// A router falls over and starts again.
    fn restart(&mut self, host: usize) {
        let began = Instant::now();
        let all = self.base.sees();
        drop(self.routers[host].take());
        wait_until("robots are missed", || self.base.sees() < all, String::new);
        self.routers[host] = Some(Router::start(self.hosts, host));
        self.wait_until_whole();
        let whole = began.elapsed();
        let heard = self.wait_until_all_is_heard();
        let which = if host == FAR { "the far router" } else { "the router of the base" };
        note(&format!("{which} restarts: until the graph is whole"), seconds(whole));
        note(&format!("{which} restarts: until each event is there, from then on"), seconds(heard));
    }

    fn pull_the_cable(&mut self, long: Duration) {
        self.cable = None;
        let out = Instant::now();
        let name = format!("a cable out for {} s", long.as_secs());
        if long > LEASE {
            let near = self.running().filter(|robot| !is_far(robot.number)).count() * base::ENDPOINTS;
            wait_until(
                "the far robots are forgotten",
                || self.base.sees() == near,
                || self.base.sees().to_string(),
            );
            note(&format!("{name}: until the far robots are forgotten"), seconds(out.elapsed()));
            assert!(out.elapsed() < LEASE + LEASE / 4, "ghosts longer than the lease");
        }
        std::thread::sleep(long.saturating_sub(out.elapsed()));
        let mut odometry = self.base.odometry();
        odometry.ages(|_| true);
        let missing = odometry.missing();
        drop(odometry);
        self.cable = Some(self.hosts.plug(GOOD));
        let first = wait_until(
            "the far host is heard again",
            || self.base.odometry().ages(is_far).count() > 0,
            String::new,
        );
        note(&format!("{name}: until the far host is heard again"), seconds(first));
        note(&format!("{name}: until the graph is whole, from then on"), seconds(self.wait_until_whole()));
        note(
            &format!("{name}: until each event is there, from then on"),
            seconds(self.wait_until_all_is_heard()),
        );
        note(&format!("{name}: odometry lost"), self.base.odometry().missing() - missing);
        self.look("after it");
    }

    fn plug(&mut self, cable: Cable) {
        self.cable = None;
        self.cable = Some(self.hosts.plug(cable));
    }

    /// Somebody joins for whom a large message waits behind a narrow line.
    fn fetch_a_map(&self) {
        let far = self.running().find(|robot| is_far(robot.number)).unwrap().number;
        let map = base::a_late_one_gets_the_map(far, WATCHDOG);
        assert_eq!(map.bytes, self.trial.map_bytes);
        note(&format!("a latched message of {} B on 8 Mbit/s", map.bytes), seconds(map.after));
    }

    fn end(mut self) {
        self.wait_until_whole();
        self.wait_until_all_is_heard();
        let (odometry, events) = (self.base.odometry(), self.base.events());
        note("events lost", events.missing());
        note("texts heard twice", odometry.repeated() + events.repeated());
        assert_eq!((events.missing(), odometry.repeated() + events.repeated()), (0, 0));
        drop((odometry, events));
        self.base.tell("go home");
        let told = |robot: &Robot| self.base.has_told(robot.number);
        wait_until("each robot knows the plan", || self.running().all(told), String::new);
        self.robots.iter_mut().filter_map(Option::take).for_each(Robot::leave);
        wait_until("nobody is there", || self.base.sees() == 0, || self.base.sees().to_string());
    }
}

fn wait_until(what: &str, condition: impl Fn() -> bool, state: impl Fn() -> String) -> Duration {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < WATCHDOG, "gave up waiting until {what}: {}", state());
        std::thread::sleep(Duration::from_millis(20));
    }
    began.elapsed()
}

fn seconds(duration: Duration) -> String {
    format!("{:.2} s", duration.as_secs_f64())
}

/// Runs a trial in a process on the host of the base; the test `name` that calls this does nothing else.
fn try_a_fleet(name: &str, trial: Trial) {
    let Some(hosts) = Hosts::around() else {
        if let Some(hosts) = Hosts::with_a_far_one(3) {
            hosts.run_again(BASE, name);
        }
        return;
    };
    let Trial { look, cut, is_given_up, .. } = trial;
    let mut fleet = Fleet::begin(&hosts, trial);
    fleet.start();
    fleet.come_and_go();
    fleet.wait_until_all_is_heard();
    fleet.cost();
    fleet.restart(FAR);
    fleet.restart(0);
    fleet.pull_the_cable(cut);
    if is_given_up {
        fleet.pull_the_cable(LEASE + look);
    }
    fleet.plug(Cable { delay_ms: 50.0, loss: 0.02, mbit_per_s: None });
    fleet.look("on a line with 50 ms and 2 % loss");
    fleet.plug(Cable { mbit_per_s: Some(8.0), ..GOOD });
    fleet.fetch_a_map();
    fleet.look("on a line with 8 Mbit/s");
    fleet.end();
}

#[test]
fn a_small_fleet_stays_together() {
    let trial = Trial {
        robots: 6,
        joins: 10,
        look: Duration::from_secs(3),
        cut: Duration::from_secs(5),
        is_given_up: false,
        map_bytes: 1_000_000,
    };
    try_a_fleet("a_small_fleet_stays_together", trial);
}

#[test]
#[ignore = "takes long; cargo xtask fleet runs it"]
fn fifty_robots_stay_together() {
    let trial = Trial {
        robots: 50,
        joins: 200,
        look: Duration::from_secs(30),
        cut: Duration::from_secs(30),
        is_given_up: true,
        map_bytes: 1_000_000,
    };
    try_a_fleet("fifty_robots_stay_together", trial);
}
