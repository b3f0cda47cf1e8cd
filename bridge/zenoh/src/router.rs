//! A router, by which nodes find each other.

use crate::session::reason;
use crate::settings::insert;
use crate::{OpenError, Settings};
use std::net::{Ipv6Addr, TcpListener};
use zenoh::{Session, Wait};

/// Where a router listens on a machine without IPv6.
const IPV4: &str = r#"["tcp/0.0.0.0:7447"]"#;

/// A running router with the defaults of `rmw_zenohd`. Dropping it stops it.
pub struct Router {
    session: Session,
    is_without_ipv6: bool,
    has_access_control: bool,
}

impl Router {
    /// Starts a router.
    ///
    /// # Errors
    /// [`OpenError`] when the configuration cannot be used, or the port is in use.
    pub fn start(settings: &Settings) -> Result<Self, OpenError> {
        let mut config = settings.router()?;
        let is_without_ipv6 = !settings.sets_router_listen() && !has_ipv6();
        if is_without_ipv6 {
            insert(&mut config, "listen/endpoints", IPV4)?;
        }
        let has_access_control = config.get_json("access_control/enabled").is_ok_and(|value| value == "true");
        let session = zenoh::open(config).wait().map_err(|error| OpenError::Zenoh(reason(&error)))?;
        Ok(Self { session, is_without_ipv6, has_access_control })
    }

    /// Whether it listens on IPv4 only, since this machine has no IPv6.
    #[must_use]
    pub fn is_without_ipv6(&self) -> bool {
        self.is_without_ipv6
    }

    /// Whether its configuration has rules for who may do what.
    #[must_use]
    pub fn has_access_control(&self) -> bool {
        self.has_access_control
    }

    /// Its identity, in hexadecimal digits.
    #[must_use]
    pub fn id(&self) -> String {
        self.session.zid().to_string()
    }

    /// Where it listens, such as `tcp/192.168.1.7:7447`.
    #[must_use]
    pub fn locators(&self) -> Vec<String> {
        self.session.info().locators().wait().iter().map(ToString::to_string).collect()
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        if let Err(error) = self.session.close().wait() {
            tracing::debug!(%error, "a Zenoh router did not close in order");
        }
    }
}

fn has_ipv6() -> bool {
    TcpListener::bind((Ipv6Addr::UNSPECIFIED, 0)).is_ok()
}
