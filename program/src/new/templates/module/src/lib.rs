//! A module for robots of downbeat: `level_head` holds the head level.
//!
//! ```
//! let app = my_robot::register(downbeat::App::new());
//! assert!(app.catalog()?.kind("level_head").is_some());
//! # Ok::<(), downbeat::Failure>(())
//! ```

mod level_head;

use downbeat::App;

pub use level_head::{HeadTilt, INTERFACES, LevelHead};

/// Registers the kind `level_head` and its message.
#[must_use]
pub fn register(app: App) -> App {
    app.interfaces(INTERFACES).kind("level_head", "holds the head level", LevelHead::default)
}
