//! Ready-made robot modules, and building blocks for modules.
//!
//! - [`servo_bus`]: the hardware of any robot of serial servos, which a file describes;
//! - [`servo_emulator`]: emulated ones behind a pseudo terminal, or in memory;
//! - [`controllers`]: as users of ros2_control know them;
//! - [`darwin_op`]: the hardware of the humanoid Darwin OP;
//! - [`darwin_op_emulator`]: an emulated one behind a pseudo terminal;
//! - [`device`]: for use in modules: devices whose answers are recorded and replayed;
//! - [`counted`]: for use in modules: faults that are logged less and less often;
//! - [`serial_port`]: for use in modules: why a serial port cannot be opened;
//! - [`stamps`]: for use in modules: whether commands with stamps are current;
//! - [`imu_filter`]: orientation from gyroscope and accelerometer;
//! - [`gait`]: walks with the velocity on `cmd_vel`;
//! - [`motions`]: plays key-frame motions;
//! - [`falls`]: detects falls and gets up;
//! - [`joint_command_mux`]: decides which commands joints get;
//! - [`joint_state_merger`]: joint states of several buses as one;
//! - [`kinematics`]: robot descriptions; a module that answers where links are and how joints bring them
//!   elsewhere;
//! - [`robot_state_publisher`]: transforms of all links;
//! - [`humanoid`]: what gait, motions and falls have to know of a robot;
//! - [`stand_nod_wave`]: a small motion;
//! - `px4` (feature `px4`): PX4 autopilots: their messages, frames and time;
//! - [`actions`] and [`transforms`]: actions that modules serve and use; where frames are over time;
//! - [`transform_server`]: an action that answers transform lookups.
//!
//! Each is a part of one of the packages in `modules/`, which programs without robot files can use alone.
//!
//! The page of each module lists its topics and settings; `modules/README.md` has an overview.

pub use downbeat_actions as actions;
pub use downbeat_darwin_op::{
    emulator as darwin_op_emulator, falls, gait, hardware as darwin_op, humanoid, motions, stand_nod_wave,
};
pub use downbeat_device::{self as device, counted, serial_port};
pub use downbeat_imu_filter as imu_filter;
pub use downbeat_kinematics::{self as kinematics, joint_state_merger, robot_state_publisher};
#[cfg(feature = "px4")]
pub use downbeat_px4 as px4;
pub use downbeat_servos::{controllers, joint_command_mux, servo_bus, servo_emulator, stamps};
pub use downbeat_transforms::{self as transforms, transform_server};
