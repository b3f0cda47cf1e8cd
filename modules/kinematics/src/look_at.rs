//! Turning a camera to a point.

use crate::description::{DescriptionError, LinkId, Robot};
use crate::inverse::{InverseKinematics, Search};
use crate::pose::Pose;
use downbeat_transforms::Isometry;
use glam::DVec3;

/// Finds positions of the joints between a link and a camera with which the camera looks at a point.
///
/// The camera looks along the x axis of its link, as `camera_link` of REP-103 (not of its optical frame). The
/// point of this axis that is as far from the camera as the point to look at is brought there; because the
/// camera moves with its joints, this is repeated until the distance no longer changes.
///
/// ```
/// use downbeat_kinematics::{LookAt, Robot, Search};
/// use glam::DVec3;
///
/// let robot = Robot::read("../../robots/darwin_op.urdf")?;
/// let [base, camera] = [robot.link_id("base_link")?, robot.link_id("camera_link")?];
/// let mut look_at = LookAt::new(&robot, base, camera)?;
/// let mut positions = vec![0.0; 20];
/// let look = look_at.solve(DVec3::new(0.5, 0.2, -0.2), &mut positions, &Search::default());
/// assert!(look.is_reached && look.angle < 1e-6);
/// # Ok::<(), downbeat_kinematics::DescriptionError>(())
/// ```
#[derive(Clone, Debug)]
pub struct LookAt {
    robot: Robot,
    base: LinkId,
    camera: LinkId,
    chain: InverseKinematics,
    pose: Pose,
}

/// Where a camera looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Whether it looks at the point.
    pub is_reached: bool,
    /// Between its axis and the point, in rad.
    pub angle: f64,
}

/// How often the distance is corrected. Each correction divides its error by more than the distance is
/// greater than the arm of the camera.
const CORRECTIONS: usize = 20;

impl LookAt {
    /// For points in the frame of `base`.
    ///
    /// # Errors
    /// As [`InverseKinematics::new`].
    pub fn new(robot: &Robot, base: LinkId, camera: LinkId) -> Result<Self, DescriptionError> {
        let chain = InverseKinematics::new(robot, base, camera)?;
        Ok(Self { robot: robot.clone(), base, camera, chain, pose: Pose::new(robot) })
    }

    /// The indices of the positions that it changes.
    pub fn coordinates(&self) -> impl Iterator<Item = usize> {
        self.chain.coordinates()
    }

    /// Changes the positions of the robot, in rad and m, so that the camera looks at the point, or as nearly
    /// as was found. Nothing changes if the point is not finite.
    ///
    /// # Panics
    /// If there are fewer positions than coordinates of the robot.
    pub fn solve(&mut self, point: DVec3, positions: &mut [f64], search: &Search) -> Look {
        let search = Search { angle_weight: 0.0, ..*search };
        let mut look = Look { is_reached: false, angle: f64::INFINITY };
        if !point.is_finite() {
            return look;
        }
        let target = Isometry { translation: point, ..Isometry::IDENTITY };
        for _ in 0..CORRECTIONS {
            let distance = self.camera_from(point, positions).length();
            self.chain.set_end(Isometry::from_translation(distance, 0.0, 0.0));
            let found = self.chain.solve(&target, positions, &search);
            let seen = self.camera_from(point, positions);
            look = Look { is_reached: found.is_reached, angle: seen.angle_between(DVec3::X) };
            if (seen.length() - distance).abs() <= search.distance_tolerance || look.angle.is_nan() {
                break;
            }
        }
        look.is_reached &= look.angle <= 1e-3;
        look
    }

    /// The point as seen by the camera.
    fn camera_from(&mut self, point: DVec3, positions: &[f64]) -> DVec3 {
        self.pose.update(&self.robot, positions);
        self.pose.target_from_source(self.camera, self.base).transform_point(point)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::darwin_op::Head;

    #[test]
    fn the_head_of_the_darwin_op_turns_as_its_closed_form_says() {
        let robot = Robot::read("../../robots/darwin_op.urdf").unwrap();
        let [base, camera] = ["base_link", "camera_link"].map(|name| robot.link_id(name).unwrap());
        let mut look_at = LookAt::new(&robot, base, camera).unwrap();
        for point in [DVec3::new(0.3, 0.0, -0.2), DVec3::new(0.1, 0.4, -0.1), DVec3::new(2.0, -1.0, 0.3)] {
            let mut positions = vec![0.0; 20];
            let look = look_at.solve(point, &mut positions, &Search::default());
            let closed = Head.look_at(point);
            assert!(look.is_reached && closed.is_exact, "{look:?} {closed:?}");
            let [pan, tilt] =
                ["head_pan", "head_tilt"].map(|joint| positions[robot.coordinate(joint).unwrap()]);
            assert!(
                (pan - closed.pan).abs() < 1e-6 && (tilt - closed.tilt).abs() < 1e-6,
                "{pan} {tilt} {closed:?}"
            );
        }
    }

    #[test]
    fn what_is_behind_is_not_reached() {
        let robot = Robot::read("../../robots/darwin_op.urdf").unwrap();
        let [base, camera] = ["base_link", "camera_link"].map(|name| robot.link_id(name).unwrap());
        let mut look_at = LookAt::new(&robot, base, camera).unwrap();
        let mut positions = vec![0.0; 20];
        assert!(!look_at.solve(DVec3::new(-1.0, 0.1, 0.0), &mut positions, &Search::default()).is_reached);
        assert!(!look_at.solve(DVec3::NAN, &mut positions, &Search::default()).is_reached);
        assert!(positions.iter().all(|position| position.is_finite()));
    }
}
