//! Inspection of a robot with known answers through its socket.
#![allow(clippy::unwrap_used, missing_docs)]

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use downbeat::executor::{CycleTrace, Graph, GraphModule, Snapshot};
use downbeat::inspect::{Client, Inspected, InspectionServer, RunningRobot, SocketDirectory, Unavailable};

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
