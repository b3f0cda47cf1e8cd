//! Which engine to use, which domain to join and how far to look, as ROS 2 environment variables say it.

use super::SecurityOptions;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;
use thiserror::Error;

/// The highest domain whose UDP ports exist: port 7400 + 250 * domain must stay below 65536.
pub const MAX_DOMAIN_ID: u16 = 232;

/// The range of discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DiscoveryRange {
    /// No other participants are discovered.
    Off,
    /// Only participants on this machine: discovery and announced addresses are those of the loopback
    /// interface.
    Localhost,
    /// Everybody that multicast reaches, and this machine.
    Subnet,
}

/// The engine below the nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Engine {
    /// The engine of this project, `downbeat-rtps`.
    #[default]
    Rtps,
    /// The crate rustdds: a second opinion, with the limits that `docs/dds_limits.md` lists.
    #[cfg(feature = "rustdds")]
    Rustdds,
    /// Zenoh, for nodes with `rmw_zenoh_cpp`.
    #[cfg(feature = "zenoh")]
    Zenoh,
}

impl Engine {
    /// The engines that are built in.
    pub const ALL: &[Self] = &[
        Self::Rtps,
        #[cfg(feature = "rustdds")]
        Self::Rustdds,
        #[cfg(feature = "zenoh")]
        Self::Zenoh,
    ];

    /// The engine that `RMW_IMPLEMENTATION` names: those of DDS are one network.
    fn of_rmw(found: &str) -> Result<Self, OptionsError> {
        match found {
            "rmw_fastrtps_cpp" | "rmw_fastrtps_dynamic_cpp" | "rmw_cyclonedds_cpp" | "rmw_connextdds" => {
                Ok(Self::default())
            }
            #[cfg(feature = "zenoh")]
            "rmw_zenoh_cpp" => Ok(Self::Zenoh),
            #[cfg(not(feature = "zenoh"))]
            "rmw_zenoh_cpp" => Err(OptionsError::NoZenoh),
            found => Err(OptionsError::Rmw { found: found.to_owned() }),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Rtps => "rtps",
            #[cfg(feature = "rustdds")]
            Self::Rustdds => "rustdds",
            #[cfg(feature = "zenoh")]
            Self::Zenoh => "zenoh",
        }
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Engine {
    type Err = OptionsError;

    fn from_str(text: &str) -> Result<Self, OptionsError> {
        let found = Self::ALL.iter().find(|engine| engine.name() == text).copied();
        found.ok_or_else(|| OptionsError::Engine { found: text.to_owned() })
    }
}

/// A variable of the environment has an invalid value.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum OptionsError {
    /// `ROS_DOMAIN_ID` is not a domain.
    #[error("ROS_DOMAIN_ID={found:?} is not a domain: expected a whole number from 0 to 232")]
    DomainId {
        /// The value found.
        found: String,
    },
    /// No engine of that name is built in.
    #[error("{found:?} is no engine that is built in: there is {}{}", engines(), hint(found))]
    Engine {
        /// The name found.
        found: String,
    },
    /// `RMW_IMPLEMENTATION` names no known implementation.
    #[error(
        "RMW_IMPLEMENTATION={found:?} is not known: expected rmw_fastrtps_cpp, rmw_fastrtps_dynamic_cpp, rmw_cyclonedds_cpp or \
         rmw_connextdds (DDS), or rmw_zenoh_cpp (Zenoh)"
    )]
    Rmw {
        /// The value found.
        found: String,
    },
    /// `RMW_IMPLEMENTATION` is that of Zenoh, which is not built in.
    #[error(
        "RMW_IMPLEMENTATION=rmw_zenoh_cpp: this program is built without \"zenoh\": build with --features zenoh, or unset it to \
         use DDS"
    )]
    NoZenoh,
    /// A variable of Zenoh has an invalid value.
    #[cfg(feature = "zenoh")]
    #[error(transparent)]
    Zenoh(#[from] downbeat_zenoh::SettingsError),
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE` is not a range.
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE={found:?} is not a range: expected LOCALHOST, SUBNET, OFF or SYSTEM_DEFAULT"
    )]
    DiscoveryRange {
        /// The value found.
        found: String,
    },
}

/// How to join a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantOptions {
    /// The domain, 0 to [`MAX_DOMAIN_ID`].
    pub domain_id: u16,
    /// The range of discovery.
    pub discovery_range: DiscoveryRange,
    /// `ROS_STATIC_PEERS`: hosts to announce to besides, by address or name.
    pub static_peers: Vec<String>,
    /// How the participant is to be protected, with `ROS_SECURITY_ENABLE=true`.
    pub security: Option<SecurityOptions>,
    /// Values of variables that have no effect, although somebody wanted something with them: sentences.
    pub ignored: Vec<String>,
    /// The engine.
    pub engine: Engine,
    /// How long others keep this participant after they last heard of it.
    pub lease: Duration,
    /// The configuration of Zenoh, as `ZENOH_*` variables say it.
    #[cfg(feature = "zenoh")]
    pub zenoh: downbeat_zenoh::Settings,
}

impl ParticipantOptions {
    /// The lease of Fast DDS.
    pub const LEASE: Duration = Duration::from_secs(20);

    /// Domain `domain_id`, and the default range of ROS 2.
    #[must_use]
    pub fn new(domain_id: u16) -> Self {
        Self {
            domain_id,
            discovery_range: DiscoveryRange::Subnet,
            static_peers: Vec::new(),
            security: None,
            ignored: Vec::new(),
            engine: Engine::default(),
            lease: Self::LEASE,
            #[cfg(feature = "zenoh")]
            zenoh: downbeat_zenoh::Settings::default(),
        }
    }

    /// The options in `RMW_IMPLEMENTATION`, `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`,
    /// `ROS_LOCALHOST_ONLY`, `ROS_STATIC_PEERS`, `ROS_SECURITY_*` and `ZENOH_*`. An empty variable counts as
    /// unset.
    ///
    /// # Errors
    /// [`OptionsError`] when a variable holds no valid value.
    pub fn from_env() -> Result<Self, OptionsError> {
        Self::from_variables(|name| std::env::var(name).ok())
    }

    /// The same, with the variables from `lookup`.
    ///
    /// # Errors
    /// [`OptionsError`] when a variable holds no valid value.
    pub fn from_variables(lookup: impl Fn(&str) -> Option<String>) -> Result<Self, OptionsError> {
        let lookup = |name: &str| lookup(name).filter(|value| !value.trim().is_empty());

        let domain_id = match lookup("ROS_DOMAIN_ID") {
            None => 0,
            Some(found) => match found.trim().parse() {
                Ok(domain_id) if domain_id <= MAX_DOMAIN_ID => domain_id,
                _ => return Err(OptionsError::DomainId { found }),
            },
        };
        let mut discovery_range = match lookup("ROS_AUTOMATIC_DISCOVERY_RANGE") {
            None => DiscoveryRange::Subnet,
            Some(found) => match found.trim() {
                "LOCALHOST" => DiscoveryRange::Localhost,
                "SUBNET" | "SYSTEM_DEFAULT" => DiscoveryRange::Subnet,
                "OFF" => DiscoveryRange::Off,
                _ => return Err(OptionsError::DiscoveryRange { found }),
            },
        };
        // rcl of Jazzy honours the older variable where it is on, before the newer.
        let is_localhost_only = lookup("ROS_LOCALHOST_ONLY").is_some_and(|value| value.trim() == "1");
        if is_localhost_only {
            discovery_range = DiscoveryRange::Localhost;
        }
        // As in rcl, it leaves no room for other hosts.
        let static_peers = lookup("ROS_STATIC_PEERS")
            .filter(|_| !is_localhost_only)
            .map(|peers| {
                peers.split(';').map(|peer| peer.trim().to_owned()).filter(|p| !p.is_empty()).collect()
            })
            .unwrap_or_default();
        let (security, ignored) = SecurityOptions::from_variables(lookup);
        let engine = lookup("RMW_IMPLEMENTATION")
            .map_or(Ok(Engine::default()), |found| Engine::of_rmw(found.trim()))?;
        Ok(Self {
            discovery_range,
            static_peers,
            security,
            ignored,
            engine,
            #[cfg(feature = "zenoh")]
            zenoh: downbeat_zenoh::Settings::from_variables(lookup)?,
            ..Self::new(domain_id)
        })
    }

    /// Requests of the environment that are not supported, each as a sentence for the log with an
    /// alternative.
    #[must_use]
    pub fn not_honoured(&self) -> Vec<String> {
        let mut sentences = self.ignored.clone();
        #[cfg(feature = "zenoh")]
        if self.engine == Engine::Zenoh {
            if !self.static_peers.is_empty() {
                let text =
                    "ROS_STATIC_PEERS has no effect on Zenoh: set connect/endpoints by ZENOH_CONFIG_OVERRIDE";
                sentences.push(text.to_owned());
            }
            return sentences;
        }
        let peers = self.static_peers.join(";");
        match self.discovery_range {
            _ if peers.is_empty() => {}
            DiscoveryRange::Subnet => {}
            DiscoveryRange::Off => sentences.push(format!(
                "ROS_STATIC_PEERS={peers} is not looked for with ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: set it to SUBNET"
            )),
            DiscoveryRange::Localhost => sentences.push(format!(
                "ROS_STATIC_PEERS={peers} cannot answer with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, unless they are on this \
                 machine: the DDS engine announces its address on the loopback interface only. Set it to SUBNET"
            )),
        }
        sentences
    }
}

fn engines() -> String {
    Engine::ALL.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn hint(engine: &str) -> &'static str {
    match engine {
        "rustdds" => "; this program is built without \"rustdds\": build with --features rustdds",
        "zenoh" => "; this program is built without \"zenoh\": build with --features zenoh",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn options(variables: &[(&str, &str)]) -> Result<ParticipantOptions, OptionsError> {
        ParticipantOptions::from_variables(|name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn an_empty_environment_means_domain_0_on_the_subnet() {
        assert_eq!(options(&[]).unwrap(), ParticipantOptions::new(0));
        assert_eq!(
            options(&[("ROS_DOMAIN_ID", ""), ("ROS_STATIC_PEERS", "")]).unwrap(),
            ParticipantOptions::new(0)
        );
    }

    #[test]
    fn the_implementations_of_dds_are_one_network_and_an_unknown_one_is_an_error() {
        let engine = |value| options(&[("RMW_IMPLEMENTATION", value)]).map(|options| options.engine);
        for known in
            ["", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp", "rmw_connextdds"]
        {
            assert_eq!(engine(known), Ok(Engine::Rtps), "{known}");
        }
        let error = engine("rmw_zenoh").unwrap_err().to_string();
        assert!(error.contains("\"rmw_zenoh\"") && error.contains("rmw_cyclonedds_cpp"), "{error}");
        #[cfg(feature = "zenoh")]
        assert_eq!(engine("rmw_zenoh_cpp"), Ok(Engine::Zenoh));
        #[cfg(not(feature = "zenoh"))]
        assert!(engine("rmw_zenoh_cpp").unwrap_err().to_string().contains("--features zenoh"));
    }

    #[test]
    fn a_domain_is_a_number_up_to_232() {
        assert_eq!(options(&[("ROS_DOMAIN_ID", " 42 ")]).unwrap().domain_id, 42);
        assert_eq!(options(&[("ROS_DOMAIN_ID", "232")]).unwrap().domain_id, 232);
        for wrong in ["233", "-1", "robot", "1.0", "70000"] {
            let error = options(&[("ROS_DOMAIN_ID", wrong)]).unwrap_err();
            assert_eq!(error, OptionsError::DomainId { found: wrong.to_owned() });
            assert!(error.to_string().contains("0 to 232"), "{error}");
        }
    }

    #[test]
    fn ranges_are_those_of_ros() {
        let range = |value| options(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", value)]).map(|o| o.discovery_range);
        assert_eq!(range("LOCALHOST"), Ok(DiscoveryRange::Localhost));
        assert_eq!(range("SUBNET"), Ok(DiscoveryRange::Subnet));
        assert_eq!(range("SYSTEM_DEFAULT"), Ok(DiscoveryRange::Subnet));
        assert_eq!(range("OFF"), Ok(DiscoveryRange::Off));
        assert!(range("localhost").unwrap_err().to_string().contains("LOCALHOST"));
    }

    #[test]
    fn the_older_localhost_variable_wins_where_it_is_on() {
        let range = |value| {
            options(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"), ("ROS_LOCALHOST_ONLY", value)])
                .map(|options| options.discovery_range)
        };
        assert_eq!(range("1"), Ok(DiscoveryRange::Localhost));
        assert_eq!(range("0"), Ok(DiscoveryRange::Off));
    }

    #[test]
    fn what_cannot_be_honoured_is_told_with_what_to_do() {
        let warnings = |variables: &[_]| options(variables).unwrap().not_honoured().join("\n");
        let peers = ("ROS_STATIC_PEERS", "10.0.0.7");
        let range = |value| ("ROS_AUTOMATIC_DISCOVERY_RANGE", value);
        assert_eq!(warnings(&[peers]), "");
        assert_eq!(warnings(&[peers, range("SUBNET")]), "");
        for value in ["OFF", "LOCALHOST"] {
            let text = warnings(&[peers, range(value)]);
            assert!(text.contains("10.0.0.7") && text.contains(value) && text.contains("SUBNET"), "{text}");
        }
        assert!(warnings(&[("ROS_SECURITY_ENABLE", "True")]).contains("ROS_SECURITY_ENABLE=true"));
        assert_eq!(warnings(&[peers, ("ROS_LOCALHOST_ONLY", "1")]), "", "as in rcl they are not there then");
    }

    #[test]
    fn static_peers_are_split_at_semicolons() {
        let options = options(&[("ROS_STATIC_PEERS", "10.0.0.1; robot.local;")]).unwrap();
        assert_eq!(options.static_peers, ["10.0.0.1", "robot.local"]);
    }
}
