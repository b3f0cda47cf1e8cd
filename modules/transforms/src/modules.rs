//! For use in modules: a buffer filled from `tf` and `tf_static`, and a broadcaster that publishes on them.

use super::{Taken, TransformBuffer, TransformRefused};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use std::cell::RefCell;
use std::collections::BTreeSet;

/// The topic of transforms that change.
pub const TF: &str = "tf";

/// The topic of static transforms.
pub const TF_STATIC: &str = "tf_static";

/// The maximum number of frames that are logged.
const MOST_TOLD: usize = 64;

/// Fills a module's buffer from [`TF`] and [`TF_STATIC`]. Rejected transforms are logged once for each frame.
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
/// Returns an error if a topic carries another type, see [`Setup::subscribe`].
pub fn listen<M: Module, F>(setup: &mut Setup<'_, M>, buffer: F) -> Result<(), SetupError>
where
    F: Fn(&mut M) -> &mut TransformBuffer + Clone + Send + 'static,
{
    let (moving, mut warnings) = (buffer.clone(), Warnings::default());
    setup.subscribe(TF, move |module, message: Received<'_, TFMessage>, _| {
        for transform in &message.transforms {
            warnings.report(transform, moving(module).insert(transform));
        }
    })?;
    let mut warnings = Warnings::default();
    setup.subscribe(TF_STATIC, move |module, message: Received<'_, TFMessage>, _| {
        for transform in &message.transforms {
            // Static transforms may be repeated and replaced.
            let taken = buffer(module).insert_static(transform).map(|_| Taken::New);
            warnings.report(transform, taken);
        }
    })
}

/// The frames that were logged.
#[derive(Default)]
struct Warnings {
    frames: BTreeSet<String>,
}

impl Warnings {
    fn report(&mut self, transform: &TransformStamped, taken: Result<Taken, TransformRefused>) {
        let frame = &transform.child_frame_id;
        let problem = match taken {
            Ok(Taken::New | Taken::Known) => return,
            Ok(Taken::Replaced) => {
                let stamp = &transform.header.stamp;
                format!(
                    "two transforms of \"{frame}\" at {}.{:09}; the later one is used. Are there two publishers?",
                    stamp.sec, stamp.nanosec
                )
            }
            Err(refused) => refused.to_string(),
        };
        if self.frames.len() < MOST_TOLD && self.frames.insert(frame.chars().take(64).collect()) {
            tracing::warn!("{problem} (reported once)");
        }
    }
}

/// Publishes a module's transforms on `tf` and `tf_static`.
///
/// As in tf2, each message on `tf_static` contains all static transforms of this broadcaster, the latest of
/// each frame, so that the last message is sufficient.
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
    /// Interior mutability, since callbacks have a shared reference to their ports.
    fixed: RefCell<Vec<TransformStamped>>,
}

impl TransformBroadcaster {
    /// Declares in a module's setup that it publishes transforms.
    ///
    /// # Errors
    /// Returns an error if a topic carries another type, see [`Setup::publish`].
    pub fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
        Ok(Self { tf: setup.publish(TF)?, tf_static: setup.publish(TF_STATIC)?, fixed: RefCell::default() })
    }

    /// Publishes transforms that change, in one message.
    pub fn send<P>(&self, ctx: &mut Context<'_, P>, transforms: impl IntoIterator<Item = TransformStamped>) {
        ctx.publish(self.tf, TFMessage { transforms: transforms.into_iter().collect() });
    }

    /// Publishes static transforms, together with all earlier ones.
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
