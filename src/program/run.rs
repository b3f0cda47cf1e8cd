//! `downbeat run`

use anyhow::Context;
use downbeat::bridge::middleware::{MAX_DOMAIN_ID, ParticipantOptions};

use super::cli::RunArguments;
use super::logging::Log;
use super::screen::Screen;
use super::session::Session;
use super::stop::Stop;

pub(crate) fn run(arguments: &RunArguments, screen: &Screen, log: &Log) -> anyhow::Result<()> {
    let mut session = Session::new(arguments.parameters.read_robot(&arguments.robot)?)?;
    let options = participant_options(arguments.domain)?;
    session.expose(&options, log)?;
    if let Some(directory) = &arguments.record {
        session.record(directory, None, arguments.encoding)?;
    }
    let stop = Stop::new(arguments.duration)?;
    session.run(&stop, screen)
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
