//! Options of the server.

use crate::page::PageOptions;
use downbeat_edge::KnownType;
use std::fmt;
use std::hint::black_box;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// What the server shows, to whom, and within which limits.
#[derive(Clone)]
pub struct ViewOptions {
    /// The name that viewers display.
    pub name: String,
    /// The address on which the server listens; 127.0.0.1 by default, which only programs of this machine
    /// reach.
    pub address: IpAddr,
    /// The port for Foxglove, Lichtblick and PlotJuggler; 8765 by default, as they suggest. 0 takes a free
    /// one, and `None` serves none of them.
    pub foxglove: Option<u16>,
    /// The page of our own, if it is served; it is not by default.
    pub page: Option<PageOptions>,
    /// Who may change the robot.
    pub access: Access,
    /// Whether a topic is shown, by its name in the core, without a leading slash. All are by default.
    pub topics: Arc<dyn Fn(&str) -> bool + Send + Sync>,
    /// The topics of which a viewer receives the last messages when it subscribes, and how many of them.
    pub latched: Vec<(String, usize)>,
    /// The types of topics whose messages pass through the core as bytes ([`KnownType::is_raw`]).
    pub raw: Vec<(String, KnownType)>,
    /// The folders behind `package://NAME/`, by name. Other packages are looked for in `AMENT_PREFIX_PATH`.
    pub packages: Vec<(String, PathBuf)>,
    /// Whose time viewers show.
    pub time: ViewTime,
    /// Bounds of memory and work.
    pub limits: Limits,
}

/// Who may publish, call services and set parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nobody.
    ReadOnly,
    /// Viewers whose URL ends with `?token=` and this token.
    Token(Token),
    /// Every viewer that can connect, and so every web page that a browser on this machine opens.
    Open,
}

/// A secret that a viewer proves to know.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// A token cannot be used.
#[derive(Debug, Error)]
pub enum TokenError {
    /// The text cannot stand in a URL, or is easy to guess.
    #[error("a token has 8 to 128 characters, only letters, digits, - and _; leave it out for a random one")]
    Text,
    /// The system has no random numbers.
    #[error("the system gives no random numbers for a token: {0}")]
    Random(getrandom::Error),
}

/// Whose time viewers show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ViewTime {
    /// That of the viewer's machine.
    #[default]
    Viewer,
    /// That of the core, for robots in simulated or replayed time.
    Core,
}

/// Bounds of memory and work. What exceeds them costs the viewer, not the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Viewers at a time; more are refused. Four times as many connections may fetch files of the page.
    pub clients: usize,
    /// Topics shown.
    pub channels: usize,
    /// Subscriptions of one viewer.
    pub subscriptions: usize,
    /// Topics on which one viewer publishes.
    pub publications: usize,
    /// Calls of services of one viewer that wait for a response.
    pub calls: usize,
    /// Bytes of one message from a viewer; the connection is closed if it sends a longer one.
    pub incoming_bytes: usize,
    /// Messages from a viewer per second, on average; the connection is closed if it sends more.
    pub incoming_per_second: u32,
    /// Messages that wait for one viewer.
    pub backlog_messages: usize,
    /// Bytes that wait for one viewer.
    pub backlog_bytes: usize,
    /// Bytes of a file that a viewer fetches.
    pub asset_bytes: u64,
    /// How long a viewer may take to read anything, and to complete the handshake, before it is disconnected.
    pub stall: Duration,
}

impl ViewOptions {
    /// The default options, with a random token.
    ///
    /// # Errors
    /// If the system has no random numbers.
    pub fn new(name: &str) -> Result<Self, TokenError> {
        Ok(Self {
            name: name.to_owned(),
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            foxglove: Some(8765),
            page: None,
            access: Access::Token(Token::random()?),
            topics: Arc::new(|_| true),
            latched: Vec::new(),
            raw: Vec::new(),
            packages: Vec::new(),
            time: ViewTime::default(),
            limits: Limits::default(),
        })
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            clients: 16,
            channels: 2000,
            subscriptions: 1000,
            publications: 64,
            calls: 64,
            incoming_bytes: 4 << 20,
            incoming_per_second: 2000,
            backlog_messages: 1024,
            backlog_bytes: 16 << 20,
            asset_bytes: 64 << 20,
            stall: Duration::from_secs(10),
        }
    }
}

impl Access {
    /// True if a viewer that gave this token may change the robot.
    pub(crate) fn admits(&self, given: Option<&str>) -> bool {
        match self {
            Self::ReadOnly => false,
            Self::Token(token) => given.is_some_and(|given| token.is(given)),
            Self::Open => true,
        }
    }
}

impl Token {
    /// A token of 128 random bits.
    ///
    /// # Errors
    /// If the system has no random numbers.
    pub fn random() -> Result<Self, TokenError> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(TokenError::Random)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// A token of the user's choice.
    ///
    /// # Errors
    /// If it has fewer than 8 or more than 128 characters, or others than letters, digits, `-` and `_`.
    pub fn new(text: &str) -> Result<Self, TokenError> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if (8..=128).contains(&text.len()) && text.chars().all(is_plain) {
            Ok(Self(text.to_owned()))
        } else {
            Err(TokenError::Text)
        }
    }

    /// The text that stands in the URL.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Compares in a time that depends only on the length, so that a guess cannot be improved byte by byte.
    fn is(&self, given: &str) -> bool {
        let (token, given) = (self.0.as_bytes(), given.as_bytes());
        let differences = token.iter().zip(given).fold(0, |found, (a, b)| black_box(found | (a ^ b)));
        token.len() == given.len() && differences == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl fmt::Debug for ViewOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ViewOptions")
            .field("name", &self.name)
            .field("address", &self.address)
            .field("foxglove", &self.foxglove)
            .field("page", &self.page)
            .field("access", &self.access)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_the_whole_token_is_the_token() {
        let token = Token::new("0123456789abcdef").unwrap();
        let access = Access::Token(token.clone());
        assert!(access.admits(Some("0123456789abcdef")));
        for wrong in ["", "0123456789abcde", "0123456789abcdef0", "0123456789abcdeg", "1123456789abcdef"] {
            assert!(!access.admits(Some(wrong)), "{wrong}");
        }
        assert!(!access.admits(None));
        assert!(!Access::ReadOnly.admits(Some("0123456789abcdef")));
        assert!(Access::Open.admits(None));
        assert_eq!(format!("{token:?}"), "Token(..)");
    }

    #[test]
    fn random_tokens_differ_and_stand_in_a_url() {
        let (one, two) = (Token::random().unwrap(), Token::random().unwrap());
        assert_ne!(one.as_str(), two.as_str());
        assert_eq!(Token::new(one.as_str()).unwrap(), one);
        for wrong in ["short", "with space", "with&ampersand", &"x".repeat(129)] {
            assert!(Token::new(wrong).is_err(), "{wrong}");
        }
    }
}
