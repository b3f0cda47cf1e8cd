//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::transform_server::TransformServer;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![Kind::new(
        "transform_server",
        "the action tf2_buffer_server: lookups of transforms, for clients without a transform buffer",
        TransformServer::default,
    )]
}
