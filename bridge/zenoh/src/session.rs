//! The session of a participant.

use crate::settings::insert;
use crate::{Settings, SettingsError};
use std::time::{Duration, Instant};
use thiserror::Error;
use zenoh::{Session, Wait};

/// Between two looks for a router.
const LOOK: Duration = Duration::from_millis(10);

/// How far a session reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Nobody.
    Off,
    /// Whom its configuration reaches.
    Configured,
}

/// A session was not opened.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OpenError {
    /// The configuration cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// No router answers where a client is to connect.
    #[error(
        "no Zenoh router answers at {endpoint}: {reason}. Start it there with `downbeat router`; for tls also check the certificates in \
         ZENOH_CONFIG_OVERRIDE, transport/link/tls"
    )]
    NoRouter {
        /// Where.
        endpoint: String,
        /// What Zenoh said.
        reason: String,
    },
    /// Zenoh refused.
    #[error("{0}")]
    Zenoh(String),
}

/// The result of looking for a router.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouterCheck {
    /// One is connected.
    Found,
    /// There is none.
    Missing,
    /// It was not looked for.
    Skipped,
}

/// Opens a session and looks for a router for as long as the settings say. Without a router it goes on alone,
/// and connects when one comes.
///
/// # Errors
/// [`OpenError`] when the configuration cannot be used, or a client finds no router.
pub fn open(settings: &Settings, reach: Reach) -> Result<(Session, RouterCheck), OpenError> {
    let mut config = settings.session()?;
    if reach == Reach::Off {
        for key in ["connect/endpoints", "listen/endpoints"] {
            insert(&mut config, key, "[]")?;
        }
    }
    let failed = |error: zenoh::Error| match &settings.connect {
        Some(endpoint) => OpenError::NoRouter { endpoint: endpoint.clone(), reason: reason(&error) },
        None => OpenError::Zenoh(reason(&error)),
    };
    let session = zenoh::open(config).wait().map_err(failed)?;
    let check = if reach == Reach::Off { RouterCheck::Skipped } else { look(&session, settings) };
    Ok((session, check))
}

/// Opens a further session for a moment, a client of the same routers; `None` where there is none.
#[must_use]
pub fn open_onlooker(settings: &Settings) -> Option<Session> {
    let mut config = settings.session().ok()?;
    let has_router = config.get_json("connect/endpoints").is_ok_and(|endpoints| endpoints != "[]");
    for (key, value) in [("mode", r#""client""#), ("listen/endpoints", "[]"), ("connect/timeout_ms", "2000")]
    {
        insert(&mut config, key, value).ok()?;
    }
    has_router.then(|| zenoh::open(config).wait().ok()).flatten()
}

/// What an error of Zenoh says, without the places in its source.
pub(crate) fn reason(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let mut said = text.trim_end();
    while let Some((before, place)) = said.rsplit_once(" at ") {
        if !place.contains(".rs:") {
            break;
        }
        said = before.trim_end_matches(['.', ' ']);
    }
    said.trim_end_matches(['!', '.']).to_owned()
}

fn look(session: &Session, settings: &Settings) -> RouterCheck {
    let until = match settings.router_check_attempts {
        ..0 => return RouterCheck::Skipped,
        0 => None,
        attempts => Some(Instant::now() + Duration::from_secs(attempts.unsigned_abs().min(86_400))),
    };
    loop {
        if session.info().routers_zid().wait().next().is_some() {
            return RouterCheck::Found;
        }
        if until.is_some_and(|until| Instant::now() >= until) {
            return RouterCheck::Missing;
        }
        std::thread::sleep(LOOK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_places_in_the_source_of_zenoh_are_left_out() {
        for (said, expected) in [
            ("no way at 10:00! at /a/session.rs:61.", "no way at 10:00"),
            ("in use (os error 98) at /a/tcp.rs:61. at /a/unicast.rs:432.", "in use (os error 98)"),
            ("Unable to connect.", "Unable to connect"),
        ] {
            assert_eq!(reason(&said.into()), expected);
        }
    }
}
