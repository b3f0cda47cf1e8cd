//! How the core holds its stage.

use std::sync::Arc;

use crate::Stage;

/// The stage, shared with the threads of the launcher where there are some. One that the core has for itself costs
/// nothing to reach, which counts: it is reached in every cycle.
pub(super) enum StageHolder {
    Own(Box<Stage>),
    Shared(Arc<Stage>),
}

impl StageHolder {
    /// The stage between process phases, when nobody else holds it.
    ///
    /// # Panics
    /// If a launcher has kept a clone of the stage, which its contract forbids.
    #[inline]
    pub(super) fn exclusive(&mut self) -> &mut Stage {
        #[expect(clippy::expect_used, reason = "a broken launcher leaves nothing that could go on")]
        self.get_mut().expect("the launcher kept the stage beyond the process phase")
    }

    /// The stage, unless somebody else holds it.
    pub(super) fn get_mut(&mut self) -> Option<&mut Stage> {
        match self {
            Self::Own(stage) => Some(stage),
            Self::Shared(stage) => Arc::get_mut(stage),
        }
    }

    /// The stage as launchers take it.
    pub(super) fn shared(&mut self) -> &mut Arc<Stage> {
        if let Self::Own(stage) = self {
            *self = Self::Shared(Arc::new(std::mem::take(&mut **stage)));
        }
        match self {
            Self::Shared(stage) => stage,
            Self::Own(_) => unreachable!("it was made shared above"),
        }
    }
}

impl std::ops::Deref for StageHolder {
    type Target = Stage;

    fn deref(&self) -> &Stage {
        match self {
            Self::Own(stage) => stage,
            Self::Shared(stage) => stage,
        }
    }
}
