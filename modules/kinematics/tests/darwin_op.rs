//! The description of the Darwin OP.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::Robot;

fn darwin_op() -> Robot {
    Robot::read("../../robots/darwin_op.urdf").unwrap()
}

#[test]
fn it_has_the_published_mass_and_frames() {
    let robot = darwin_op();
    let bodies = robot.bodies().unwrap();
    let mass: f64 = bodies.iter().filter_map(|body| body.mass).map(|mass| mass.mass).sum();
    assert!((mass - 2.925).abs() < 5e-4, "{mass}");
    assert_eq!((bodies.len(), robot.coordinates().len()), (21, 20));
    assert_eq!(robot.root().name, "base_link");
    for frame in ["torso", "imu_link", "camera_link", "camera_optical_frame", "l_sole", "r_sole"] {
        robot.link_id(frame).unwrap();
    }
}

#[test]
fn its_left_side_mirrors_its_right() {
    let robot = darwin_op();
    let mut pairs = 0;
    for right in robot.links() {
        let Some(name) = right.name.strip_prefix("r_") else { continue };
        let left = robot.link(robot.link_id(&format!("l_{name}")).unwrap());
        let (Some(of_right), Some(of_left)) = (right.inertial, left.inertial) else { continue };
        let (at_right, at_left) =
            (of_right.link_from_inertial.translation, of_left.link_from_inertial.translation);
        assert_eq!((at_right.x, at_right.y, at_right.z), (at_left.x, -at_left.y, at_left.z), "{name}");
        assert_eq!((of_right.mass, of_right.inertia), (of_left.mass, of_left.inertia), "{name}");
        let [of_right, of_left] = [right, left].map(|link| robot.joint(link.parent.unwrap()));
        assert_eq!(
            (*of_right.range().start(), *of_right.range().end()),
            (-of_left.range().end(), -of_left.range().start())
        );
        pairs += 1;
    }
    assert_eq!(pairs, 9);
}
