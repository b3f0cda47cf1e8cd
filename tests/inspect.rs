//! Inspection of a robot with known answers through its socket.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use downbeat::edge::Interfaces;
use downbeat::executor::{Core, CoreHandle, CycleTrace, Graph, GraphModule, Snapshot};
use downbeat::inspect::{
    Client, Inspected, InspectionServer, RunningRobot, SocketDirectory, Unavailable, Watch,
};
use downbeat::msgs::sensor_msgs::msg::JointState;

/// Counts cycles: one for each snapshot, none while it is paused.
#[derive(Default)]
struct Robot {
    cycle: AtomicU64,
    is_paused: std::sync::atomic::AtomicBool,
}

impl Inspected for Robot {
    fn snapshot(&self) -> Result<Snapshot, Unavailable> {
        let is_paused = self.is_paused.load(Ordering::SeqCst);
        if !is_paused {
            self.step();
        }
        Ok(Snapshot { cycle: self.cycle.load(Ordering::SeqCst), is_paused, ..Snapshot::default() })
    }

    fn trace(&self, _cycles: u32) -> Result<CycleTrace, Unavailable> {
        Err(Unavailable::NoAnswer)
    }

    fn graph(&self) -> Result<Graph, Unavailable> {
        let module = GraphModule { name: "a \"quoted\" name".into(), is_detached: true };
        Ok(Graph { modules: vec![module], ..Graph::default() })
    }

    fn pause(&self) {
        self.is_paused.store(true, Ordering::SeqCst);
    }

    fn resume(&self) {
        self.is_paused.store(false, Ordering::SeqCst);
    }

    fn step(&self) {
        self.cycle.fetch_add(1, Ordering::SeqCst);
    }
}

/// A core whose topics can be watched.
struct WatchedCore(CoreHandle);

impl Inspected for WatchedCore {
    fn snapshot(&self) -> Result<Snapshot, Unavailable> {
        Inspected::snapshot(&self.0)
    }

    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable> {
        Inspected::trace(&self.0, cycles)
    }

    fn graph(&self) -> Result<Graph, Unavailable> {
        Inspected::graph(&self.0)
    }

    fn pause(&self) {
        self.0.pause();
    }

    fn resume(&self) {
        self.0.resume();
    }

    fn step(&self) {
        self.0.step();
    }

    fn watch(&self) -> Result<Watch, String> {
        Ok(Watch::new(self.0.clone(), Interfaces::carried()))
    }
}

fn start(folder: &Path) -> (SocketDirectory, InspectionServer, RunningRobot) {
    let directory = SocketDirectory::open_at(folder.join("sockets")).unwrap();
    let server = InspectionServer::start(&directory, "darwin_op", Arc::new(Robot::default())).unwrap();
    let robots = directory.running().unwrap();
    assert_eq!(robots.len(), 1);
    (directory, server, robots[0].clone())
}

#[test]
fn a_client_inspects_pauses_and_steps_a_robot() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    assert_eq!((robot.name.as_str(), robot.pid), ("darwin_op", std::process::id()));
    let mut client = Client::connect(&robot).unwrap();
    assert_eq!(client.snapshot().unwrap().cycle, 1);
    client.pause().unwrap();
    client.step().unwrap();
    let held = client.snapshot().unwrap();
    assert!(held.is_paused && held.cycle == 2, "{held:?}");
    client.resume().unwrap();
    assert_eq!(client.snapshot().unwrap().cycle, 3);
    assert_eq!(client.graph().unwrap().modules[0].name, "a \"quoted\" name");
}

#[test]
fn two_robots_with_one_name_in_a_process_are_inspected_and_end() {
    let folder = tempfile::tempdir().unwrap();
    let (directory, first, _) = start(folder.path());
    let second = InspectionServer::start(&directory, "darwin_op", Arc::new(Robot::default())).unwrap();
    let robots = directory.running().unwrap();
    assert_eq!(robots.iter().map(|robot| &*robot.name).collect::<Vec<_>>(), ["darwin_op", "darwin_op.2"]);
    for robot in &robots {
        assert_eq!(Client::connect(robot).unwrap().snapshot().unwrap().cycle, 1);
    }
    drop(first);
    assert_eq!(directory.running().unwrap()[0].name, "darwin_op.2");
    drop(second);
    assert!(directory.running().unwrap().is_empty());
}

#[test]
fn a_refusal_reaches_the_client_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    let mut client = Client::connect(&robot).unwrap();
    let error = client.trace(3).unwrap_err().to_string();
    assert!(error.contains("darwin_op") && error.contains("does not answer"), "{error}");
    for cycles in [0, 4_000_000_000] {
        let error = client.trace(cycles).unwrap_err().to_string();
        assert!(error.contains("1 to 100000"), "{error}");
    }
    assert_eq!(client.snapshot().unwrap().cycle, 1);
}

#[test]
fn an_invalid_request_is_reported_and_the_next_line_is_answered() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    let mut stream = UnixStream::connect(&robot.socket).unwrap();
    stream.write_all(b"hello\n\xff\n\n{\"request\":\"snapshot\"}\n").unwrap();
    let lines: Vec<_> = BufReader::new(&stream).lines().take(4).map(Result::unwrap).collect();
    assert!(lines[0].starts_with("{\"error\":\"\\\"hello\\\" is not a request"), "{lines:?}");
    assert!(lines[1].starts_with("{\"error\"") && lines[2].starts_with("{\"error\""), "{lines:?}");
    assert!(lines[3].starts_with("{\"ok\":{\"time_ns\":0"), "{lines:?}");
}

#[test]
fn a_line_without_end_is_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    let mut stream = UnixStream::connect(&robot.socket).unwrap();
    // The other side may close the connection before everything is written.
    let _ = stream.write_all(&[b'x'; 4096]);
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.contains("fewer than 4096 bytes"), "{answer}");
}

#[test]
fn one_client_too_many_is_refused_and_there_is_room_when_another_leaves() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    let clients: Vec<_> = (0..16).map(|_| once_there_is_room(&robot)).collect();
    let refused = Client::connect(&robot).unwrap().snapshot().unwrap_err();
    assert!(refused.to_string().contains("16 clients"), "{refused}");
    let mut one_more = String::new();
    UnixStream::connect(&robot.socket).unwrap().read_to_string(&mut one_more).unwrap();
    assert!(one_more.contains("16 clients"), "{one_more}");
    drop(clients);
    once_there_is_room(&robot);
}

/// Connects once the server has noticed that another client has disconnected. Searching for the robot also
/// connects.
fn once_there_is_room(robot: &RunningRobot) -> Client {
    loop {
        let mut client = Client::connect(robot).unwrap();
        if client.snapshot().is_ok() {
            return client;
        }
        std::thread::yield_now();
    }
}

#[test]
fn stopping_a_robot_removes_its_socket_and_disconnects_clients() {
    let folder = tempfile::tempdir().unwrap();
    let (directory, server, robot) = start(folder.path());
    let mut client = Client::connect(&robot).unwrap();
    client.snapshot().unwrap();
    drop(server);
    assert!(!robot.socket.exists());
    assert_eq!(directory.running().unwrap(), []);
    let error = client.snapshot().unwrap_err().to_string();
    assert!(error.contains("it may have ended"), "{error}");
}

#[test]
fn a_client_reads_the_values_of_a_topic_while_it_watches_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut core = Core::new();
    let inlet = core.inlet::<JointState>("joint_states").unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let directory = SocketDirectory::open_at(folder.path().join("sockets")).unwrap();
    let watched = Arc::new(WatchedCore(handle.clone()));
    let _server = InspectionServer::start(&directory, "darwin_op", watched).unwrap();
    let robot = &directory.running().unwrap()[0];
    let [mut client, mut other] = [(); 2].map(|()| Client::connect(robot).unwrap());

    let fields = ["position[head_tilt]", "position[0]", "velocity[0]"].map(str::to_owned);
    client.watch("/joint_states", &fields).unwrap();
    assert_eq!(other.snapshot().unwrap().outlets.len(), 1);
    assert_eq!(client.numbers("joint_states").unwrap(), None, "there was no message yet");
    for n in 0..5 {
        let name = ["head_pan", "head_tilt"].map(str::to_owned).to_vec();
        let position = vec![f64::from(n), f64::from(n) / 8.0];
        inlet.publish(JointState { name, position, ..JointState::default() }).unwrap();
    }
    let mut read: [Vec<f64>; 3] = Default::default();
    let mut times = Vec::new();
    let mut problem = None;
    common::wait_until("all values are read", || {
        let topics = client.values().unwrap();
        assert_eq!((topics.len(), topics[0].topic.as_str(), topics[0].missed), (1, "joint_states", 0));
        for (values, field) in read.iter_mut().zip(&topics[0].fields) {
            values.extend(&field.series.values);
            problem.clone_from(&field.problem);
        }
        times.extend(topics[0].fields[0].series.times.clone());
        read[0].len() == 5
    });
    assert_eq!(read, [vec![0.0, 0.125, 0.25, 0.375, 0.5], vec![0.0, 1.0, 2.0, 3.0, 4.0], vec![]]);
    assert_eq!(problem.as_deref(), Some("there is no element 0, there are 0, counted from 0"));
    assert!(times.len() == 5 && times.is_sorted() && times[0] > 1.6e9, "{times:?}");
    let numbers = client.numbers("joint_states").unwrap().unwrap();
    assert_eq!(
        (numbers[3].field.as_str(), numbers[3].element.as_deref()),
        ("position[1]", Some("head_tilt"))
    );

    for (topic, field, expected) in [
        ("joint_state", "position[0]", "no topic \"joint_state\", did you mean \"joint_states\"?"),
        ("joint_states", "positon[0]", "joint_states has no number at positon[0]: "),
        ("joint_states", "positon[0]", "did you mean `position`?"),
        ("joint_states", "header.frame_id", "it is text"),
    ] {
        let error = client.watch(topic, &[field.to_owned()]).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert_eq!(client.values().unwrap()[0].fields.len(), 3, "what was watched before stays");
    assert_eq!(other.values().unwrap(), [], "each client has its own watch");
    assert!(other.numbers("joint_states").unwrap_err().to_string().contains("is not watched"));

    drop(client);
    common::wait_until("the outlet is gone", || other.snapshot().unwrap().outlets.is_empty());
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn a_robot_without_a_watch_refuses_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_directory, _server, robot) = start(folder.path());
    let mut client = Client::connect(&robot).unwrap();
    let error = client.watch("joint_states", &[]).unwrap_err().to_string();
    assert!(error.contains("cannot be watched"), "{error}");
    assert_eq!(client.values().unwrap(), []);
    client.unwatch("joint_states").unwrap();
}
