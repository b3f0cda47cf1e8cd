//! Publishing transforms.

use super::{TF, TF_STATIC};
use downbeat_executor::{Context, Module, Publication, Setup, SetupError};
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use std::cell::RefCell;

/// Publishes a module's transforms on `tf` and `tf_static`.
///
/// Each message on `tf_static` holds all static transforms that this broadcaster was given, the latest of each frame, as those
/// of tf2 do: who has the last message has all.
///
/// ```
/// use downbeat_executor::{Context, Core, Module, Setup, SetupError, TransitionError};
/// use downbeat_modules::transforms::TransformBroadcaster;
/// use downbeat_msgs::geometry_msgs::msg::TransformStamped;
///
/// struct Camera;
///
/// impl Module for Camera {
///     type Ports = TransformBroadcaster;
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<TransformBroadcaster, SetupError> {
///         TransformBroadcaster::declare(setup)
///     }
///
///     fn activate(&mut self, ctx: &mut Context<'_, TransformBroadcaster>) -> Result<(), TransitionError> {
///         let mut mount = TransformStamped { child_frame_id: "camera".into(), ..TransformStamped::default() };
///         mount.header.frame_id = "head".into();
///         ctx.ports.send_static(ctx, [mount]);
///         Ok(())
///     }
/// }
///
/// Core::new().add("camera", Camera)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct TransformBroadcaster {
    tf: Publication<TFMessage>,
    tf_static: Publication<TFMessage>,
    /// Changed through the shared reference that callbacks have to their ports.
    fixed: RefCell<Vec<TransformStamped>>,
}

impl TransformBroadcaster {
    /// Declares in a module's setup that it publishes transforms.
    ///
    /// # Errors
    /// If a topic carries another type, see [`Setup::publish`].
    pub fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
        Ok(Self { tf: setup.publish(TF)?, tf_static: setup.publish(TF_STATIC)?, fixed: RefCell::default() })
    }

    /// Publishes transforms that change, in one message.
    pub fn send<P>(&self, ctx: &mut Context<'_, P>, transforms: impl IntoIterator<Item = TransformStamped>) {
        ctx.publish(self.tf, TFMessage { transforms: transforms.into_iter().collect() });
    }

    /// Publishes transforms that do not change, with those that were sent before.
    pub fn send_static<P>(
        &self,
        ctx: &mut Context<'_, P>,
        transforms: impl IntoIterator<Item = TransformStamped>,
    ) {
        let mut fixed = self.fixed.borrow_mut();
        for transform in transforms {
            match fixed.iter_mut().find(|known| known.child_frame_id == transform.child_frame_id) {
                Some(known) => *known = transform,
                None => fixed.push(transform),
            }
        }
        ctx.publish(self.tf_static, TFMessage { transforms: fixed.clone() });
    }
}
