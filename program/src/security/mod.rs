//! `downbeat security`

mod governance;
mod keystore;
mod policy;
mod report;
mod robot;

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::logging::Log;
use super::network::participant_options;
use super::parameters::ParameterArguments;
use downbeat_robot::{Catalog, RosArgs};
pub(crate) use report::RobotReport;

/// Cyclone DDS refuses a governance that names a higher domain.
const MAX_DOMAIN_ID: u16 = 230;

#[derive(Subcommand)]
pub(crate) enum SecurityCommand {
    /// Create a keystore: a new authority, and a governance that lets only its enclaves in and encrypts
    /// everything. Like `ros2 security create_keystore`.
    CreateKeystore {
        /// The folder. Certificates and keys of authorities that it has already are used.
        #[arg(value_name = "DIR")]
        keystore: PathBuf,
        #[command(flatten)]
        domain: DomainArguments,
    },
    /// Create an enclave, which may do everything: a key, a certificate, permissions. Like `ros2 security
    /// create_enclave`.
    CreateEnclave {
        #[command(flatten)]
        enclave: EnclaveArguments,
    },
    /// Replace the permissions of an enclave by those of a policy. Like `ros2 security create_permissions`.
    CreatePermissions {
        #[command(flatten)]
        enclave: EnclaveArguments,
        /// The policy, in which the enclave has the same name.
        #[arg(value_name = "POLICY.xml")]
        policy: PathBuf,
    },
    /// Write the policy that permits a robot what its file exposes to ROS 2, and nothing else. Networks over
    /// Zenoh are left out.
    GeneratePolicy {
        #[command(flatten)]
        robot: RobotArguments,
        /// The enclave; the name of the robot's node without it.
        #[arg(long, value_name = "NAME")]
        enclave: Option<String>,
        /// Write it into this file instead of to standard output. A policy that is there already is extended.
        #[arg(long, short, value_name = "POLICY.xml")]
        output: Option<PathBuf>,
    },
    /// List the enclaves of a keystore, with what prevents their use. Like `ros2 security list_enclaves`.
    #[command(visible_alias = "list-enclaves")]
    List {
        /// The folder.
        #[arg(value_name = "KEYSTORE")]
        keystore: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Check whether an enclave lets a robot do what its file exposes: each endpoint, and the rule that
    /// permits or denies it.
    ///
    /// Without --keystore, the enclave is that of the environment: ROS_SECURITY_ENABLE, ROS_SECURITY_KEYSTORE
    /// and ROS_SECURITY_ENCLAVE_OVERRIDE.
    Check {
        #[command(flatten)]
        robot: RobotArguments,
        /// The folder of the keystore.
        #[arg(long, value_name = "DIR")]
        keystore: Option<PathBuf>,
        /// The enclave; that of --ros-args without it, or /.
        #[arg(long, value_name = "NAME")]
        enclave: Option<String>,
        #[command(flatten)]
        domain: DomainArguments,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

#[derive(Args)]
pub(crate) struct DomainArguments {
    /// The ROS domain, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N")]
    domain: Option<u16>,
}

#[derive(Args)]
pub(crate) struct EnclaveArguments {
    /// The folder of the keystore.
    #[arg(value_name = "KEYSTORE")]
    keystore: PathBuf,
    /// The enclave, such as /robots/darwin_op.
    #[arg(value_name = "NAME")]
    name: String,
    #[command(flatten)]
    domain: DomainArguments,
}

#[derive(Args)]
pub(crate) struct RobotArguments {
    /// The robot file.
    #[arg(value_name = "ROBOT.toml")]
    robot: PathBuf,
    /// With what `run --record` adds: the services of a recorder.
    #[arg(long)]
    record: bool,
    #[command(flatten)]
    parameters: ParameterArguments,
}

impl SecurityCommand {
    /// Whether the command reads a robot file.
    pub(crate) fn reads_robot(&self) -> bool {
        matches!(self, Self::GeneratePolicy { .. } | Self::Check { .. })
    }
}

impl DomainArguments {
    fn id(&self) -> anyhow::Result<u16> {
        Ok(participant_options(self.domain)?.domain_id)
    }

    /// The domain for the documents of a keystore.
    fn of_keystore(&self) -> anyhow::Result<u32> {
        let domain_id = self.id()?;
        anyhow::ensure!(
            domain_id <= MAX_DOMAIN_ID,
            "domain {domain_id} cannot be protected, because Cyclone DDS refuses a governance above {MAX_DOMAIN_ID}; \
             choose another with --domain or ROS_DOMAIN_ID"
        );
        Ok(domain_id.into())
    }
}

pub(crate) fn security(
    command: &SecurityCommand,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    match command {
        SecurityCommand::CreateKeystore { keystore, domain } => {
            keystore::create(keystore, domain.of_keystore()?)
        }
        SecurityCommand::CreateEnclave { enclave } => keystore::create_enclave(enclave),
        SecurityCommand::CreatePermissions { enclave, policy } => {
            keystore::create_permissions(enclave, policy)
        }
        SecurityCommand::GeneratePolicy { robot, enclave, output } => {
            let read = || robot.parameters.read_robot(&robot.robot, catalog, ros);
            policy::generate(read()?, robot.record, enclave.as_deref(), output.as_deref(), log)
        }
        SecurityCommand::List { keystore, json } => keystore::list(keystore, *json),
        SecurityCommand::Check { robot, keystore, enclave, domain, json } => {
            let options = participant_options(domain.domain)?;
            let options = report::with_enclave(options, ros, keystore.as_deref(), enclave.as_deref())?;
            let file = robot.parameters.read_robot(&robot.robot, catalog, ros)?;
            let report = RobotReport::of(file, robot.record, &options, log)?;
            if *json {
                println!("{}", serde_json::to_string_pretty(&report)?);
            } else {
                print!("{report}");
            }
            report.refuse_denied()
        }
    }
}
