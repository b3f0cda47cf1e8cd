//! What modules of this package share with the messages of all releases.

use crate::Release;
use downbeat_executor::{Module, Setting, Setup, SetupError};

/// Evaluates an expression with the messages of a release as the module `$msg`: topics of one name have
/// another Rust type in each release in which the message differs.
macro_rules! with_messages_of {
    ($release:expr, $msg:ident => $body:expr) => {
        match $release {
            $crate::Release::V1_14 => {
                use $crate::v1_14::msg as $msg;
                $body
            }
            $crate::Release::V1_15 => {
                use $crate::v1_15::msg as $msg;
                $body
            }
            $crate::Release::V1_16 => {
                use $crate::v1_16::msg as $msg;
                $body
            }
            $crate::Release::V1_17 => {
                use $crate::v1_17::msg as $msg;
                $body
            }
        }
    };
}
pub(crate) use with_messages_of;

/// A `VehicleCommand`, without what is the same in all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Command {
    pub(crate) timestamp: u64,
    pub(crate) number: u32,
    pub(crate) params: [f32; 3],
    pub(crate) target_system: u8,
}

/// The component that [`Px4`](crate::Px4) sends commands as, and to: the autopilot, as in PX4's own examples
/// of offboard control.
pub(crate) const COMPONENT: u8 = 1;

/// Numbers of commands, states and results that are the same in all releases; a test compares them.
pub(crate) const DO_SET_MODE: u32 = 176;
pub(crate) const COMPONENT_ARM_DISARM: u32 = 400;
pub(crate) const NAV_LAND: u32 = 21;
pub(crate) const STATE_LOITER: u8 = 4;
pub(crate) const STATE_OFFBOARD: u8 = 14;
pub(crate) const STATE_LAND: u8 = 18;

/// `param1` of `DO_SET_MODE`: MAV_MODE_FLAG_CUSTOM_MODE_ENABLED of MAVLink.
pub(crate) const CUSTOM_MODE: f32 = 1.0;
/// `param2` of `DO_SET_MODE`: main modes of PX4 (`px4_custom_mode.h`).
pub(crate) const MAIN_MODE_AUTO: f32 = 4.0;
pub(crate) const MAIN_MODE_OFFBOARD: f32 = 6.0;
/// `param3` of `DO_SET_MODE`: sub mode of the main mode auto.
pub(crate) const SUB_MODE_LOITER: f32 = 3.0;

/// `MAV_RESULT` of MAVLink, in `VehicleCommandAck`.
pub(crate) mod result {
    pub(crate) const ACCEPTED: u8 = 0;
    pub(crate) const TEMPORARILY_REJECTED: u8 = 1;
    pub(crate) const DENIED: u8 = 2;
    pub(crate) const UNSUPPORTED: u8 = 3;
    pub(crate) const FAILED: u8 = 4;
    pub(crate) const IN_PROGRESS: u8 = 5;
    pub(crate) const CANCELLED: u8 = 6;

    /// In words.
    pub(crate) fn name(result: u8) -> String {
        match result {
            ACCEPTED => "accepted".to_owned(),
            TEMPORARILY_REJECTED => "temporarily rejected".to_owned(),
            DENIED => "denied".to_owned(),
            UNSUPPORTED => "unsupported".to_owned(),
            FAILED => "failed".to_owned(),
            IN_PROGRESS => "in progress".to_owned(),
            CANCELLED => "cancelled".to_owned(),
            other => format!("the unknown result {other}"),
        }
    }
}

/// Declares the setting `release` and returns it with its value.
pub(crate) fn release_setting<M: Module>(
    setup: &mut Setup<'_, M>,
) -> Result<(Setting<String>, Release), SetupError> {
    let about = "the release of PX4 whose messages are spoken; bytes of another one are misread";
    let key = setup.read_only_choice("release", Release::default().name(), &Release::NAMES, about)?;
    let name = setup.value(key).cloned().unwrap_or_default();
    let release = name.parse::<Release>().map_err(|error| setup.refuse_value(key, error.to_string()))?;
    Ok((key, release))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_commands_and_states_are_those_of_every_release() {
        for release in Release::ALL {
            with_messages_of!(release, msg => {
                use msg::{VehicleCommand as Command, VehicleCommandAck as Ack, VehicleStatus as Status};
                assert_eq!(u32::from(Command::VEHICLE_CMD_DO_SET_MODE), DO_SET_MODE);
                assert_eq!(u32::from(Command::VEHICLE_CMD_COMPONENT_ARM_DISARM), COMPONENT_ARM_DISARM);
                assert_eq!(u32::from(Command::VEHICLE_CMD_NAV_LAND), NAV_LAND);
                assert_eq!(Status::NAVIGATION_STATE_AUTO_LOITER, STATE_LOITER);
                assert_eq!(Status::NAVIGATION_STATE_OFFBOARD, STATE_OFFBOARD);
                assert_eq!(Status::NAVIGATION_STATE_AUTO_LAND, STATE_LAND);
                assert_eq!(Status::ARMING_STATE_ARMED, 2);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_ACCEPTED, result::ACCEPTED);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_TEMPORARILY_REJECTED, result::TEMPORARILY_REJECTED);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_DENIED, result::DENIED);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_UNSUPPORTED, result::UNSUPPORTED);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_FAILED, result::FAILED);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_IN_PROGRESS, result::IN_PROGRESS);
                assert_eq!(Ack::VEHICLE_CMD_RESULT_CANCELLED, result::CANCELLED);
            });
        }
    }
}
