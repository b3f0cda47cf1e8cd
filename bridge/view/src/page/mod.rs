//! The page of our own: its files, what it asks, and the panels that modules bring.

mod asks;
mod files;
pub(crate) mod http;

use serde_json::Value;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

pub(crate) use asks::answer;

/// The name of the page's WebSocket protocol: Foxglove's, with questions and answers.
pub(crate) const SUBPROTOCOL: &str = "downbeat.view.v1";

/// The port of the page unless another is asked for.
pub const PAGE_PORT: u16 = 7373;

/// The page of our own, which a browser opens.
#[derive(Clone, Default)]
pub struct PageOptions {
    /// The port; 0 takes a free one, and `None` takes [`PAGE_PORT`], or a free one where that is in use.
    pub port: Option<u16>,
    /// Names of this machine under which browsers may open the page, besides `localhost` and addresses. Pages
    /// of other names are refused, so that no web page reaches the robot by pointing a name of its own to
    /// this machine.
    pub hosts: Vec<String>,
    /// The file of the page that opens; `index.html` if it is empty.
    pub start: &'static str,
    /// What the modules are, by their names.
    pub modules: BTreeMap<String, ModuleProfile>,
    /// The panels that modules bring.
    pub panels: Vec<Panel>,
    /// Answers what the core cannot.
    pub host: Option<Arc<dyn Host>>,
}

/// What a module of the robot is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ModuleProfile {
    /// Its kind.
    pub kind: String,
    /// The file with its code, if it is loaded from one.
    pub source: Option<PathBuf>,
    /// How it differs from other modules of its kind, or what the kind is for.
    pub description: Option<String>,
}

/// A panel that a module brings to the page: a JavaScript module whose default export has `title` and
/// `create(root, robot, view)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panel {
    /// Its name in URLs: letters, digits, `-` and `_`.
    pub name: String,
    /// Its title.
    pub title: String,
    /// The module that brings it.
    pub module: String,
    /// The script.
    pub script: PanelScript,
    /// The topics that it shows, by the names that the robot uses.
    pub topics: Vec<String>,
}

/// Where the script of a panel is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PanelScript {
    /// In the program.
    Text(Cow<'static, str>),
    /// In a file, which is read whenever a browser asks for it.
    File(PathBuf),
}

/// A question of the page.
#[derive(Clone, Copy, Debug)]
pub struct Ask<'a> {
    /// What is asked for.
    pub name: &'a str,
    /// Its arguments, an object.
    pub arguments: &'a Value,
    /// True if the viewer has proven that it may change things.
    pub may_change: bool,
}

impl Ask<'_> {
    /// The refusal for a viewer without the token.
    ///
    /// # Errors
    /// If the viewer may only look.
    pub fn check_access(&self) -> Result<(), String> {
        let refusal = "this page may only look: open it with the URL that the program printed at its start";
        if self.may_change { Ok(()) } else { Err(refusal.to_owned()) }
    }

    /// An argument that is text.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.arguments.get(name)?.as_str()
    }

    /// An argument that must be there, as text.
    ///
    /// # Errors
    /// If it is missing, or not text.
    pub fn require_text(&self, name: &str) -> Result<&str, String> {
        self.text(name).ok_or_else(|| format!("the question \"{}\" lacks the text \"{name}\"", self.name))
    }
}

/// Answers questions of the page that concern more than the core: recording, the log, a robot file that is
/// edited.
pub trait Host: Send + Sync + 'static {
    /// The answer, or `None` if it does not know the question. It is called on threads of the server, for
    /// several questions at once.
    ///
    /// # Errors
    /// In words for the user.
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>>;
}

impl fmt::Debug for PageOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PageOptions")
            .field("port", &self.port)
            .field("hosts", &self.hosts)
            .finish_non_exhaustive()
    }
}
