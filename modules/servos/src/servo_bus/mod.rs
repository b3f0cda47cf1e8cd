//! Robots of serial servos: Dynamixel and Feetech, described by a file.
//!
//! - [`protocol`] and [`models`] define data and its meaning, without input or output;
//! - [`bus`] accesses the devices: a serial port, or a recording of one;
//! - [`Description`] says which joints and devices are on which bus;
//! - [`Hardware`] is what the modules of all such robots share;
//! - [`ServoBus`] is the module; [`ServoPort`] finds and configures single servos.
//!
//! It has never been run on hardware, only on the emulated servos of
//! [`servo_emulator`](crate::servo_emulator).

pub mod bus;
pub mod models;
pub mod protocol;

mod calibration;
mod description;
mod diagnostics;
mod driver;
mod fault_text;
mod first_description;
mod joint;
mod limp;
mod line;
mod module;
mod preparation;
mod reading;
mod servo;
mod tool;

pub use calibration::{Calibrator, JointCalibration, JointOffset, Tuner, TurnedJoint, ZeroPose};
pub use description::{BusPlan, Description, DescriptionError, DevicePlan, ImuPlan, PowerSwitch};
pub use first_description::first_description;
pub use joint::{Drive, Guard, Joint, Measurement, Protection, Quantity, Registers, Thresholds};
pub use module::{Hardware, ImuReading, SLOW, ServoBus, Topics, battery_state};
pub use reading::Reading;
pub use tool::{Caution, Found, ServoError, ServoPort};

#[cfg(test)]
mod tests;
