//! A robot of the fleet, in a process of its own: four modules on the router of its host.

use super::heard::said;
use crate::common::RunningCore;
use crate::common::hosts::Hosts;
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Exposure, ServiceExposure, expose, expose_services};
use downbeat_bridge::middleware::{Direction, ParticipantOptions, RemoteEndpoint};
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Received, Setup, SetupError};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{TriggerRequest, TriggerResponse};
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStdin, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

const NUMBER: &str = "DOWNBEAT_FLEET_ROBOT";
const INCARNATION: &str = "DOWNBEAT_FLEET_INCARNATION";
const MAP_BYTES: &str = "DOWNBEAT_FLEET_MAP_BYTES";

/// The topic with orders for all robots.
pub const PLAN: &str = "/fleet/plan";

/// For events, and a map: what a robot said last week counts as well.
pub fn latched(depth: u32) -> QosProfile {
    QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT }.keep_last(depth)
}

/// More than a robot says while its link is out.
pub const EVENTS: u32 = 500;

/// Says a numbered text at every period.
struct Speaker {
    topic: &'static str,
    period: Duration,
    said: u64,
    incarnation: String,
}

impl Module for Speaker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let topic = setup.publish::<Text>(self.topic)?;
        setup.every(self.period, move |speaker: &mut Self, ctx| {
            speaker.said += 1;
            ctx.publish(topic, Text { data: said(&speaker.incarnation, speaker.said) });
        })
    }
}

/// Says once what the surroundings look like.
struct Mapper {
    bytes: usize,
    is_known: bool,
}

impl Module for Mapper {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let map = setup.publish::<Text>("map")?;
        setup.every(Duration::from_millis(500), move |mapper: &mut Self, ctx| {
            if !std::mem::replace(&mut mapper.is_known, true) {
                ctx.publish(map, Text { data: "#".repeat(mapper.bytes) });
            }
        })
    }
}

/// Publishes each order that it receives on `told`, and answers the service `identify`.
struct Driver;

impl Module for Driver {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<TriggerRequest, TriggerResponse, _>("identify", |_, _, _| {
            Ok(TriggerResponse { success: true, message: "here".into() })
        })?;
        let told = setup.publish::<Text>("told")?;
        setup.subscribe("plan", move |_: &mut Self, plan: Received<'_, Text>, ctx: &mut Context<'_>| {
            ctx.publish(told, Text { data: plan.data.clone() });
        })
    }
}

#[test]
#[ignore = "a process that other tests start"]
fn a_robot_runs_until_its_input_ends() {
    let variable = |name| std::env::var(name).unwrap();
    let options = ParticipantOptions::from_env().unwrap();
    let participant = Participant::join(&options).unwrap();
    let namespace = format!("/robot_{}", variable(NUMBER));
    let node = participant.create_node(NodeName::new(&namespace, "downbeat").unwrap()).unwrap();

    let mut core = Core::new();
    for (topic, ms) in [("odometry", 200), ("events", 1000)] {
        let (period, incarnation) = (Duration::from_millis(ms), variable(INCARNATION));
        core.add(topic, Speaker { topic, period, said: 0, incarnation }).unwrap();
    }
    core.add("mapper", Mapper { bytes: variable(MAP_BYTES).parse().unwrap(), is_known: false }).unwrap();
    core.add("driver", Driver).unwrap();
    let text = Interfaces::carried().message("std_msgs/msg/String").unwrap();
    let out = |topic: &str| Exposure::new(topic, text, Direction::Out);
    let exposed = [
        out("odometry"),
        Exposure { qos: latched(EVENTS).into(), ..out("events") },
        Exposure { qos: latched(1).into(), ..out("map") },
        out("told"),
        Exposure { ros_topic: Some(PLAN.into()), ..Exposure::new("plan", text, Direction::In) },
    ];
    expose(&mut core, &node, &exposed).unwrap();
    let identify = ServiceExposure {
        service: "identify".into(),
        ros_service: None,
        service_type: Interfaces::carried().service("std_srvs/srv/Trigger").unwrap(),
        timeout: Duration::from_secs(5),
        network: None,
    };
    expose_services(&mut core, &node, &[identify], &[]).unwrap();
    let _running = RunningCore::start(core);

    let observer = participant.clone();
    std::thread::spawn(move || {
        let mut before = usize::MAX;
        loop {
            let now = of_robots(&observer.remote_endpoints());
            if now != before {
                println!("{SEES}{now}");
                before = now;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    std::io::stdin().lock().read_to_end(&mut Vec::new()).unwrap();
}

const SEES: &str = "endpoints: ";

/// The number of endpoints of robots.
pub fn of_robots(endpoints: &[RemoteEndpoint]) -> usize {
    let is_of_robot = |endpoint: &&RemoteEndpoint| {
        endpoint.node.as_ref().is_some_and(|node| node.name.starts_with("/robot_"))
    };
    endpoints.iter().filter(is_of_robot).count()
}

/// The process of a robot.
pub struct Robot {
    pub number: usize,
    pub incarnation: String,
    process: Child,
    input: Option<ChildStdin>,
    sees: Arc<AtomicUsize>,
}

impl Robot {
    pub fn start(hosts: &Hosts, host: usize, number: usize, incarnation: u64, map_bytes: usize) -> Self {
        let incarnation = format!("{number}.{incarnation}");
        let mut command = hosts.command(host, std::env::current_exe().unwrap());
        // More threads than one: the name of the test is then printed after what the test prints.
        let test = "robot::a_robot_runs_until_its_input_ends";
        command.args(["--exact", test, "--ignored", "--nocapture", "--test-threads=2"]);
        command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env_remove("ZENOH_CONFIG_OVERRIDE");
        command.env(NUMBER, number.to_string()).env(INCARNATION, &incarnation);
        command.env(MAP_BYTES, map_bytes.to_string());
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let input = process.stdin.take();
        let sees = Arc::<AtomicUsize>::default();
        let (output, seen) = (BufReader::new(process.stdout.take().unwrap()), Arc::clone(&sees));
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                if let Some(number) = line.strip_prefix(SEES) {
                    seen.store(number.parse().unwrap(), Ordering::Relaxed);
                }
            }
        });
        Self { number, incarnation, process, input, sees }
    }

    /// How many endpoints of other robots it has seen.
    pub fn sees(&self) -> usize {
        self.sees.load(Ordering::Relaxed)
    }

    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// Lets it leave in order.
    pub fn leave(mut self) {
        self.input = None;
        assert!(self.process.wait().unwrap().success(), "robot {} fails", self.number);
    }
}

/// A robot that falls down the stairs.
impl Drop for Robot {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
