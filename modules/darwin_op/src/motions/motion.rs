//! Motions: key frames, and how joints move from one to the next.

use crate::joints::Joints;
use serde::Deserialize;

/// A motion: frames to go through.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// What it does, for people.
    pub about: String,
    /// How joints move from one frame to the next.
    pub interpolation: Interpolation,
    /// How stiff the joints are, in terms of the P gain of their servos: 1 to 4.
    pub stiffness: f64,
    /// How the ankles keep the robot on its feet; `None` if they do not, as for a motion of a robot that
    /// lies.
    pub balance: Option<Balance>,
    /// At least one.
    pub frames: Vec<Frame>,
}

/// By how much the ankles turn against a fall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Balance {
    /// By how much the trunk is off, in rad/rad, from 0 to 2.
    pub tilt: f64,
    /// By how fast it turns, in s, from 0 to 0.5.
    pub rate: f64,
}

/// A pose and how long the way to it takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// From the frame before, in s.
    pub duration: f64,
    /// How long the robot stays, in s.
    pub pause: f64,
    /// Angles in rad, in the order of the robot's joints; `None` for joints that the motion does not move.
    pub positions: Vec<Option<f64>>,
}

/// How joints move from one frame to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// With minimum jerk; at rest in each frame.
    #[default]
    Smooth,
    /// With continuous speed; at rest only where a joint turns back or the frame has a pause.
    Through,
    /// With constant speed between two frames.
    Linear,
}

impl Motion {
    /// The duration of the motion with its pauses, in s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.frames.iter().map(|frame| frame.duration + frame.pause).sum()
    }

    /// The motion with left and right exchanged.
    pub(super) fn mirrored(&self, joints: &Joints) -> Self {
        let frames = self.frames.iter().map(|frame| {
            let positions = joints.iter().map(|joint| {
                let (other, sign) = joint.mirror;
                frame.positions[other].map(|position| position * sign)
            });
            Frame { positions: positions.collect(), ..*frame }
        });
        Self { frames: frames.collect(), ..self.clone() }
    }
}
