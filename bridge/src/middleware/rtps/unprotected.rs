//! Security in a program that is built without it.

use downbeat_rtps::Security;
use downbeat_rtps::wire::GuidPrefix;

use crate::middleware::{MiddlewareError, ParticipantOptions, SecurityWatch};

/// How a participant is protected: there is no way.
pub(super) enum Protection {}

impl Protection {
    /// What the options ask for.
    pub(super) fn of(options: &ParticipantOptions) -> Result<Option<Self>, MiddlewareError> {
        let Some(security) = &options.security else { return Ok(None) };
        let reason = "this program is built without \"security\": build with --features security";
        if security.is_enforced {
            let reason = format!("ROS_SECURITY_STRATEGY=Enforce cannot be honoured: {reason}");
            return Err(MiddlewareError::Security { reason });
        }
        tracing::warn!("ROS_SECURITY_ENABLE=true: {reason}. This node joins without protection");
        Ok(None)
    }

    pub(super) fn guard(&self) -> Security {
        match *self {}
    }

    pub(super) fn subject_of(&self, _: GuidPrefix) -> Option<String> {
        match *self {}
    }

    pub(super) fn watch(&self) -> SecurityWatch {
        match *self {}
    }
}
