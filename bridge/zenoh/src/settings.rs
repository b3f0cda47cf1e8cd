//! The configuration of sessions and routers: the defaults of `rmw_zenoh_cpp`, files, and what overrides
//! both.

use thiserror::Error;
use zenoh::Config;

/// The most bytes of one message that are put together from fragments, in place of Zenoh's 1 GiB: a peer
/// decides how many it sends. Larger messages are dropped.
pub const MOST_MESSAGE_BYTES: usize = 64 << 20;

/// What `rmw_zenoh_cpp` sets in both of its files (`DEFAULT_RMW_ZENOH_{SESSION,ROUTER}_CONFIG.json5`,
/// 0.2.10), as far as it differs from Zenoh's own defaults or matters here.
const COMMON: &[(&str, &str)] = &[
    ("connect/exit_on_failure", "{ router: false, peer: false, client: true }"),
    ("connect/retry", "{ period_init_ms: 1000, period_max_ms: 4000, period_increase_factor: 2 }"),
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "true"),
    ("scouting/gossip/multihop", "false"),
    ("scouting/gossip/target", r#"{ router: ["router", "peer"], peer: ["router"] }"#),
    ("scouting/gossip/autoconnect", r#"{ router: [], peer: ["router", "peer"] }"#),
    ("scouting/gossip/autoconnect_strategy", r#"{ peer: { to_router: "always", to_peer: "greater-zid" } }"#),
    ("timestamping/enabled", "{ router: true, peer: true, client: true }"),
    ("queries_default_timeout", "600000"),
    ("transport/unicast/open_timeout", "60000"),
    ("transport/unicast/accept_timeout", "60000"),
    ("transport/unicast/accept_pending", "10000"),
    ("transport/unicast/max_sessions", "10000"),
    ("transport/link/tx/lease", "60000"),
    ("transport/link/tx/keep_alive", "2"),
];

const SESSION: &[(&str, &str)] = &[
    ("mode", r#""peer""#),
    ("connect/endpoints", r#"["tcp/localhost:7447"]"#),
    ("listen/endpoints", r#"["tcp/localhost:0"]"#),
    ("transport/link/tx/queue/congestion_control/block/wait_before_close", "60000000"),
];

const ROUTER: &[(&str, &str)] = &[
    ("mode", r#""router""#),
    ("listen/endpoints", r#"["tcp/[::]:7447"]"#),
    ("transport/link/tx/queue/congestion_control/block/wait_before_close", "5000000"),
];

/// The variables of the environment that `rmw_zenoh_cpp` reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// `ZENOH_SESSION_CONFIG_URI`: a file in place of the defaults of sessions.
    pub session_file: Option<String>,
    /// `ZENOH_ROUTER_CONFIG_URI`: a file in place of the defaults of routers.
    pub router_file: Option<String>,
    /// `ZENOH_CONFIG_OVERRIDE`: single values, `key/of/value=json5;…`, which replace those of both.
    pub overrides: Option<String>,
    /// `ZENOH_ROUTER_CHECK_ATTEMPTS`: how many seconds a session looks for a router; 0 for ever, less than 0
    /// not at all.
    pub router_check_attempts: i64,
    /// What to connect to in place of what the file says, such as `tls/robot.local:7447`; the session is then
    /// a client.
    pub connect: Option<String>,
    /// A router elsewhere, in place of what the file says. The session is then a router without a port: it
    /// goes on alone until the other one comes, and all that the other one reaches see it. A peer would be
    /// hidden from other peers to which it has no link of its own, and a client would not start.
    pub router: Option<String>,
}

/// The configuration cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SettingsError {
    /// `ZENOH_ROUTER_CHECK_ATTEMPTS` is no number.
    #[error(
        "ZENOH_ROUTER_CHECK_ATTEMPTS={found:?} is no whole number: expected how many seconds to look for a router, 0 for ever, -1 not at all"
    )]
    Attempts {
        /// The value found.
        found: String,
    },
    /// A file cannot be read or is no configuration.
    #[error("{variable}={path}: {reason}")]
    File {
        /// The variable that names it.
        variable: &'static str,
        /// The path.
        path: String,
        /// What Zenoh said.
        reason: String,
    },
    /// A part of `ZENOH_CONFIG_OVERRIDE` has no equals sign.
    #[error(
        "ZENOH_CONFIG_OVERRIDE: {part:?} has no value: expected key=value pairs such as listen/endpoints=[\"tcp/localhost:0\"], separated by ';'"
    )]
    NoValue {
        /// The part.
        part: String,
    },
    /// Zenoh refuses a value.
    #[error("Zenoh refuses {key}={value}: {reason}")]
    Value {
        /// Where.
        key: String,
        /// The value.
        value: String,
        /// What Zenoh said.
        reason: String,
    },
}

/// Those of an empty environment.
impl Default for Settings {
    fn default() -> Self {
        Self {
            session_file: None,
            router_file: None,
            overrides: None,
            router_check_attempts: 1,
            connect: None,
            router: None,
        }
    }
}

impl Settings {
    /// The settings in the environment, which `lookup` reads. An empty variable counts as unset.
    ///
    /// # Errors
    /// [`SettingsError::Attempts`] when that variable is no number.
    pub fn from_variables(lookup: impl Fn(&str) -> Option<String>) -> Result<Self, SettingsError> {
        let lookup = |name: &str| lookup(name).filter(|value| !value.trim().is_empty());
        let router_check_attempts = match lookup("ZENOH_ROUTER_CHECK_ATTEMPTS") {
            None => Self::default().router_check_attempts,
            Some(found) => found.trim().parse().map_err(|_| SettingsError::Attempts { found })?,
        };
        Ok(Self {
            session_file: lookup("ZENOH_SESSION_CONFIG_URI"),
            router_file: lookup("ZENOH_ROUTER_CONFIG_URI"),
            overrides: lookup("ZENOH_CONFIG_OVERRIDE"),
            router_check_attempts,
            connect: None,
            router: None,
        })
    }

    /// The configuration of a session.
    ///
    /// # Errors
    /// [`SettingsError`] when a file or a value cannot be used.
    pub fn session(&self) -> Result<Config, SettingsError> {
        let file = self.session_file.as_deref().map(|path| ("ZENOH_SESSION_CONFIG_URI", path));
        let mut config = self.config(file, SESSION)?;
        if let Some(router) = &self.router {
            insert(&mut config, "mode", r#""router""#)?;
            insert(&mut config, "listen/endpoints", "[]")?;
            insert(&mut config, "connect/endpoints", &list(router))?;
        }
        if let Some(connect) = &self.connect {
            insert(&mut config, "mode", r#""client""#)?;
            insert(&mut config, "connect/endpoints", &list(connect))?;
        }
        Ok(config)
    }

    /// The configuration of a router.
    ///
    /// # Errors
    /// [`SettingsError`] when a file or a value cannot be used.
    pub fn router(&self) -> Result<Config, SettingsError> {
        let file = self.router_file.as_deref().map(|path| ("ZENOH_ROUTER_CONFIG_URI", path));
        self.config(file, ROUTER)
    }

    /// Whether something besides the defaults decides where a router listens.
    pub(crate) fn sets_router_listen(&self) -> bool {
        let overrides = self.overrides.as_deref().unwrap_or_default();
        self.router_file.is_some() || overrides.contains("listen")
    }

    fn config(
        &self,
        file: Option<(&'static str, &str)>,
        defaults: &[(&str, &str)],
    ) -> Result<Config, SettingsError> {
        let mut config = match file {
            Some((variable, path)) => {
                let failed = |error: zenoh::Error| SettingsError::File {
                    variable,
                    path: path.to_owned(),
                    reason: error.to_string(),
                };
                Config::from_file(path).map_err(failed)?
            }
            None => {
                let mut config = Config::default();
                let set = COMMON.iter().chain(defaults);
                set.into_iter().try_for_each(|(key, value)| insert(&mut config, key, value))?;
                config
            }
        };
        let most = MOST_MESSAGE_BYTES.to_string();
        insert(&mut config, "transport/link/rx/max_message_size", &most)?;
        for part in self.overrides.iter().flat_map(|overrides| overrides.split(';')) {
            let part = part.trim();
            if part.is_empty() {
                continue;
            }
            let (key, value) =
                part.split_once('=').ok_or_else(|| SettingsError::NoValue { part: part.to_owned() })?;
            insert(&mut config, key.trim(), value.trim())?;
        }
        Ok(config)
    }
}

pub(crate) fn insert(config: &mut Config, key: &str, value: &str) -> Result<(), SettingsError> {
    let failed = |error: zenoh::Error| SettingsError::Value {
        key: key.to_owned(),
        value: value.to_owned(),
        reason: error.to_string(),
    };
    config.insert_json5(key, value).map_err(failed)
}

/// A list of one text, as JSON.
fn list(text: &str) -> String {
    format!("[{text:?}]")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn settings(variables: &[(&str, &str)]) -> Result<Settings, SettingsError> {
        Settings::from_variables(|name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    fn value(config: &Config, key: &str) -> String {
        config.get_json(key).unwrap()
    }

    #[test]
    fn a_session_has_the_defaults_of_rmw_zenoh() {
        let config = settings(&[]).unwrap().session().unwrap();
        for (key, expected) in [
            ("mode", r#""peer""#),
            ("connect/endpoints", r#"["tcp/localhost:7447"]"#),
            ("listen/endpoints", r#"["tcp/localhost:0"]"#),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "true"),
            ("queries_default_timeout", "600000"),
            ("transport/link/tx/lease", "60000"),
            ("transport/link/rx/max_message_size", "67108864"),
        ] {
            assert_eq!(value(&config, key), expected, "{key}");
        }
    }

    #[test]
    fn a_router_listens_on_the_port_of_rmw_zenohd() {
        let config = settings(&[]).unwrap().router().unwrap();
        assert_eq!(value(&config, "mode"), r#""router""#);
        assert_eq!(value(&config, "listen/endpoints"), r#"["tcp/[::]:7447"]"#);
        assert_eq!(value(&config, "connect/endpoints"), "[]");
    }

    #[test]
    fn a_session_for_a_router_elsewhere_is_a_router_without_a_port() {
        let router = Some("tls/base:7447#a=1;b=2".to_owned());
        let config = Settings { router, ..settings(&[]).unwrap() }.session().unwrap();
        assert_eq!(value(&config, "connect/endpoints"), r#"["tls/base:7447#a=1;b=2"]"#);
        assert_eq!(value(&config, "mode"), r#""router""#);
        assert_eq!(value(&config, "listen/endpoints"), "[]");
    }

    #[test]
    fn single_values_are_overridden() {
        let overrides = r#"connect/endpoints=["tcp/127.0.0.1:7557"]; mode="client";"#;
        let config = settings(&[("ZENOH_CONFIG_OVERRIDE", overrides)]).unwrap().session().unwrap();
        assert_eq!(value(&config, "connect/endpoints"), r#"["tcp/127.0.0.1:7557"]"#);
        assert_eq!(value(&config, "mode"), r#""client""#);
        for (wrong, reason) in
            [("mode", "has no value"), ("mode=\"robot\"", "mode"), ("no/such/key=1", "no/such/key")]
        {
            let error = settings(&[("ZENOH_CONFIG_OVERRIDE", wrong)]).unwrap().session().unwrap_err();
            assert!(error.to_string().contains(reason), "{wrong}: {error}");
        }
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let error = settings(&[("ZENOH_SESSION_CONFIG_URI", "/no/such/file.json5")]).unwrap().session();
        let error = error.unwrap_err().to_string();
        assert!(error.contains("ZENOH_SESSION_CONFIG_URI=/no/such/file.json5"), "{error}");
    }

    #[test]
    fn attempts_are_a_number() {
        let attempts = |value| settings(&[("ZENOH_ROUTER_CHECK_ATTEMPTS", value)]);
        assert_eq!(settings(&[]).unwrap().router_check_attempts, 1);
        assert_eq!(attempts("-1").unwrap().router_check_attempts, -1);
        assert!(attempts("often").unwrap_err().to_string().contains("\"often\""));
    }
}
