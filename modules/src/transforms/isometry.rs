//! Rigid transforms.

use glam::{DQuat, DVec3};
use std::ops::Mul;

/// A rotation, and then a translation: takes coordinates in one frame to coordinates in another one.
///
/// Named `target_from_source`, so that a chain reads `world_from_body * body_from_foot`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Isometry {
    /// Where the source's origin is in the target, in metres.
    pub translation: DVec3,
    /// How the source is turned in the target; of norm 1.
    pub rotation: DQuat,
}

impl Isometry {
    /// Takes everything to itself.
    pub const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// Moves and does not turn; metres.
    #[must_use]
    pub const fn from_translation(x: f64, y: f64, z: f64) -> Self {
        Self { translation: DVec3::new(x, y, z), rotation: DQuat::IDENTITY }
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { translation: -(rotation * self.translation), rotation }
    }

    /// The coordinates of a point in the target.
    #[must_use]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }
}

impl Default for Isometry {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Mul for Isometry {
    type Output = Self;

    /// First `rhs`, then `self`. Rounding does not take the rotation away from norm 1, however long the chain.
    fn mul(self, rhs: Self) -> Self {
        Self {
            translation: self.transform_point(rhs.translation),
            rotation: (self.rotation * rhs.rotation).normalize(),
        }
    }
}
