//! Runs a control loop at 125 Hz while another process sends hostile datagrams to every port of the
//! participant, and compares it with the same load on a socket that only drops what it receives. Afterwards
//! rclpy still receives what the loop publishes.

use std::net::{Ipv4Addr, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::Core;
use downbeat_msgs::qos::QosProfile;
use fuzzing::Random;

use crate::contestant::{Contestant, Kind, Task};
use crate::control_loop::{ControlLoop, Times, cells};
use crate::peer::{Running, on_this_machine};
use crate::role::Role;

#[path = "../../../bridge/rtps/tests/golden/capture.rs"]
mod capture;
#[path = "../../../bridge/rtps/tests/hostile/mutation.rs"]
mod mutation;

#[derive(clap::Args)]
pub struct Options {
    /// How long each part lasts.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
}

#[derive(clap::Args)]
pub struct AttackerOptions {
    /// The UDP ports that are attacked.
    #[arg(long, value_delimiter = ',')]
    ports: Vec<u16>,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    let part = Duration::from_secs_f64(options.seconds);
    let task = Task { size: 100, window: 1, seconds: 0.0, domain_id: options.domain };
    let participant = Participant::join(&on_this_machine(options.domain)?)?;
    let node = participant.create_node(NodeName::new("/", "downbeat_loop")?)?;
    let lateness = Times::default();
    let mut core = Core::new();
    core.add("loop", ControlLoop::new(&lateness))?;
    let running = Running::start_with(core, &node, &[("ping", Direction::Out)], QosProfile::DEFAULT)?;
    println!("| the loop of 8 ms begins late by | p50 | p99 | max |\n| --- | --- | --- | --- |");
    print("undisturbed", &lateness.of(part));

    let sink = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let attacker = Attacker::start(&[sink.local_addr()?.port()])?;
    std::thread::spawn(move || {
        // The thread ends with the process.
        let mut buffer = [0; 65_536];
        while sink.recv(&mut buffer).is_ok() {}
    });
    print("a socket that drops them", &lateness.of(part));
    drop(attacker);

    let base = 7400 + 250 * options.domain;
    let attacker = Attacker::start(&[base, base + 10, base + 11])?;
    print("hostile datagrams to the participant", &lateness.of(part));
    drop(attacker);

    let mut counter = Contestant::start(Kind::Rclpy, Role::Count, &task)?;
    let start = Instant::now();
    running.wait_for_peer(Duration::from_secs(20))?;
    println!("\nAfterwards rclpy, started then, is matched after {:.1} s;", start.elapsed().as_secs_f64());
    std::thread::sleep(Duration::from_secs(2));
    running.stop()?;
    println!("it received {} messages in 2 s.", counter.count()?);
    counter.end()
}

fn print(what: &str, times: &[Duration]) {
    println!("| {what} | {} |", cells(times));
}

/// A process that sends as fast as it can; killed when dropped.
struct Attacker(Child);

impl Attacker {
    fn start(ports: &[u16]) -> anyhow::Result<Self> {
        let ports: Vec<_> = ports.iter().map(u16::to_string).collect();
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["attacker", "--ports", &ports.join(",")]).stdin(Stdio::null());
        Ok(Self(command.spawn()?))
    }
}

impl Drop for Attacker {
    fn drop(&mut self) {
        // Fails only if the process has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Sends recorded datagrams of Fast DDS and Cyclone DDS, changed at random, until it is killed.
pub fn attack(options: &AttackerOptions) -> anyhow::Result<()> {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let recorded = [capture::fast_dds(), capture::cyclone_dds()].concat();
    for round in 0.. {
        let mut random = Random::new(round);
        let mut datagram = random.choose(&recorded).to_vec();
        mutation::mutate(&mut datagram, &mut random);
        // Fails if the buffer is full or the changed datagram is too long.
        let _ = socket.send_to(&datagram, (Ipv4Addr::LOCALHOST, *random.choose(&options.ports)));
    }
    Ok(())
}
