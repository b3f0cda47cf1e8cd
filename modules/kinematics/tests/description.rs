//! What the library says about good and bad robot descriptions.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::Robot;
use downbeat_kinematics::description::{Geometry, JointKind};
use std::path::PathBuf;

const ARM: &str = r#"<robot name="arm">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base"/>
  <joint name="turn" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="3" velocity="4"/>
  </joint>
  <link name="upper">
    <inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02"/></inertial>
    <visual><geometry><mesh filename="upper.stl"/></geometry><material name="red"/></visual>
    <collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
  </link>
  <joint name="weld" type="fixed"><parent link="upper"/><child link="hand"/><origin xyz="1 0 0"/></joint>
  <link name="hand"><inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02"/></inertial></link>
  <joint name="finger" type="prismatic">
    <parent link="hand"/> <child link="tip"/>
    <axis xyz="1 0 0"/> <limit lower="0" upper="0.1" effort="1" velocity="1"/>
    <mimic joint="turn" multiplier="0.5" offset="0.25"/>
  </joint>
  <link name="tip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
</robot>"#;

fn arm() -> Robot {
    Robot::from_urdf(ARM, "arm.urdf").unwrap()
}

/// The message for the arm with a change.
fn message(from: &str, to: &str) -> String {
    assert!(ARM.contains(from), "{from}");
    Robot::from_urdf(&ARM.replacen(from, to, 1), "arm.urdf").unwrap_err().to_string()
}

#[test]
fn links_and_joints_are_in_tree_order_with_what_the_file_says() {
    let arm = arm();
    assert_eq!((arm.name(), &*arm.root().name), ("arm", "base"));
    let names: Vec<&str> = arm.links().iter().map(|link| &*link.name).collect();
    assert_eq!(names, ["base", "upper", "hand", "tip"]);
    let [turn, weld, finger] = arm.joints() else { panic!("three joints") };
    assert_eq!(
        (turn.kind, weld.kind, finger.kind),
        (JointKind::Revolute, JointKind::Fixed, JointKind::Prismatic)
    );
    assert_eq!((turn.range(), finger.range()), (-1.0..=2.0, 0.0..=0.1));
    let upper = arm.link(turn.child);
    assert_eq!((upper.line, upper.collisions.len()), (10, 1));
    assert!(
        matches!(upper.collisions[0].geometry, Geometry::Box { size } if size.to_array() == [0.1, 0.2, 0.3])
    );
    assert_eq!(upper.visuals[0].material.as_ref().unwrap().rgba, Some([1.0, 0.0, 0.0, 1.0]));
    assert_eq!(
        (arm.coordinate("turn"), arm.coordinate("finger"), arm.coordinate("weld")),
        (Some(0), None, None)
    );
    let drive = finger.drive.unwrap();
    assert_eq!((drive.coordinate, drive.multiplier, drive.offset), (0, 0.5, 0.25));
}

#[test]
fn children_may_stand_before_their_parents() {
    let lines: Vec<&str> = ARM.lines().collect();
    let turned = format!("{}\n{}\n{}\n</robot>", lines[0], lines[15..22].join("\n"), lines[1..15].join("\n"));
    let reordered = Robot::from_urdf(&turned, "arm.urdf").unwrap();
    let names = |robot: &Robot| robot.links().iter().map(|link| link.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&reordered), names(&arm()));
    assert_eq!(reordered.joints()[2].parent.index(), 2);
}

#[test]
fn links_joined_by_fixed_joints_are_one_body() {
    let bodies = arm().bodies().unwrap();
    assert_eq!(bodies.len(), 3);
    assert_eq!((bodies[0].mass, bodies[0].joint), (None, None));
    let mass = bodies[1].mass.unwrap();
    assert_eq!((mass.mass, mass.center_of_mass.to_array()), (4.0, [0.5, 0.0, 0.0]));
    // Two masses of 2 kg, each 0.5 m from the common centre.
    assert_eq!(mass.inertia.to_cols_array(), [0.04, 0.0, 0.0, 0.0, 1.04, 0.0, 0.0, 0.0, 1.04]);
    assert_eq!(bodies[1].links.len(), 2);
}

#[test]
fn broken_trees_are_refused() {
    assert_eq!(
        message("<parent link=\"base\"/>", "<parent link=\"tip\"/>"),
        "arm.urdf:17: the joints \"turn\", \"weld\", \"finger\" form a loop: links form a tree, so remove one of them"
    );
    assert_eq!(
        message("<child link=\"tip\"/>", "<child link=\"hand\"/>"),
        "arm.urdf:17: link \"hand\" is the child of joint \"finger\" and of joint \"weld\" (line 15): links form a tree, so \
         remove one of the two"
    );
    assert_eq!(
        message("<link name=\"base\"/>", "<link name=\"base\"/><link name=\"odd\"/>"),
        "arm.urdf:3: the links \"base\", \"odd\" have no parent: connect them with joints to a single root"
    );
    assert_eq!(
        message("<parent link=\"hand\"/>", "<parent link=\"hnad\"/>"),
        "arm.urdf:18: there is no link \"hnad\", did you mean \"hand\"?"
    );
    assert_eq!(
        message("joint name=\"weld\"", "joint name=\"turn\""),
        "arm.urdf:15: joint \"turn\" is already defined in line 4: rename one of them"
    );
    assert_eq!(
        Robot::from_urdf("<robot name=\"x\"/>", "x.urdf").unwrap_err().to_string(),
        "x.urdf:1: the robot has no links: add <link name=\"base_link\"/>"
    );
}

#[test]
fn bad_joints_are_refused() {
    assert_eq!(
        message("<limit lower=\"-1\" upper=\"2\" effort=\"3\" velocity=\"4\"/>", ""),
        "arm.urdf:4: joint \"turn\" has no <limit>: add <limit lower=\"...\" upper=\"...\" effort=\"...\" velocity=\"...\"/>, or \
         make it continuous"
    );
    assert_eq!(
        message("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>"),
        "arm.urdf:7: the axis of joint \"turn\" has length 0: write a direction, such as \"0 0 1\""
    );
    assert_eq!(
        message("type=\"prismatic\"", "type=\"screw\""),
        "arm.urdf:17: joint \"finger\" has type \"screw\": supported are revolute, continuous, prismatic, fixed, floating \
         and planar"
    );
    assert_eq!(
        message("mimic joint=\"turn\"", "mimic joint=\"finger\""),
        "arm.urdf:17: joint \"finger\" mimics \"finger\", which follows it in turn: remove one <mimic>"
    );
    assert!(message("effort=\"3\" ", "").contains("arm.urdf:8: joint \"turn\" has no effort"));
}

#[test]
fn bad_numbers_are_refused() {
    assert_eq!(
        message("xyz=\"0 0 0.1\"", "xyz=\"0 nan 0.1\""),
        "arm.urdf:6: xyz=\"0 nan 0.1\" of joint \"turn\" is not 3 finite numbers"
    );
    assert!(message("xyz=\"0 0 0.1\"", "xyz=\"0 0\"").contains("is not 3 finite numbers"));
    assert!(message("effort=\"3\"", "effort=\"3,5\"").contains("is not a finite number"));
    assert_eq!(
        message("mass value=\"2\"", "mass value=\"-2\""),
        "arm.urdf:11: mass of link \"upper\" is -2, and must be 0 or more"
    );
    assert!(message("mass value=\"2\"", "mass value=\"inf\"").contains("is not a finite number"));
    assert!(
        message("size=\"0.1 0.2 0.3\"", "size=\"0.1 -1 0.3\"")
            .contains("size of link \"upper\" is -1, and must be 0 or more")
    );
}

/// The arm with a change, and the only warning about it.
fn odd(from: &str, to: &str) -> (Robot, String) {
    assert!(ARM.contains(from), "{from}");
    let robot = Robot::from_urdf(&ARM.replacen(from, to, 1), "arm.urdf").unwrap();
    let [warning] = robot.warnings() else { panic!("{from}: {:?}", robot.warnings()) };
    let warning = warning.to_string();
    (robot, warning)
}

#[test]
fn odd_joints_are_accepted_with_a_warning() {
    assert_eq!(arm().warnings(), []);
    let (robot, warning) = odd("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 3 4\"/>");
    assert_eq!(
        warning,
        "arm.urdf:7: the axis \"0 3 4\" of joint \"turn\" has length 5: it is read as \"0 0.6 0.8\""
    );
    assert_eq!(robot.joints()[0].axis.to_array(), [0.0, 0.6000000000000001, 0.8]);
    let (robot, warning) = odd("lower=\"-1\" upper=\"2\"", "lower=\"3\" upper=\"2\"");
    assert_eq!(warning, "arm.urdf:8: joint \"turn\" has the limits 3 to 2: they are read as 2 to 3");
    assert_eq!(robot.joints()[0].range(), 2.0..=3.0);
    let (robot, warning) =
        odd("<joint name=\"weld\" type=\"fixed\">", "<joint name=\"weld\" type=\"spherical\">");
    assert_eq!(
        warning,
        "arm.urdf:15: joint \"weld\" is spherical, which URDF does not have: it is read as floating"
    );
    assert_eq!(robot.joints()[1].kind, JointKind::Floating);
    // A joint that mimics none that could lead it is like any other.
    let (robot, warning) = odd("mimic joint=\"turn\"", "mimic joint=\"weld\"");
    assert_eq!(
        warning,
        "arm.urdf:20: joint \"finger\" mimics \"weld\", and \"weld\" has no position: <mimic> is ignored"
    );
    assert_eq!(robot.coordinate("finger"), Some(1));
    let (robot, warning) = odd("mimic joint=\"turn\"", "mimic joint=\"trun\"");
    assert_eq!(
        warning,
        "arm.urdf:20: joint \"finger\" mimics \"trun\", but there is no joint \"trun\", did you mean \"turn\"?: <mimic> is \
         ignored"
    );
    assert_eq!(robot.coordinate("finger"), Some(1));
    let weld = "<joint name=\"weld\" type=\"fixed\">";
    let (_, warning) = odd(weld, &format!("{weld}<mimic joint=\"turn\"/>"));
    assert!(warning.starts_with("arm.urdf:15: joint \"weld\" mimics \"turn\", and \"weld\" has no position"));
}

#[test]
fn odd_shapes_are_accepted_with_a_warning() {
    let (robot, warning) = odd("<material name=\"red\"/></visual>", "<material name=\"rod\"/></visual>");
    assert_eq!(
        warning,
        "arm.urdf:12: there is no material \"rod\", did you mean \"red\"?: the shape has no colour"
    );
    let upper = &robot.links()[1];
    assert_eq!(upper.visuals[0].material.as_ref().unwrap().name, "rod");
    let (robot, warning) = odd("size=\"0.1 0.2 0.3\"", "size=\"0.1 0 0.3\"");
    assert_eq!(
        warning,
        "arm.urdf:13: size of link \"upper\" is 0: the shape has no extent, and collides with nothing"
    );
    assert!(!robot.links()[1].collisions[0].geometry.has_volume());
    for empty in ["<sphere radius=\"0\"/>", "<cylinder radius=\"1\" length=\"0\"/>"] {
        let (robot, _) = odd("<box size=\"0.1 0.2 0.3\"/>", empty);
        assert!(!robot.links()[1].collisions[0].geometry.has_volume());
    }
    let (robot, warning) = odd("<box size=\"0.1 0.2 0.3\"/>", "<capsule radius=\"1\" length=\"1\"/>");
    assert!(
        warning.starts_with("arm.urdf:13: link \"upper\" has a shape <capsule>: it is ignored"),
        "{warning}"
    );
    assert_eq!(robot.links()[1].collisions, []);
    let (robot, warning) = odd("rgba=\"1 0 0 1\"", "rgba=\"1 0 0\"");
    assert!(warning.starts_with("arm.urdf:2: rgba=\"1 0 0\" of material \"red\""), "{warning}");
    assert_eq!(robot.links()[1].visuals[0].material.as_ref().unwrap().rgba, None);
}

#[test]
fn odd_numbers_and_files_are_accepted_with_a_warning() {
    let (robot, warning) = odd("xyz=\"0 0 0.1\"", "xyz=\"0 0 0.1 5\"");
    assert!(warning.contains("xyz=\"0 0 0.1 5\" of joint \"turn\" has more than 3 numbers"), "{warning}");
    assert_eq!(robot.joints()[0].parent_from_joint, arm().joints()[0].parent_from_joint);
    let (robot, warning) = odd("xyz=\"0 0 0.1\"", "xyz=\"0, 0, 0.1\"");
    assert!(warning.contains("has commas, which are read as spaces"), "{warning}");
    assert_eq!(robot.joints()[0].parent_from_joint, arm().joints()[0].parent_from_joint);
    let (robot, warning) = odd("<robot name=\"arm\">", "<robot>");
    assert_eq!(robot.name(), "arm");
    assert!(warning.starts_with("arm.urdf:1: the robot has no name: it is called \"arm\""), "{warning}");

    let declared = format!("<?xml version=\"1.0\"?>{ARM}");
    for before in ["\n\n", "text\n\n", "<!-- made by hand -->\n\n"] {
        let text = format!(
            "{before}{}",
            declared.replace("<material name=\"red\"/></v", "<material name=\"rod\"/></v")
        );
        let robot = Robot::from_urdf(&text, "arm.urdf").unwrap();
        let lines: Vec<u32> = robot.warnings().iter().map(|warning| warning.line).collect();
        assert_eq!(lines, [1, 14], "{before}");
        assert_eq!(robot.links()[1].line, 12);
    }
    assert_eq!(Robot::from_urdf(&format!("\u{feff}{declared}"), "arm.urdf").unwrap().warnings(), []);
    let zeros = Robot::from_urdf(&format!("{declared}\n\0\0"), "arm.urdf").unwrap();
    assert_eq!(zeros.warnings()[0].to_string(), "arm.urdf:23: the zero bytes behind </robot> are ignored");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("arm.urdf");
    let latin1 = [b"<!-- turns by 90\xb0 -->\n".as_slice(), ARM.as_bytes()].concat();
    std::fs::write(&path, latin1).unwrap();
    let robot = Robot::read(&path).unwrap();
    assert!(
        robot.warnings()[0]
            .to_string()
            .ends_with("arm.urdf:1: the file is not UTF-8: its other characters are replaced")
    );
}

#[test]
fn floating_and_planar_joints_have_no_position() {
    for (kind, name) in [("floating", JointKind::Floating), ("planar", JointKind::Planar)] {
        let text = ARM.replacen("type=\"revolute\"", &format!("type=\"{kind}\""), 1);
        let text = text.replacen("<mimic joint=\"turn\" multiplier=\"0.5\" offset=\"0.25\"/>", "", 1);
        let robot = Robot::from_urdf(&text, "arm.urdf").unwrap();
        assert_eq!(robot.warnings(), []);
        let turn = &robot.joints()[0];
        assert_eq!((turn.kind, turn.drive, turn.limits, turn.range()), (name, None, None, 0.0..=0.0));
        assert_eq!(robot.coordinates().len(), 1);
        assert_eq!(turn.parent_from_child(&[0.0]), turn.parent_from_joint);
        assert_eq!(robot.bodies().unwrap().len(), 3, "what moves is a body of its own");
        let error =
            downbeat_kinematics::to_mjcf(&robot, downbeat_kinematics::Root::Free).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("arm.urdf:4: joint \"turn\" is {kind}, which MJCF has")),
            "{error}"
        );
    }
}

#[test]
fn what_is_no_urdf_is_refused() {
    let error = |text: &str| Robot::from_urdf(text, "x.urdf").unwrap_err().to_string();
    assert!(error("<robot").starts_with("x.urdf:1: the robot description is not valid XML"));
    assert_eq!(error("<sdf/>"), "x.urdf:1: the root is <sdf>, that of a URDF is <robot>");
    let xacro = "<robot name=\"x\" xmlns:xacro=\"http://ros.org/wiki/xacro\">\n<xacro:include filename=\"y\"/></robot>";
    assert_eq!(
        error(xacro),
        "x.urdf:2: <xacro:include> is a macro of xacro: expand the file with `xacro FILE > robot.urdf`"
    );
    let missing = Robot::read("no/such.urdf").unwrap_err().to_string();
    assert!(missing.starts_with("no/such.urdf: the robot description cannot be read: "), "{missing}");
}

#[test]
fn masses_are_checked_where_they_are_needed() {
    let bodies = |from: &str, to: &str| {
        let arm = Robot::from_urdf(&ARM.replacen(from, to, 1), "arm.urdf").unwrap();
        arm.bodies().unwrap_err().to_string()
    };
    let tip = "<inertial><mass value=\"1\"/><inertia ixx=\"1\" iyy=\"1\" izz=\"1\"/></inertial>";
    assert_eq!(
        bodies(tip, ""),
        "arm.urdf:22: link \"tip\" has no <inertial>, nor has any link fixed to it, but its mass is needed: add one with mass \
         in kg and inertia in kg m²"
    );
    let impossible = bodies("ixx=\"1\" iyy=\"1\"", "ixx=\"1\" iyy=\"3\"");
    assert!(
        impossible.starts_with("arm.urdf:22: the inertia of link \"tip\" is not that of a rigid body"),
        "{impossible}"
    );
    assert!(
        bodies("ixx=\"1\" iyy=\"1\"", "ixy=\"2\" ixx=\"1\" iyy=\"1\"")
            .contains("-1.000e0, 1.000e0, 3.000e0 kg m²")
    );
}

#[test]
fn a_missing_mesh_is_reported_with_the_files_looked_for() {
    let arm = Robot::from_urdf(&ARM.replace("upper.stl", "package://arm/upper.stl"), "a/arm.urdf").unwrap();
    let shape = &arm.links()[1].visuals[0];
    let Geometry::Mesh(mesh) = &shape.geometry else { panic!("a mesh") };
    let error = arm.mesh_file(shape, mesh, &[PathBuf::from("/opt/ros/jazzy")]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "a/arm.urdf:12: there is no mesh \"package://arm/upper.stl\" (looked for /opt/ros/jazzy/share/arm/upper.stl): install \
         its package and set AMENT_PREFIX_PATH, or correct the name"
    );
}
