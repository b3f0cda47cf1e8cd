//! `downbeat match-robot`: a robot of a match in a process of its own, as `downbeat match --processes` starts
//! it.
//!
//! It hears of the match only by the bytes of its bus, pictures in its ROS domain, and datagrams.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;

use crate::logging::Log;
use crate::network::participant_options;
use crate::new_output::Force;
use crate::parameters::ParameterArguments;
use crate::run::{PATIENCE, WatchedRobot};
use crate::screen::Screen;
use crate::stop::Stop;
use downbeat_bridge::expose::TopicPattern;
use downbeat_bridge::middleware::Direction;
use downbeat_executor::SettingValue;
use downbeat_msgs::qos::{QosProfile, QosRequest};
use downbeat_robot::running::RecordPlan;
use downbeat_robot::{Catalog, ExposeEntry, RobotFile, RosArgs, TopicChoice};

#[derive(Args)]
pub(crate) struct RobotArguments {
    /// The robot file of the match.
    robot: PathBuf,
    /// The namespace of its `[[include]]`.
    name: String,
    /// The port of its bus.
    #[arg(long)]
    port: PathBuf,
    #[arg(long)]
    domain: u16,
    #[arg(long)]
    control_port: u16,
    #[arg(long)]
    answer_port: u16,
    #[arg(long)]
    team_port: u16,
    #[arg(long)]
    record: Option<PathBuf>,
    #[command(flatten)]
    parameters: ParameterArguments,
}

/// The name of its node, in the namespace of the robot.
const NODE: &str = "player";
/// All processes of this machine that share a port: the address of broadcast of the loopback interface.
pub(super) const EVERYBODY: &str = "127.255.255.255";

pub(crate) fn run(
    arguments: &RobotArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let stop = Stop::new()?.with_parent(PATIENCE)?;
    let file = arguments.parameters.read_robot(&arguments.robot, catalog, ros)?;
    let file = as_one_robot(file, arguments)?;
    let mut robot = WatchedRobot::new(file)?;
    robot
        .prepared
        .expose(&ros.with_enclave(participant_options(Some(arguments.domain))?), Some(&log.of_node))?;
    if let Some(directory) = &arguments.record {
        // A process that was started again does not replace the bag of the one before.
        let directory = Force::default().next_run(directory)?;
        let plan = RecordPlan::of_robot(&directory, robot.prepared.file(), None);
        robot.prepared.record(plan)?;
    }
    robot.run(&stop, screen)
}

fn as_one_robot(file: RobotFile, arguments: &RobotArguments) -> anyhow::Result<RobotFile> {
    let RobotArguments { name, control_port, answer_port, team_port, .. } = arguments;
    let seats = downbeat_match::seats(std::slice::from_ref(name)).map_err(|problem| anyhow!("{problem}"))?;
    let seat = seats.first().context("a match has players")?;
    let (team, player) = (i64::from(seat.team.number()), i64::from(seat.number));
    let everybody = || SettingValue::Text(EVERYBODY.to_owned());
    let mut file = file.only(name, NODE);
    let port = arguments.port.display().to_string();
    file.furnish("darwin_op", name, [("port", port.into())])?;
    file.furnish(
        "game_controller",
        name,
        [
            ("team", team.into()),
            ("player", player.into()),
            ("address", everybody()),
            ("port", i64::from(*control_port).into()),
            ("answer_port", i64::from(*answer_port).into()),
        ],
    )?;
    file.furnish(
        "team_communication",
        name,
        [
            ("team", team.into()),
            ("player", player.into()),
            ("address", everybody()),
            ("port", i64::from(*team_port).into()),
            ("to", everybody()),
        ],
    )?;
    let pictures = QosProfile::DEFAULT.keep_last(2).into();
    for topic in ["camera/image_raw", "camera/camera_info"].map(|topic| format!("{name}/{topic}")) {
        file.expose.topics.push(exposed(TopicChoice::Name(topic), Direction::In, pictures));
    }
    let all = TopicChoice::Pattern { pattern: TopicPattern::new("**")?, except: Vec::new() };
    file.expose.topics.push(exposed(all, Direction::Out, QosRequest::default()));
    Ok(file)
}

/// An entry that the file does not have.
fn exposed(topics: TopicChoice, direction: Direction, qos: QosRequest) -> ExposeEntry {
    // Whatever the namespace of the node is.
    let ros_topic = Some(format!("/{topics}"));
    let mut entry = ExposeEntry::new(topics, direction);
    (entry.ros_topic, entry.qos) = (ros_topic, qos);
    entry
}
