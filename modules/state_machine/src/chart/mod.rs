//! Charts: states, transitions and what they do, as a file says.
//!
//! [`Chart::parse`] reads the subset of SCXML that docs/state_machine.md lists. A chart that exists is valid:
//! its ids are unique, targets exist and can be active together, expressions are syntactically valid.

mod parse;
mod validate;

use crate::expressions::{Problem, Program};
pub(crate) use parse::{ASSIGNED, duration};
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The namespace of SCXML.
pub(crate) const SCXML: &str = "http://www.w3.org/2005/07/scxml";
/// The namespace of the elements that connect a chart to topics, services, actions and settings.
pub const DOWNBEAT: &str = "urn:downbeat:state_machine";

/// A valid chart.
#[derive(Debug)]
pub struct Chart {
    pub(crate) path: PathBuf,
    pub(crate) name: String,
    /// Whether the data of a state get their values when it is first entered, not at the start.
    pub(crate) is_late: bool,
    /// In document order; the first is the whole chart.
    pub(crate) states: Vec<State>,
    /// In document order.
    pub(crate) transitions: Vec<Transition>,
    /// Scripts of the whole chart, run at the start.
    pub(crate) scripts: Vec<Program>,
    /// What connects it to a robot.
    pub interface: Interface,
    /// What is probably wrong although the chart can run: states that are never entered.
    pub findings: Vec<Problem>,
}

#[derive(Debug)]
pub(crate) struct State {
    /// Unique; made up for a state without one.
    pub(crate) id: String,
    pub(crate) line: u32,
    pub(crate) kind: StateKind,
    pub(crate) parent: Option<usize>,
    /// Without histories.
    pub(crate) children: Vec<usize>,
    pub(crate) histories: Vec<usize>,
    /// The transition of `<initial>`, or of a history's default.
    pub(crate) initial: Option<usize>,
    /// In document order.
    pub(crate) transitions: Vec<usize>,
    pub(crate) entry: Vec<Vec<Action>>,
    pub(crate) exit: Vec<Vec<Action>>,
    pub(crate) data: Vec<Data>,
    pub(crate) done_data: Payload,
    /// One past its last descendant.
    pub(crate) end: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StateKind {
    Compound,
    Atomic,
    Parallel,
    Final,
    Shallow,
    Deep,
}

#[derive(Debug)]
pub(crate) struct Transition {
    pub(crate) source: usize,
    /// Descriptors without `.*` at their ends; none for a transition without events.
    pub(crate) events: Vec<String>,
    pub(crate) condition: Option<Program>,
    pub(crate) targets: Vec<usize>,
    pub(crate) is_internal: bool,
    pub(crate) actions: Vec<Action>,
    pub(crate) line: u32,
}

#[derive(Debug)]
pub(crate) struct Data {
    pub(crate) id: String,
    pub(crate) value: Option<Program>,
    pub(crate) line: u32,
}

/// A text, or the expression that makes one.
#[derive(Debug)]
pub(crate) enum Given {
    Text(String),
    Computed(Program),
}

/// What an event carries.
#[derive(Debug, Default)]
pub(crate) enum Payload {
    #[default]
    None,
    Parameters(Vec<(String, Program)>),
    Content(Given),
}

#[derive(Debug)]
pub(crate) enum Action {
    Raise {
        event: String,
    },
    Send(Box<Send>),
    Cancel {
        id: Given,
        line: u32,
    },
    Log {
        label: String,
        value: Option<Program>,
        line: u32,
    },
    Assign {
        location: Program,
        value: Program,
    },
    Script(Program),
    /// The last condition may be missing: `<else>`.
    If {
        branches: Vec<(Option<Program>, Vec<Action>)>,
    },
    ForEach(Box<ForEach>),
}

#[derive(Debug)]
pub(crate) struct Send {
    pub(crate) event: Option<Given>,
    pub(crate) target: Option<Given>,
    pub(crate) kind: Option<Given>,
    pub(crate) id: Option<String>,
    /// Where a made-up id is stored.
    pub(crate) id_location: Option<Program>,
    pub(crate) delay: Option<Given>,
    pub(crate) payload: Payload,
    pub(crate) line: u32,
}

#[derive(Debug)]
pub(crate) struct ForEach {
    pub(crate) array: Program,
    pub(crate) item: Program,
    pub(crate) index: Option<Program>,
    pub(crate) body: Vec<Action>,
    /// The names of item and index, if they are plain variables.
    pub(crate) names: [Option<String>; 2],
}

/// What connects a chart to a robot, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interface {
    /// Topics that it receives.
    pub subscriptions: Vec<Port>,
    /// Topics that it publishes.
    pub publishers: Vec<Port>,
    /// Services that it calls.
    pub services: Vec<Port>,
    /// Actions that it uses.
    pub actions: Vec<Port>,
    /// Events in equal periods.
    pub timers: Vec<Timer>,
    /// Settings of its module.
    pub settings: Vec<ChartSetting>,
}

/// A topic, service or action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// The name that the robot knows, before remapping.
    pub topic: String,
    /// Such as `std_msgs/msg/String`.
    pub type_name: String,
    /// The name in the chart: of a variable, or of a target of `<send>`.
    pub name: String,
    /// The event of a message; `None` if messages only change the variable.
    pub event: Option<String>,
    /// How long a call may take.
    pub timeout: Duration,
    /// Where it is declared.
    pub line: u32,
}

/// An event in equal periods.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timer {
    /// At least 1 ms.
    pub period: Duration,
    /// The name of the event.
    pub event: String,
}

/// A setting of the module that runs a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartSetting {
    /// Its name, in expressions after `setting.`.
    pub name: String,
    /// Its purpose and unit.
    pub about: String,
    /// Its default.
    pub default: SettingDefault,
    /// The numbers that it may have.
    pub range: Option<(f64, f64)>,
    /// Where it is declared.
    pub line: u32,
}

/// The default of a setting, and with it its type.
#[derive(Clone, Debug, PartialEq)]
pub enum SettingDefault {
    /// `true` or `false`.
    Bool(bool),
    /// Digits alone.
    Integer(i64),
    /// Any other number.
    Number(f64),
    /// Anything else.
    Text(String),
}

/// A chart cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ChartError {
    /// The file.
    pub path: PathBuf,
    /// At least one, in the order of the file.
    pub problems: Vec<Problem>,
}

impl fmt::Display for ChartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, problem) in self.problems.iter().enumerate() {
            let separator = if number == 0 { "" } else { "\n" };
            write!(f, "{separator}{}:{problem}", self.path.display())?;
        }
        Ok(())
    }
}

impl Chart {
    /// Reads a chart. `path` is named in errors.
    ///
    /// # Errors
    /// Every problem that was found, with its line.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ChartError> {
        let fail = |problems| ChartError { path: path.to_owned(), problems };
        let mut chart = parse::parse(path, text).map_err(fail)?;
        validate::validate(&mut chart).map_err(fail)?;
        Ok(chart)
    }

    /// Reads a chart from its file.
    ///
    /// # Errors
    /// If the file cannot be read, or as [`parse`](Self::parse).
    pub fn read(path: &Path) -> Result<Self, ChartError> {
        let unreadable = |error: std::io::Error| ChartError {
            path: path.to_owned(),
            problems: vec![Problem { line: 1, text: format!("cannot read the file: {error}") }],
        };
        let size = std::fs::metadata(path).map_err(unreadable)?.len();
        if size > parse::LARGEST_FILE as u64 {
            return Err(unreadable(std::io::Error::other(parse::TOO_LARGE)));
        }
        Self::parse(path, &downbeat_msgs::user_file::read_text(path).map_err(unreadable)?)
    }

    /// The name that the file gives it, or the name of the file.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The ids of its states, in document order, without histories.
    pub fn states(&self) -> impl Iterator<Item = &str> {
        self.states.iter().skip(1).filter(|state| !state.is_history()).map(|state| state.id.as_str())
    }

    pub(crate) fn state(&self, id: &str) -> Option<usize> {
        self.states.iter().position(|state| state.id == id)
    }

    /// Whether `inner` is inside `outer`, and not the same.
    pub(crate) fn is_inside(&self, inner: usize, outer: usize) -> bool {
        outer < inner && inner < self.states[outer].end
    }

    /// From the parent outwards, to the whole chart.
    pub(crate) fn ancestors(&self, state: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(self.states[state].parent, |&state| self.states[state].parent)
    }

    /// The innermost state that is no parallel one and contains all of these.
    pub(crate) fn common_ancestor(&self, states: &[usize]) -> usize {
        let Some((&first, others)) = states.split_first() else { return 0 };
        let contains_others = |&outer: &usize| others.iter().all(|&other| self.is_inside(other, outer));
        let is_compound = |&outer: &usize| outer == 0 || self.states[outer].kind == StateKind::Compound;
        self.ancestors(first).filter(is_compound).find(contains_others).unwrap_or(0)
    }
}

impl State {
    pub(crate) fn is_history(&self) -> bool {
        matches!(self.kind, StateKind::Shallow | StateKind::Deep)
    }

    pub(crate) fn is_atomic(&self) -> bool {
        matches!(self.kind, StateKind::Atomic | StateKind::Final)
    }
}
