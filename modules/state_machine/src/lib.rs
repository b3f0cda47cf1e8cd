//! Decisions of a robot as statecharts in files: a subset of SCXML with expressions in rhai.
//!
//! ```
//! use downbeat_state_machine::{Chart, Dynamic, Event, Interpreter};
//! use std::{path::Path, sync::Arc, time::Duration};
//!
//! let chart = Chart::parse(Path::new("door.scxml"), r#"
//!     <scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0">
//!         <state id="closed"><transition event="push" target="open"/></state>
//!         <state id="open">
//!             <onentry><send event="tired" delay="2s"/></onentry>
//!             <transition event="tired" target="closed"/>
//!         </state>
//!     </scxml>"#)?;
//! let mut door = Interpreter::new(Arc::new(chart), "door");
//! door.start(Duration::ZERO);
//! door.send(Event::new("push", Dynamic::UNIT));
//! door.advance(Duration::from_secs(1));
//! assert_eq!(door.active().collect::<Vec<_>>(), ["open"]);
//! door.advance(Duration::from_secs(3));
//! assert_eq!(door.active().collect::<Vec<_>>(), ["closed"]);
//! # Ok::<(), downbeat_state_machine::ChartError>(())
//! ```
//!
//! The subset, and how a chart is connected to a robot: docs/state_machine.md.

mod budget;
mod chart;
mod check;
mod condition;
mod draw;
mod expressions;
mod functions;
mod interpreter;
mod kinds;
mod module;
mod values;
mod world;

downbeat_msgs::include_interfaces!();

pub use chart::{Chart, ChartError, ChartSetting, DOWNBEAT, Interface, Port, SettingDefault, Timer};
pub use condition::Condition;
pub use expressions::Problem;
pub use interpreter::{Effect, Event, Interpreter, Memory};
pub use kinds::kinds;
pub use module::{StateMachineOptions, load};
pub use rhai::{Dynamic, Map};

/// The panel of the robot's page that shows the chart: a JavaScript module (docs/panels.md).
pub const PANEL: &str = include_str!("chart.panel.js");
