//! `[networks.NAME]`: further networks of a robot, each with its own selection.

use std::path::PathBuf;

use downbeat_bridge::middleware::{Engine, MAX_DOMAIN_ID, OptionsError, ParticipantOptions};
use downbeat_edge::Interfaces;

use super::expose::{ExposeSection, selection};
use super::features::take_of_zenoh;
use super::table::{Table, Value};
use super::{Result, RobotFile, RobotFileError};

/// A network in addition to that of `[expose]`, in which the robot has a node of the same name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkEntry {
    pub(crate) line: usize,
    /// Its name in the robot file.
    pub name: String,
    /// The engine; `None` for that of the environment.
    pub engine: Option<Engine>,
    /// The ROS domain; `None` for that of the environment.
    pub domain: Option<u16>,
    /// With Zenoh: the endpoint of the router, in place of the configured one.
    pub connect: Option<String>,
    /// With Zenoh: the file with the configuration of the session.
    pub config: Option<PathBuf>,
    /// Whether the settings that are parameters of the robot's node are so there too.
    pub parameters: bool,
    /// Whether the robot's log goes to `/rosout` there too.
    pub rosout: bool,
}

impl NetworkEntry {
    /// How to join it; what the entry leaves open is as in the environment.
    pub(crate) fn options(&self, environment: &ParticipantOptions) -> ParticipantOptions {
        let mut options = environment.clone();
        options.engine = self.engine.unwrap_or(environment.engine);
        options.domain_id = self.domain.unwrap_or(environment.domain_id);
        #[cfg(feature = "zenoh")]
        {
            let text = |path: &PathBuf| path.display().to_string();
            let file = self.config.as_ref().map(text);
            options.zenoh.session_file = file.or(options.zenoh.session_file);
            options.zenoh.router = self.connect.clone();
        }
        options
    }
}

impl RobotFile {
    /// The error if a network is one in which the robot is already.
    pub(crate) fn same_network(&self, network: &NetworkEntry) -> RobotFileError {
        let problem = format!(
            "network \"{}\" is one that the robot is in already: give it another \"domain\" or \"engine\"",
            network.name
        );
        self.source.error(network.line, problem)
    }
}

/// Reads `[networks]`, and adds the selections of its networks to that of `[expose]`.
pub(super) fn networks(
    value: Value<'_>,
    interfaces: &Interfaces,
    exposed: &mut ExposeSection,
) -> Result<Vec<NetworkEntry>> {
    let networks = value.table("[networks]")?.take_rest().into_iter();
    let network = |(name, value): (String, Value<'_>)| {
        let mut table = value.table(&format!("[networks.{name}]"))?;
        let entry = network(&mut table, name)?;
        let of_network = selection(&mut table, interfaces, entry.engine)?;
        table.finish()?;
        exposed.add_network(&entry.name, of_network);
        Ok(entry)
    };
    networks.map(network).collect()
}

fn network(table: &mut Table<'_>, name: String) -> Result<NetworkEntry> {
    let engine = table.take("engine").map(|value| {
        value.text()?.parse::<Engine>().map_err(|error: OptionsError| value.error(error.to_string()))
    });
    let engine = engine.transpose()?;
    let domain = table
        .take("domain")
        .map(|value| value.number_in(0..=i64::from(MAX_DOMAIN_ID), "a domain, from 0 to 232"));
    let connect = take_of_zenoh(table, "connect", engine)?;
    let config = take_of_zenoh(table, "config", engine)?;
    let file = |value: Value<'_>| value.text().map(|name| value.path().with_file_name(name));
    let mut flag = |key| table.take(key).map_or(Ok(false), |value| value.flag());
    Ok(NetworkEntry {
        name,
        engine,
        domain: domain.transpose()?,
        connect: connect.map(|value| value.text().map(str::to_owned)).transpose()?,
        config: config.map(file).transpose()?,
        parameters: flag("parameters")?,
        rosout: flag("rosout")?,
        line: table.line(),
    })
}
