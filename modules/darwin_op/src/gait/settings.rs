//! The settings of the gait.

use super::capture::CaptureParameters;
use super::engine::{Limits, Parameters};
use crate::humanoid::Humanoid;
use downbeat_executor::{Context, Module, Setting, Setup, SetupError};
use downbeat_kinematics::leg::Side;

/// Declares settings with their ranges, and a struct of their values.
macro_rules! settings {
    ($($name:ident = $default:literal in $range:expr, $about:literal;)*) => {
        /// The keys to the settings.
        #[derive(Clone, Copy)]
        pub(super) struct SettingKeys {
            /// Whether the robot gets ready as soon as the module runs.
            pub(super) start: Setting<bool>,
            $($name: Setting<f64>,)*
        }

        /// The values of the settings, in SI units.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub(super) struct Settings {
            $(#[doc = $about] pub(super) $name: f64,)*
        }

        impl SettingKeys {
            pub(super) fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
                Ok(Self {
                    start: setup.setting("start", false, "whether the robot gets ready as soon as the module runs")?,
                    $($name: setup.setting_in(stringify!($name), $default, $range, $about)?,)*
                })
            }

            pub(super) fn values<P>(&self, ctx: &Context<'_, P>) -> Settings {
                Settings { $($name: *ctx.get(self.$name),)* }
            }
        }

        impl Default for Settings {
            fn default() -> Self {
                Self { $($name: $default,)* }
            }
        }
    };
}

settings! {
    period = 0.6 in 0.3..=3.0, "s; duration of two steps";
    double_support = 0.1 in 0.0..=0.6, "fraction of the period with both feet on the ground";
    foot_height = 0.04 in 0.0..=0.08, "m; how high a foot is lifted";
    sway = 0.02 in 0.0..=0.06, "m; how far the body sways to each side";
    nod = 0.005 in 0.0..=0.02, "m; half of how far the body goes down in double support";
    body_swing = 0.28 in -1.0..=1.0, "swing of the body forward and back, as a fraction of the step";
    pelvis_roll = 0.0 in 0.0..=0.3, "rad; roll of the supporting hip that keeps the pelvis level";
    stance_x = -0.003 in -0.06..=0.06, "m; how far the feet are ahead of the hips";
    walking_x = -0.0095 in -0.06..=0.06, "m; how much further they are ahead while the robot walks";
    stance_y = 0.0025 in -0.02..=0.04, "m; how far each foot is outside its hip";
    crouch = 0.015 in 0.0..=0.08, "m; how far the hips are below those of straight legs";
    hip_pitch = 0.25 in -0.3..=0.6, "rad; lean of the trunk forward";
    arm_swing = 15.0 in 0.0..=60.0, "rad/m; swing of the arms by half the distance of the feet";
    servo_lead = 0.035 in 0.0..=0.2, "s; goals are as far ahead of the trajectory, for servos lag behind a moving goal";
    stiffness = 2.0 in 1.0..=4.0, "goals of the legs are beyond the trajectory by this less 1, times what is missing: as with a higher P gain";
    balance_knee = 0.034 in 0.0..=0.5, "s; angle of the knees by pitch rate";
    balance_ankle_pitch = 0.1 in 0.0..=0.5, "s; angle of the ankles by pitch rate";
    balance_hip_roll = 0.056 in 0.0..=0.5, "s; angle of the hips by roll rate";
    balance_ankle_roll = 0.11 in 0.0..=0.5, "s; angle of the ankles by roll rate";
    lean_gain = 0.05 in 0.0..=0.5, "m/rad; how far the feet go forward if the trunk leans more than hip_pitch";
    step_gain = 0.0 in 0.0..=2.0, "share of an unexpected motion of the capture point that steps answer; 0: no step is moved";
    step_dead_zone = 0.015 in 0.0..=0.1, "m; steps are not moved by less";
    step_longest = 0.12 in 0.0..=0.2, "m; by how much steps are moved at most forward and backward";
    step_widest = 0.04 in 0.0..=0.2, "m; by how much steps are moved at most outward";
    step_haste = 10.0 in 0.0..=100.0, "1/m; how much sooner a step ends if the body falls to the side of the swinging foot";
    catching_period = 0.4 in 0.2..=2.0, "s; duration of two steps of a robot that stood and was pushed";
    catch_forward = 0.05 in 0.0..=0.2, "m; a robot that stands steps if its capture point is farther ahead";
    catch_backward = 0.055 in 0.0..=0.2, "m; or behind";
    catch_side = 0.2 in 0.0..=0.2, "m; or to a side; a robot cannot step to where it falls, so this is far";
    kick_length = 0.093 in 0.0..=0.15, "m; how far a foot that kicks swings ahead of its way";
    kick_period = 1.5 in 0.2..=2.0, "s; duration of two steps, while one of them kicks";
    kick_height = 0.045 in 0.0..=0.1, "m; how high a foot that kicks is lifted: if it touches the ground while it swings back, it turns the robot";
    kick_lean = 0.016 in 0.0..=0.1, "m; how far the trunk leans ahead against the swing of a kick";
    odometry_forward = 1.15 in 0.1..=2.0, "share of the way forward and backward that a walking robot really goes";
    odometry_side = 1.0 in 0.1..=2.0, "share of the way to a side that a walking robot really goes";
    odometry_drift = 0.25 in -2.0..=2.0, "m; how far a robot that steps to a side by 1 m drifts forward, which its legs do not measure";
    path_gain = 1.5 in 0.0..=10.0, "1/s; velocity by distance from where the commands lead, by odometry";
    heading_gain = 2.0 in 0.0..=10.0, "1/s; turn rate by deviation from the commanded heading";
    path_leash = 0.1 in 0.0..=1.0, "m; how far a robot that cannot follow its commands may be behind them; less for one that others steer by where it is";
    heading_leash = 0.5 in 0.0..=3.0, "rad; the same of its heading";
    max_forward = 0.25 in 0.0..=0.5, "m/s; largest velocity forward";
    max_backward = 0.13 in 0.0..=0.5, "m/s; largest velocity backward";
    max_side = 0.1 in 0.0..=0.3, "m/s; largest velocity to the side";
    max_turn = 0.8 in 0.0..=3.0, "rad/s; largest turn rate";
    acceleration = 0.2 in 0.01..=2.0, "m/s^2; largest acceleration";
    turn_acceleration = 2.0 in 0.1..=20.0, "rad/s^2; largest acceleration of a turn";
    braking = 1.0 in 0.1..=20.0, "how many times faster the robot slows down";
    command_timeout = 0.5 in 0.02..=60.0, "s; the robot stops this long after the last command";
    ready_speed = 1.0 in 0.1..=5.0, "rad/s; largest speed of a joint on the way to the stand";
}

impl Settings {
    /// The parameters of the engine.
    pub(super) fn parameters(&self) -> Parameters {
        Parameters {
            period: self.period,
            double_support: self.double_support,
            foot_height: self.foot_height,
            sway: self.sway,
            nod: self.nod,
            body_swing: self.body_swing,
            pelvis_roll: self.pelvis_roll,
            stance: [self.stance_x, self.stance_y, self.crouch],
            walking_shift: self.walking_x,
            catching_period: self.catching_period,
            kick_length: self.kick_length,
            kick_period: self.kick_period,
            kick_height: self.kick_height,
            kick_lean: self.kick_lean,
            limits: Limits {
                forward: self.max_forward,
                backward: self.max_backward,
                side: self.max_side,
                turn: self.max_turn,
                acceleration: self.acceleration,
                turn_acceleration: self.turn_acceleration,
                braking: self.braking,
            },
        }
    }

    /// How a robot answers pushes.
    pub(super) fn capture(&self, humanoid: &Humanoid) -> CaptureParameters {
        CaptureParameters {
            gain: self.step_gain,
            dead_zone: self.step_dead_zone,
            longest: [self.step_longest, self.step_widest],
            haste: self.step_haste,
            stand: [self.catch_forward, self.catch_backward, self.catch_side],
            half_width: humanoid.leg(Side::Left).leg.geometry().hip.y + self.stance_y,
        }
    }
}
