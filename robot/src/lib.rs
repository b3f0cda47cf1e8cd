//! Robots from robot files: modules in a core, ready to run.
//!
//! A robot file specifies the modules of a robot, their settings, what is exposed and what is recorded.
//! `docs/robot_files.md` of the repository is its reference. A [`Catalog`] contains the kinds, launchers and
//! interfaces that it can name.

mod actions;
mod build;
mod built_in;
mod catalog;
pub mod causes;
mod commanders;
mod controllers;
#[cfg(feature = "tables")]
pub mod dataset;
pub mod encoding;
mod expose;
mod failure;
pub mod features;
mod file;
pub mod inspect;
pub mod journal;
mod latencies;
mod lifecycle;
pub mod parameters;
pub mod playback;
mod profile;
pub mod record_options;
mod recorded;
mod recorded_settings;
pub mod recorder;
pub mod replay;
mod ros_args;
pub mod ros_recorder;
pub mod running;
mod services;
mod snapshot_condition;
mod survey;
pub mod table;
mod versions;

pub use actions::Exposures;
pub use build::Robot;
#[cfg(test)]
pub(crate) use built_in::kinds_of_features;
pub(crate) use catalog::unregistered;
pub use catalog::{Catalog, CatalogError};
pub use downbeat_bridge::expose::{EndpointReport, EndpointTraffic, ExposedEndpoint};
pub use downbeat_bridge::middleware::Direction;
pub use downbeat_files::duration;
pub use downbeat_kind::{Kind, ModuleSource};
pub use failure::{Failure, TestResult, in_one_line};
#[cfg(feature = "view")]
pub use file::FOXGLOVE_PORT;
#[cfg(feature = "football")]
pub use file::Place;
pub use file::Source;
pub use file::toml_string;
pub use file::{
    ActionEntry, ClockChoice, ExposeEntry, ExposeSection, LauncherChoice, LauncherEntry, LifecycleEntry,
    ModuleEntry, NetworkEntry, NodeFeatures, RecordEntry, ReplaySection, RobotFile, RobotFileError,
    TopicChoice, ViewAccess, ViewEntry,
};
pub use latencies::{ChainReport, Latencies};
pub use profile::{
    KeyProfile, KindProfile, PROFILE_SCHEMA, PanelProfile, PortKind, PortProfile, PortRole, Runs,
    SettingProfile,
};
pub use record_options::RecordOptions;
pub use recorded_settings::ChangedSetting;
pub(crate) use recorded_settings::{RecordedSettings, recorded_modules, use_recorded_settings};
pub use ros_args::{LogArguments, LogLevel, ParameterArgument, RosArgs, RosArgsError};
pub(crate) use survey::Survey;
pub use versions::FOLDER as SOURCES_FOLDER;
pub use versions::LastVersion;
pub(crate) use versions::{
    Live, ReplayedTime, SourcedModules, Sources, VersionLog, VersionsInBag, reloads_of,
};
