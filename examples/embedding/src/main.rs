//! Two robots inside a program that has its own `main`, and messages between them and the program.

use std::path::PathBuf;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use downbeat::executor::{Context, Inbox, Module, Publication, Received, Setup, SetupError};
use downbeat::msgs::std_msgs::msg::Float64;
use downbeat::running::{PreparedRobot, RecordPlan};
use downbeat::{App, Failure};

/// A simulated axis: it moves towards its goal by at most 0.05 m every 10 ms.
#[derive(Default)]
struct Axis {
    goal: f64,
    position: f64,
}

struct AxisPorts {
    position: Publication<Float64>,
}

impl Module for Axis {
    type Ports = AxisPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<AxisPorts, SetupError> {
        setup.subscribe::<Float64, _>("goal", |axis, goal, _| axis.goal = goal.data)?;
        setup.every(Duration::from_millis(10), Self::tick)?;
        Ok(AxisPorts { position: setup.publish("position")? })
    }
}

impl Axis {
    fn tick(&mut self, ctx: &mut Context<'_, AxisPorts>) {
        self.position += (self.goal - self.position).clamp(-0.05, 0.05);
        ctx.publish(ctx.ports.position, Float64 { data: self.position });
    }
}

/// Generous: the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

fn main() -> Result<(), Failure> {
    let app = App::new().kind("axis", "an axis (computed)", Axis::default);

    // Starts the whole robot with one call: its core on a thread and its node in ROS 2.
    let follower = app.start("follower.toml")?;

    // Step by step: here without a node, and with an inlet, an outlet, and a recording.
    let mut leader = PreparedRobot::new(app.robot_file("leader.toml")?)?;
    let leader_goal = leader.core().inlet("goal")?;
    let (sender, leader_positions) = channel();
    let leader_outlet = leader.core().outlet("position", Inbox::KeepAll, pass_to(sender))?;
    let plan = RecordPlan::of_robot(&new_folder("leader_run"), leader.file(), None);
    leader.record(plan)?;
    let leader = leader.start()?;

    // A handle does the same while a robot runs; the answer comes with the next cycle.
    let follower_goal = follower.core().inlet("goal").wait(PATIENCE).ok_or(NoAnswer)??;
    let (sender, follower_positions) = channel();
    let follower_outlet = follower.core().outlet("position", Inbox::KeepAll, pass_to(sender));
    let follower_outlet = follower_outlet.wait(PATIENCE).ok_or(NoAnswer)??;

    // The program connects the robots: it sends the position of one to the other.
    leader_goal.publish(Float64 { data: 1.0 })?;
    for position in &leader_positions {
        follower_goal.publish(Float64 { data: position })?;
        if position >= 1.0 {
            println!("the leader has arrived");
            break;
        }
    }
    if follower_positions.iter().any(|position| position >= 1.0) {
        println!("the follower has arrived");
    }

    // No more messages are taken out of the cores.
    drop((leader_outlet, follower_outlet));
    follower.stop()?;
    if let Some(bag) = leader.stop()? {
        println!("{} has {} messages", bag.path.display(), bag.message_count());
    }
    Ok(())
}

/// The first name that is free: a recording replaces no other.
fn new_folder(name: &str) -> PathBuf {
    let mut names = (1..).map(|number| PathBuf::from(format!("{name}_{number}")));
    names.find(|path| !path.exists()).unwrap_or_default()
}

/// Sends each position to the program.
fn pass_to(positions: Sender<f64>) -> impl FnMut(Received<'_, Float64>) + Send {
    move |position| {
        // The program may have stopped listening.
        let _ = positions.send(position.data);
    }
}

/// A robot did not answer.
#[derive(Debug, thiserror::Error)]
#[error("the robot has stopped, or gave no answer within {} s", PATIENCE.as_secs())]
struct NoAnswer;
