//! Diagnostics of a process.
#![allow(clippy::unwrap_used)]

use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Exposure, expose};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Core, ManualClock, Module, Received, Setup, SetupError, Time};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

/// Panics after a second.
struct Fragile;

impl Module for Fragile {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.every(Duration::from_millis(1050), |_, _| panic!("on purpose"))
    }
}

struct Listener(Sender<DiagnosticArray>);

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("diagnostics", |listener: &mut Self, array: Received<'_, DiagnosticArray>, _| {
            listener.0.send(array.clone()).unwrap();
        })
    }
}

#[test]
fn once_a_second_modules_endpoints_and_what_else_is_watched_are_told_with_their_levels() {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    let diagnostics = ProcessDiagnostics::add(&mut core, "robot").unwrap();
    core.add("fragile", Fragile).unwrap();
    let (sender, arrays) = channel();
    core.add("listener", Listener(sender)).unwrap();
    let participant = Participant::on(Arc::new(Hub::new().join())).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let kind = Interfaces::carried().message("diagnostic_msgs/msg/DiagnosticArray").unwrap();
    let exposure = Exposure::new("diagnostics", kind, Direction::Out);
    diagnostics.watch_endpoints(expose(&mut core, &node, &[exposure]).unwrap());
    diagnostics
        .watch(|| vec![DiagnosticStatus { name: "robot: disk".into(), ..DiagnosticStatus::default() }]);
    for _ in 0..250 {
        core.cycle().unwrap();
        clock.advance(Duration::from_millis(10));
    }
    let arrays: Vec<_> = arrays.try_iter().collect();
    assert_eq!(arrays.len(), 2, "one a second");
    let of = |array: &DiagnosticArray, name: &str| {
        let status = array.status.iter().find(|status| status.name == name);
        status.map(|status| (status.level, status.message.clone())).unwrap()
    };
    assert_eq!(of(&arrays[0], "robot: module fragile"), (DiagnosticStatus::OK, "running".into()));
    assert_eq!(
        of(&arrays[1], "robot: module fragile"),
        (DiagnosticStatus::ERROR, "stopped by a panic".into())
    );
    assert_eq!(of(&arrays[1], "robot: core"), (DiagnosticStatus::OK, "running".into()));
    assert_eq!(of(&arrays[1], "robot: /diagnostics"), (DiagnosticStatus::OK, "0 subscriptions".into()));
    assert_eq!(of(&arrays[1], "robot: disk").0, DiagnosticStatus::OK);
    assert!(arrays[1].header.stamp.as_nanos() >= 2_000_000_000);
}
