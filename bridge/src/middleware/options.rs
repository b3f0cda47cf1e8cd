//! Which domain to join and how far to look, as ROS 2 environment variables say it.

use super::OptionsError;

/// The highest domain whose UDP ports exist: port 7400 + 250 * domain must stay below 65536.
pub const MAX_DOMAIN_ID: u16 = 232;

/// How far participants look for each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DiscoveryRange {
    /// Nobody is found and nobody finds us.
    Off,
    /// Only participants on this machine: discovery and announced addresses are those of the loopback interface.
    Localhost,
    /// Everybody that multicast reaches, and this machine.
    Subnet,
}

/// How to join a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantOptions {
    /// The domain, 0 to [`MAX_DOMAIN_ID`].
    pub domain_id: u16,
    /// How far to look.
    pub discovery_range: DiscoveryRange,
    /// `ROS_STATIC_PEERS`, which the engine cannot honour: told in a warning.
    pub static_peers: Vec<String>,
    /// `ROS_SECURITY_ENABLE`, which the engine cannot honour: told in a warning.
    pub wants_security: bool,
}

impl ParticipantOptions {
    /// Domain `domain_id`, and the range that ROS 2 takes unless told otherwise.
    #[must_use]
    pub fn new(domain_id: u16) -> Self {
        Self {
            domain_id,
            discovery_range: DiscoveryRange::Subnet,
            static_peers: Vec::new(),
            wants_security: false,
        }
    }

    /// What `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_LOCALHOST_ONLY`, `ROS_STATIC_PEERS` and `ROS_SECURITY_*` ask for.
    /// An empty variable counts as unset.
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
        if lookup("ROS_LOCALHOST_ONLY").is_some_and(|value| value.trim() == "1") {
            discovery_range = DiscoveryRange::Localhost;
        }
        let static_peers = lookup("ROS_STATIC_PEERS")
            .map(|peers| {
                peers.split(';').map(|peer| peer.trim().to_owned()).filter(|p| !p.is_empty()).collect()
            })
            .unwrap_or_default();
        // The values that rcl of Jazzy compares with (`rcl/src/security.c`).
        let wants_security = lookup("ROS_SECURITY_ENABLE").is_some_and(|value| value == "true");
        if wants_security && lookup("ROS_SECURITY_STRATEGY").is_some_and(|value| value == "Enforce") {
            return Err(OptionsError::Security);
        }
        Ok(Self { domain_id, discovery_range, static_peers, wants_security })
    }

    pub(super) fn warn_about_what_is_ignored(&self) {
        if self.wants_security {
            tracing::warn!(
                "ROS_SECURITY_ENABLE=true: the DDS engine has no security, this node joins without it"
            );
        }
        if !self.static_peers.is_empty() {
            tracing::warn!(
                peers = self.static_peers.join(";"),
                "ROS_STATIC_PEERS cannot be honoured: the DDS engine only finds peers by multicast and on this machine"
            );
        }
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
    fn security_is_refused_where_it_is_enforced_and_noted_where_it_is_not() {
        let enabled = ("ROS_SECURITY_ENABLE", "true");
        assert!(options(&[enabled]).unwrap().wants_security);
        assert!(!options(&[("ROS_SECURITY_ENABLE", "false")]).unwrap().wants_security);
        let error = options(&[enabled, ("ROS_SECURITY_STRATEGY", "Enforce")]).unwrap_err();
        assert!(error.to_string().contains("Permissive"), "{error}");
    }

    #[test]
    fn static_peers_are_split_at_semicolons() {
        let options = options(&[("ROS_STATIC_PEERS", "10.0.0.1; robot.local;")]).unwrap();
        assert_eq!(options.static_peers, ["10.0.0.1", "robot.local"]);
    }
}
