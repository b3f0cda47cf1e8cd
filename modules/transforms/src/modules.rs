//! What modules use: a buffer filled from `tf` and `tf_static`, and a broadcaster that publishes there.

use super::{Taken, TransformBuffer, TransformRefused};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use std::cell::RefCell;
use std::collections::BTreeSet;

/// The topic of transforms that change.
pub const TF: &str = "tf";

/// The topic of transforms that do not.
pub const TF_STATIC: &str = "tf_static";

/// As many frames are told of; what is wrong with more is wrong with all.
const MOST_TOLD: usize = 64;

/// Has a module's buffer take what comes on [`TF`] and [`TF_STATIC`]. What is not taken is told in the log once for each frame.
///
/// ```
/// use downbeat_executor::{Core, Module, Setup, SetupError};
/// use downbeat_transforms::{At, TransformBuffer, listen};
/// use std::time::Duration;
///
/// #[derive(Default)]
/// struct Looker {
///     transforms: TransformBuffer,
/// }
///
/// impl Module for Looker {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         listen(setup, |looker| &mut looker.transforms)?;
///         setup.every(Duration::from_secs(1), |looker: &mut Looker, _| {
///             match looker.transforms.lookup("base_link", "camera", At::Latest) {
///                 Ok(found) => tracing::info!("the camera is at {:?}", found.target_from_source),
///                 Err(error) => tracing::warn!("{error}"),
///             }
///         })
///     }
/// }
///
/// Core::new().add("looker", Looker::default())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If a topic carries another type, see [`Setup::subscribe`].
pub fn listen<M: Module, F>(setup: &mut Setup<'_, M>, buffer: F) -> Result<(), SetupError>
where
    F: Fn(&mut M) -> &mut TransformBuffer + Clone + Send + 'static,
{
    let (moving, mut told) = (buffer.clone(), Told::default());
    setup.subscribe(TF, move |module, message: Received<'_, TFMessage>, _| {
        for transform in &message.transforms {
            told.tell(transform, moving(module).insert(transform));
        }
    })?;
    let mut told = Told::default();
    setup.subscribe(TF_STATIC, move |module, message: Received<'_, TFMessage>, _| {
        for transform in &message.transforms {
            // What is fixed may be told again, and otherwise.
            let taken = buffer(module).insert_static(transform).map(|_| Taken::New);
            told.tell(transform, taken);
        }
    })
}

/// The frames whose transforms were told of.
#[derive(Default)]
struct Told {
    frames: BTreeSet<String>,
}

impl Told {
    fn tell(&mut self, transform: &TransformStamped, taken: Result<Taken, TransformRefused>) {
        let frame = &transform.child_frame_id;
        let problem = match taken {
            Ok(Taken::New | Taken::Known) => return,
            Ok(Taken::Replaced) => {
                let stamp = &transform.header.stamp;
                format!(
                    "two transforms of \"{frame}\" at {}.{:09}; the later one holds. Do two publish it?",
                    stamp.sec, stamp.nanosec
                )
            }
            Err(refused) => refused.to_string(),
        };
        if self.frames.len() < MOST_TOLD && self.frames.insert(frame.chars().take(64).collect()) {
            tracing::warn!("{problem} (told once)");
        }
    }
}

/// Publishes a module's transforms on `tf` and `tf_static`.
///
/// Each message on `tf_static` holds all static transforms that this broadcaster was given, the latest of each frame, as those
/// of tf2 do: who has the last message has all.
///
/// ```
/// use downbeat_executor::{Context, Core, Module, Setup, SetupError, TransitionError};
/// use downbeat_transforms::TransformBroadcaster;
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
