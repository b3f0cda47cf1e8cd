//! A module's buffer, filled from `tf` and `tf_static`.

use super::{Taken, TransformBuffer, TransformRefused};
use downbeat_executor::{Module, Received, Setup, SetupError};
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
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
/// use downbeat_modules::transforms::{At, TransformBuffer, listen};
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
