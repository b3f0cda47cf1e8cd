//! Odometry of a walking robot: the foot on the ground does not move, so the body moves by what the leg
//! measures.
//!
//! With p the position of the sole that carries the robot in the trunk, and R the orientation of the trunk in
//! the world, from the IMU:
//!
//! (1)  displacement = R' p' - R p, of the old over the new pose
//!
//! The lower sole carries the robot. A foot that slips, or turns over an edge, makes an error that is not
//! noticed. What of a way is lost like that in every step is known of a gait: two shares, of the way forward
//! and of that to a side, are what is really gone. A robot that steps to a side also drifts forward or
//! backward by a share of that way.

use glam::{DQuat, DVec2, DVec3};

/// Where base_link is in the world, from the legs and the orientation of the trunk.
#[derive(Clone, Debug, Default)]
pub(super) struct Odometry {
    /// In m, from where it began, with z above the sole that carries the robot.
    pub(super) position: DVec3,
    /// In m/s, smoothed.
    pub(super) velocity: DVec3,
    /// The way of the body, in m.
    pub(super) way: f64,
    /// Which sole carries the robot, and both soles with respect to the base in axes of the world.
    last: Option<(usize, [DVec3; 2])>,
}

/// How much lower the other sole must be to carry the robot, in m.
const HYSTERESIS: f64 = 0.003;

/// Time constant of the velocity, in s: about one step.
const SMOOTHING: f64 = 0.3;

/// The longest way in a step of time, in m. More is not a walk: the joints were not measured for a while.
const LONGEST: f64 = 0.05;

impl Odometry {
    /// Takes a way forward that the legs do not measure, in m.
    pub(super) fn drift(&mut self, forward: f64, world_from_base: DQuat) {
        let way = DVec2::from_angle(yaw_of(world_from_base)) * forward;
        self.position += way.extend(0.0);
    }

    /// Takes the soles in the base and the orientation of the base in the world, `dt` in s after the last
    /// ones. Of the way forward and to the left, these `shares` are gone.
    pub(super) fn update(&mut self, soles: [DVec3; 2], world_from_base: DQuat, shares: DVec2, dt: f64) {
        let soles = soles.map(|sole| world_from_base * sole);
        let (support, displacement) = match self.last {
            None => (usize::from(soles[1].z < soles[0].z), DVec3::ZERO),
            Some((support, before)) => {
                let other = 1 - support;
                let changes = soles[other].z + HYSTERESIS < soles[support].z;
                (if changes { other } else { support }, before[support] - soles[support])
            }
        };
        self.last = Some((support, soles));
        if displacement.length() > LONGEST {
            return;
        }
        let displacement = if shares == DVec2::ONE {
            displacement
        } else {
            let heading = DVec2::from_angle(yaw_of(world_from_base));
            let ahead = DVec2::new(heading.x, -heading.y).rotate(displacement.truncate());
            heading.rotate(ahead * shares).extend(displacement.z)
        };
        self.position.x += displacement.x;
        self.position.y += displacement.y;
        self.position.z = -soles[support].z;
        self.way += libm::hypot(displacement.x, displacement.y);
        if dt > 0.0 {
            let share = (dt / SMOOTHING).min(1.0);
            self.velocity += (displacement / dt - self.velocity) * share;
        }
    }
}

/// The yaw of an orientation, in rad.
pub(super) fn yaw_of(rotation: DQuat) -> f64 {
    let DQuat { x, y, z, w } = rotation;
    libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
}

/// The pitch of an orientation, in rad: positive if it leans forward.
pub(super) fn pitch_of(rotation: DQuat) -> f64 {
    libm::asin((-(rotation * DVec3::X).z).clamp(-1.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_body_moves_against_the_lower_sole() {
        let mut odometry = Odometry::default();
        let turned = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let soles = |x: f64, lift: f64| [DVec3::new(x, 0.04, -0.2), DVec3::new(-x, -0.04, -0.2 + lift)];
        odometry.update(soles(0.01, 0.02), turned, DVec2::ONE, 0.008);
        odometry.update(soles(-0.01, 0.02), turned, DVec2::ONE, 0.008);
        let DVec3 { x, y, z } = odometry.position;
        assert!(x.abs() < 1e-12 && (y - 0.02).abs() < 1e-12 && (z - 0.2).abs() < 1e-12);
        odometry.update(soles(-0.01, -0.02), turned, DVec2::ONE, 0.008);
        odometry.update(soles(0.01, -0.02), turned, DVec2::ONE, 0.008);
        assert!((odometry.position.y - 0.04).abs() < 1e-12, "the other foot carries it on");
        let before = odometry.position;
        odometry.update(soles(0.02, -0.02), turned, DVec2::new(0.5, 0.8), 0.008);
        assert!((odometry.position.y - before.y - 0.005).abs() < 1e-12, "half of the way forward");
        odometry.drift(0.1, turned);
        assert!((odometry.position.y - before.y - 0.105).abs() < 1e-12, "a way that the legs do not measure");
        assert!((yaw_of(turned) - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }
}
