//! Why a device did not do what it was asked.

use crate::servo_bus::bus::LineSettings;
use crate::servo_bus::line::ECHO;
use crate::servo_bus::protocol::{Id, StatusError};

/// What to do about answers that are not understood.
pub(super) const GARBLED: &str = "Two servos may have this id: connect one at a time and give each its own with `downbeat servo set-id`; otherwise \
     the line is disturbed";

/// Why a device did not do what it was asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ServoError {
    /// The port cannot be opened, or was lost.
    #[error("{0}")]
    Port(String),
    /// No answer.
    #[error("{}: no answer from id {id} at {} bit/s in {}; is it powered, and are speed and protocol right? `downbeat servo scan` finds it", path, line.baud, line.protocol)]
    Silent {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// How it was asked.
        line: LineSettings,
    },
    /// Bytes came that are no answer.
    #[error("{path}: what comes from id {id} at {} bit/s is not understood. {GARBLED}", line.baud)]
    Garbled {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// How it was asked.
        line: LineSettings,
    },
    /// What is sent comes back.
    #[error("{path}: {ECHO}; no device can be told from the echo")]
    Echo {
        /// The port.
        path: String,
    },
    /// The device answered with an error.
    #[error("{path}: id {id} at {} bit/s refuses to {doing}: {error}; {}", line.baud, error.remedy())]
    Refused {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// What it was asked to do.
        doing: String,
        /// Its answer.
        error: StatusError,
    },
    /// The model is unknown.
    #[error("{path}: id {id} at {} bit/s is model {}, which is unknown; name a file with its registers with --model-file", line.baud, number.map_or("?".to_owned(), |number| number.to_string()))]
    UnknownModel {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// The number of its model.
        number: Option<u16>,
    },
    /// The model is another one than described.
    #[error("{path}: id {id} at {} bit/s is a {found}, and is described as a {described}; correct its model in the description, or, if ids are mixed up, give it its own with `downbeat servo set-id`", line.baud)]
    OtherModel {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// The model in the description.
        described: String,
        /// The model that answers.
        found: String,
    },
    /// The servo is not what is described, or cannot be driven as described.
    #[error("{path}: servo {id} ({name}) at {} bit/s cannot be used: {reason}; correct its description, or exchange it", line.baud)]
    Unsuitable {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// The joint.
        name: String,
        /// How it was asked.
        line: LineSettings,
        /// Why.
        reason: String,
    },
    /// The model has no such register.
    #[error("{model} has no register \"{register}\"{near}")]
    UnknownRegister {
        /// The model.
        model: String,
        /// What was asked for.
        register: String,
        /// The most similar register, in words.
        near: String,
    },
    /// The value cannot be written.
    #[error("\"{register}\" of {model} takes {min} to {max}, not {value}")]
    Range {
        /// The model.
        model: String,
        /// The register.
        register: String,
        /// The smallest value.
        min: i64,
        /// The largest value.
        max: i64,
        /// The given one.
        value: i64,
    },
    /// A write that can do harm.
    #[error("{0}; repeat with --force if that is intended")]
    Dangerous(String),
}
