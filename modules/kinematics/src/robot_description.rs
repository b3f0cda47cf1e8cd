//! The setting of modules that need a robot description.

use crate::Robot;
use downbeat_executor::{Module, Setting, Setup, SetupError};

/// A robot and its URDF.
pub(crate) struct Description {
    pub(crate) robot: Robot,
    pub(crate) text: String,
}

/// Declares the setting `robot_description`; `None` if it has no value, for [`NoDescription`] when the module
/// starts.
pub(crate) fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Option<Description>, SetupError> {
    let what = "the URDF file, relative to the robot file; or its text";
    let key: Setting<String> = setup.read_only_setting("robot_description", String::new(), what)?;
    let given = setup.value(key).cloned().unwrap_or_default();
    if given.is_empty() {
        return Ok(None);
    }
    match Robot::load(&given) {
        Ok((robot, text)) => {
            robot.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
            Ok(Some(Description { robot, text }))
        }
        Err(error) => Err(setup.refuse_value(key, error.to_string())),
    }
}

/// A module cannot start without a description.
#[derive(Debug, thiserror::Error)]
#[error(
    "the setting \"robot_description\" is missing: name a URDF file, such as robot_description = \"robots/darwin_op.urdf\""
)]
pub(crate) struct NoDescription;
