//! `downbeat run`

use crate::bridge::middleware::{MAX_DOMAIN_ID, ParticipantOptions};
use crate::bridge::ros::{Node, NodeName, Participant};
use crate::robot::RosArgs;
use anyhow::Context;

use super::cli::RunArguments;
use super::logging::Log;
use super::screen::Screen;
use super::session::{RecordPlan, Session};
use super::stop::Stop;

pub(crate) fn run(arguments: &RunArguments, ros: &RosArgs, screen: &Screen, log: &Log) -> anyhow::Result<()> {
    let stop = Stop::new()?;
    let mut session = Session::new(arguments.parameters.read_robot(&arguments.robot, ros)?)?;
    let options = participant_options(arguments.domain)?;
    session.expose(&options, log)?;
    if let Some(directory) = &arguments.record {
        session.record(RecordPlan::of_robot(directory, session.file(), arguments.encoding))?;
    }
    session.run(&stop.after(arguments.duration), screen)
}

/// A node of a command that has one of its own.
pub(crate) fn node(name: &str, domain: Option<u16>, ros: &RosArgs) -> anyhow::Result<(Participant, Node)> {
    ros.warn_about_what_is_ignored();
    let name = NodeName::new(ros.namespace.as_deref().unwrap_or("/"), name)?;
    let participant = Participant::join_with(&participant_options(domain)?, ros.remap_rules())?;
    let node = participant.create_node(name)?;
    Ok((participant, node))
}

/// What the environment says, with the domain of the command line if there is one.
pub(crate) fn participant_options(domain: Option<u16>) -> anyhow::Result<ParticipantOptions> {
    let mut options = ParticipantOptions::from_env()?;
    if let Some(domain) = domain {
        let is_valid = domain <= MAX_DOMAIN_ID;
        is_valid
            .then_some(())
            .with_context(|| format!("--domain {domain}: there are domains 0 to {MAX_DOMAIN_ID}"))?;
        options.domain_id = domain;
    }
    Ok(options)
}
