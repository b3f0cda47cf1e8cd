//! Whether an enclave permits a robot what its file exposes.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use downbeat_bridge::middleware::{Direction, ParticipantOptions, SecurityOptions};
use downbeat_robot::running::RehearsedNetwork;
use downbeat_robot::{RobotFile, RosArgs};
use downbeat_security::access::Action;
use downbeat_security::enclave::Enclave;
use downbeat_security::guard::Credentials;
use downbeat_security::pki::Date;
use serde::Serialize;

use super::{governance, robot};
use crate::logging::Log;

/// Every endpoint of a robot over DDS, with what its enclave says about it.
#[derive(Serialize)]
pub(crate) struct RobotReport {
    folder: PathBuf,
    subject: String,
    /// What ends when.
    valid_until: ValidUntil,
    warnings: Vec<String>,
    networks: Vec<NetworkReport>,
    /// The networks that are not over DDS.
    unprotected: Vec<String>,
}

#[derive(Serialize)]
struct ValidUntil {
    authority: String,
    certificate: String,
    permissions_authority: String,
    permissions: String,
}

#[derive(Serialize)]
struct NetworkReport {
    /// `None` for that of `[expose]`.
    network: Option<String>,
    domain: u16,
    governance: Vec<String>,
    endpoints: Vec<EndpointReport>,
}

#[derive(Serialize)]
struct EndpointReport {
    /// `publish` or `subscribe`.
    action: &'static str,
    /// Its name in DDS.
    topic: String,
    is_allowed: bool,
    rule: String,
}

/// The options with the enclave of the command line, or else that of the environment.
pub(super) fn with_enclave(
    mut options: ParticipantOptions,
    ros: &RosArgs,
    keystore: Option<&Path>,
    enclave: Option<&str>,
) -> anyhow::Result<ParticipantOptions> {
    if let Some(keystore) = keystore {
        let (keystore, enclave) = (Some(keystore.to_owned()), "/".to_owned());
        let security = SecurityOptions { keystore, enclave, enclave_override: None, is_enforced: true };
        options.security = Some(security);
    }
    options = ros.with_enclave(options);
    let Some(security) = &mut options.security else {
        anyhow::bail!(
            "no enclave is chosen: name it with --keystore and --enclave, or set ROS_SECURITY_ENABLE=true and \
             ROS_SECURITY_KEYSTORE"
        );
    };
    if let Some(enclave) = enclave {
        security.enclave = enclave.to_owned();
        security.enclave_override = None;
    }
    Ok(options)
}

impl RobotReport {
    /// The report for the enclave of the options.
    pub(crate) fn of(
        file: RobotFile,
        is_recorded: bool,
        options: &ParticipantOptions,
        log: &Log,
    ) -> anyhow::Result<Self> {
        let security = options.security.clone().unwrap_or_default();
        let (folder, now) = (security.folder()?, SystemTime::now());
        let enclave = Enclave::load(&folder, now)?;
        let until = |(_, end): (SystemTime, SystemTime)| Date(end).to_string();
        let valid_until = ValidUntil {
            authority: until(enclave.authority.certificate().validity()),
            certificate: until(enclave.certificate.validity()),
            permissions_authority: until(enclave.permissions_ca.validity()),
            permissions: until(enclave.grant(now)?.validity),
        };
        let robot::Networks { over_dds, others } = robot::networks(file, is_recorded, options, log)?;
        let networks = over_dds.iter().map(|network| NetworkReport::of(network, &enclave, now));
        Ok(Self {
            networks: networks.collect::<Result<_, _>>()?,
            folder,
            subject: enclave.certificate.subject().to_owned(),
            valid_until,
            warnings: enclave.warnings,
            unprotected: others,
        })
    }

    /// The report for a robot that is about to run; `None` if it would run without protection.
    pub(crate) fn for_run(
        file: RobotFile,
        options: &ParticipantOptions,
        log: &Log,
    ) -> anyhow::Result<Option<Self>> {
        let Some(security) = &options.security else { return Ok(None) };
        match Self::of(file, false, options, log) {
            Err(error) if !security.is_enforced => {
                tracing::warn!(
                    "the robot would run without protection, since ROS_SECURITY_STRATEGY is not Enforce: {error}"
                );
                Ok(None)
            }
            report => report.map(Some),
        }
    }

    /// What is allowed, in a line.
    pub(crate) fn summary(&self) -> String {
        let endpoints = self.networks.iter().map(|network| network.endpoints.len());
        let (all, denied) = (endpoints.sum::<usize>(), self.denied().count());
        format!(
            "protected by {} as {}: {} endpoints allowed, {denied} denied; `downbeat security check` lists them",
            self.folder.display(),
            self.subject,
            all - denied
        )
    }

    /// Fails if something is denied.
    pub(crate) fn refuse_denied(&self) -> anyhow::Result<()> {
        const MOST: usize = 8;
        let denied: Vec<String> = self.denied().map(|endpoint| endpoint.to_string()).collect();
        let more = match denied.len().saturating_sub(MOST) {
            0 => String::new(),
            more => format!(" and {more} endpoints more, which `downbeat security check` lists"),
        };
        anyhow::ensure!(
            denied.is_empty(),
            "{} denies the robot {}{more}; permit it in the policy, sign that with `downbeat security create-permissions`, \
             or do not expose it",
            self.folder.display(),
            denied.iter().take(MOST).cloned().collect::<Vec<_>>().join(", ")
        );
        Ok(())
    }

    fn denied(&self) -> impl Iterator<Item = &EndpointReport> {
        let endpoints = self.networks.iter().flat_map(|network| &network.endpoints);
        endpoints.filter(|endpoint| !endpoint.is_allowed)
    }
}

impl NetworkReport {
    fn of(network: &RehearsedNetwork, enclave: &Enclave, now: SystemTime) -> anyhow::Result<Self> {
        let domain = network.options.domain_id;
        Credentials::new(enclave, domain.into(), now)?;
        let endpoints: BTreeSet<_> = network
            .endpoints
            .iter()
            .map(|endpoint| (&*endpoint.topic_name, endpoint.direction == Direction::Out))
            .collect();
        let decide = |(topic, is_written): (&str, bool)| -> anyhow::Result<_> {
            let (action, name) =
                if is_written { (Action::Publish, "publish") } else { (Action::Subscribe, "subscribe") };
            let decision = enclave.decide(action, domain.into(), topic, now)?;
            let (topic, is_allowed) = (topic.to_owned(), decision.is_allowed);
            Ok(EndpointReport { action: name, topic, is_allowed, rule: decision.rule })
        };
        Ok(Self {
            network: network.name.clone(),
            domain,
            governance: governance::sentences(enclave.for_domain(domain.into())?),
            endpoints: endpoints.into_iter().map(decide).collect::<Result<_, _>>()?,
        })
    }
}

impl fmt::Display for RobotReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "security: {} as {}", self.folder.display(), self.subject)?;
        let ValidUntil { authority, certificate, permissions_authority, permissions } = &self.valid_until;
        writeln!(f, "  certificate valid until {certificate}, its authority until {authority}")?;
        writeln!(
            f,
            "  permissions valid until {permissions}, their authority until {permissions_authority}"
        )?;
        self.warnings.iter().try_for_each(|warning| writeln!(f, "  warning: {warning}"))?;
        self.networks.iter().try_for_each(|network| write!(f, "{network}"))?;
        for network in &self.unprotected {
            writeln!(f, "\nnetwork {network} is not over the engine that keystores protect")?;
        }
        Ok(())
    }
}

impl fmt::Display for NetworkReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.network.as_ref().map(|name| format!(", network {name}")).unwrap_or_default();
        writeln!(f, "\ngovernance of domain {}{name}", self.domain)?;
        self.governance.iter().try_for_each(|sentence| writeln!(f, "  {sentence}"))?;
        let denied = self.endpoints.iter().filter(|endpoint| !endpoint.is_allowed).count();
        writeln!(f, "\nendpoints: {} allowed, {denied} denied", self.endpoints.len() - denied)?;
        self.endpoints.iter().try_for_each(|endpoint| {
            let decision = if endpoint.is_allowed { "allowed" } else { "DENIED" };
            let EndpointReport { action, topic, rule, .. } = endpoint;
            writeln!(f, "  {decision:<8} {action:<10} {topic:<50} {rule}")
        })
    }
}

impl fmt::Display for EndpointReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "to {} {} ({})", self.action, self.topic, self.rule)
    }
}
