//! The protection of a participant by an enclave of a keystore.

use std::sync::Arc;
use std::time::SystemTime;

use downbeat_rtps::Security;
use downbeat_rtps::wire::GuidPrefix;
use downbeat_security::enclave::Enclave;
use downbeat_security::guard::{Credentials, SecurityGuard, Status};

use crate::middleware::{MiddlewareError, ParticipantOptions, SecurityState, SecurityWatch};

/// How a participant is protected.
pub(super) struct Protection {
    credentials: Arc<Credentials>,
    status: Status,
    warnings: Vec<String>,
}

impl Protection {
    /// What the options ask for. Where security is not enforced, a keystore that cannot be used means none.
    pub(super) fn of(options: &ParticipantOptions) -> Result<Option<Self>, MiddlewareError> {
        let Some(security) = &options.security else { return Ok(None) };
        match Self::load(options) {
            Ok(protection) => Ok(Some(protection)),
            Err(MiddlewareError::Security { reason }) if !security.is_enforced => {
                tracing::warn!(
                    "this node joins without protection, since ROS_SECURITY_STRATEGY is not Enforce: {reason}"
                );
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn load(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        let Some(security) = &options.security else {
            return Err(MiddlewareError::Security { reason: "security is not enabled".to_owned() });
        };
        let folder = security.folder()?;
        let failed = |reason: String| MiddlewareError::Security { reason };
        let now = SystemTime::now();
        let enclave = Enclave::load(&folder, now).map_err(|error| failed(error.to_string()))?;
        let credentials = Credentials::new(&enclave, options.domain_id.into(), now);
        let credentials = credentials.map_err(|denial| failed(denial.to_string()))?;
        enclave.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
        tracing::info!(
            "protected by {} as {}{}",
            folder.display(),
            credentials.subject(),
            if security.is_enforced { "" } else { "; ROS_SECURITY_STRATEGY is not Enforce" }
        );
        Ok(Self { credentials: Arc::new(credentials), status: Status::default(), warnings: enclave.warnings })
    }

    /// What the engine makes its guard with.
    pub(super) fn guard(&self) -> Security {
        let (credentials, status) = (Arc::clone(&self.credentials), self.status.clone());
        Security::new(move |candidate| {
            let guard =
                SecurityGuard::new(Arc::clone(&credentials), candidate, Box::new(random), status.clone());
            (guard.prefix(), Box::new(guard))
        })
    }

    pub(super) fn subject_of(&self, participant: GuidPrefix) -> Option<String> {
        self.status.subject(participant)
    }

    pub(super) fn watch(&self) -> SecurityWatch {
        let (subject, status) = (self.credentials.subject().to_owned(), self.status.clone());
        let warnings = self.warnings.clone();
        Box::new(move || {
            let (refused, refusals) = status.refusals();
            SecurityState {
                subject: subject.clone(),
                authenticated: status.authenticated(),
                refused,
                refusals,
                warnings: warnings.clone(),
            }
        })
    }
}

fn random(bytes: &mut [u8]) {
    // It fails only where the system has no source at all. Keys that can be guessed are worse than none.
    getrandom::fill(bytes).expect("random numbers of the system");
}
