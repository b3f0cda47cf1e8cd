//! A robot from its robot file: modules in a core, ready to run.
//!
//! A robot file names a robot's modules, their settings, what is exposed and what is recorded:
//!
//! ```toml
//! [robot]
//! name = "darwin_op"                  # the name of the ROS 2 node
//! namespace = "/"                     # its namespace, none unless given
//! launcher = "pool"                   # or "linear", the default
//! threads = 2
//!
//! [[module]]
//! name = "hardware"
//! kind = "darwin_op"                  # `downbeat check --kinds` lists them
//! settings = { port = "/dev/ttyUSB0" }
//! remap = { joint_commands = "joint_goals" }
//!
//! [expose]
//! out = ["joint_states", { topic = "imu/data_raw", qos = "sensor_data" }]
//! in = [{ topic = "joint_commands", type = "sensor_msgs/msg/JointState" }]
//!
//! [record]
//! topics = "all"
//! compression = "zstd"
//! ```
//!
//! - `[[module]]`: `kind` is needed; `name` is the kind unless given. Modules start in the order of the file.
//! - `settings`: `downbeat check --kinds` lists them, with defaults and units.
//! - `remap`: from the module's own name of a topic to the one to use.
//! - `[expose]`: topics that go `out` to ROS 2 or come `in`; a name, or a table with `topic`, `as` (another name in
//!   ROS 2), `type` (checked if given) and `qos`: a preset (`default`, `sensor_data`, `latched`, …) or a table with
//!   `preset`, `reliability`, `durability`, `history`, `depth`, `deadline_ms`.
//! - `[record]`: what `--record` writes: `topics`, "all" or a list; `compression`, "none" or "zstd".
//!
//! What is wrong with a file is told with its path and line, and the nearest valid name.

mod build;
mod file;
mod kinds;

pub use build::Robot;
pub use file::{Direction, ExposeEntry, LauncherChoice, ModuleEntry, RecordEntry, RobotFile, RobotFileError};
pub use kinds::{KINDS, Kind};
