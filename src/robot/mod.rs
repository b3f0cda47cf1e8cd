//! Robots from robot files: modules in a core, ready to run.
//!
//! A robot file specifies the modules of a robot, their settings, what is exposed and what is recorded.
//! `docs/robot_files.md` of the repository is its reference. A [`Catalog`] contains the kinds, launchers and
//! interfaces that it can name.

mod actions;
mod build;
mod catalog;
mod commanders;
mod expose;
mod feature_kinds;
mod file;
mod kind;
mod lifecycle;
mod parameters;
mod profile;
mod recorded;
mod recorded_settings;
mod ros_args;
#[cfg(feature = "sensors")]
mod sensors;
mod services;
mod survey;
mod versions;

pub use actions::Exposures;
pub use build::Robot;
pub(crate) use catalog::unregistered;
pub use catalog::{Catalog, CatalogError};
pub use downbeat_bridge::expose::{EndpointReport, EndpointTraffic, ExposedEndpoint};
pub use downbeat_bridge::middleware::Direction;
#[cfg(test)]
pub(crate) use feature_kinds::kinds_of_features;
#[cfg(all(feature = "cli", feature = "view"))]
pub(crate) use file::FOXGLOVE_PORT;
#[cfg(all(feature = "cli", feature = "football"))]
pub(crate) use file::Place;
#[cfg(any(feature = "cli", feature = "view"))]
pub(crate) use file::Source;
pub(crate) use file::toml_string;
pub use file::{
    ActionEntry, ClockChoice, ExposeEntry, ExposeSection, LauncherChoice, LauncherEntry, LifecycleEntry,
    ModuleEntry, NodeFeatures, RecordEntry, RecordOptions, ReplaySection, RobotFile, RobotFileError,
    TopicChoice, ViewAccess, ViewEntry,
};
pub use kind::{Kind, ModuleSource};
#[cfg(feature = "cli")]
pub(crate) use parameters::{
    NodeParameter, is_wildcard, matches, parameters_of_nodes, setting_value, yaml_values,
};
pub use profile::{
    KeyProfile, KindProfile, PROFILE_SCHEMA, PanelProfile, PortKind, PortProfile, PortRole, Runs,
    SettingProfile,
};
pub use recorded_settings::ChangedSetting;
pub(crate) use recorded_settings::{RecordedSettings, use_recorded_settings};
pub use ros_args::{LogArguments, LogLevel, ParameterArgument, RosArgs, RosArgsError};
pub(crate) use survey::Survey;
#[cfg(feature = "cli")]
pub(crate) use versions::FOLDER as SOURCES_FOLDER;
pub use versions::LastVersion;
pub(crate) use versions::{
    Live, ReplayedTime, SourcedModules, Sources, VersionLog, VersionsInBag, reloads_of,
};
