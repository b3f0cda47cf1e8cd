//! Writes a description as MJCF, for MuJoCo.
//!
//! # References
//! <https://mujoco.readthedocs.io/en/3.3.7/XMLreference.html>

use crate::description::{DescriptionError, Geometry, Joint, JointKind, Link, LinkId, Problem, Robot, Shape};
use downbeat_transforms::Isometry;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Whether the root of a robot can move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Root {
    /// It moves freely, as that of a walking robot.
    Free,
    /// It is fixed to the world, as that of an arm on a table.
    Fixed,
}

/// The description as MJCF: each link is a body of its name, each joint has a motor of its name.
///
/// Visual shapes are in group 2 and collide with nothing, those for collisions in group 3. Names of mesh
/// files lose their `package://`: add `<compiler meshdir="..."/>` with the folder of the packages.
///
/// # Errors
/// As [`Robot::bodies`]: MuJoCo needs masses. [`Problem::NotInMjcf`] for floating and planar joints.
pub fn to_mjcf(robot: &Robot, root: Root) -> Result<String, DescriptionError> {
    robot.bodies()?;
    let mut writer = Writer { robot, text: String::new(), children: vec![Vec::new(); robot.links().len()] };
    for joint in robot.joints() {
        let kind = match joint.kind {
            JointKind::Floating => Some("floating"),
            JointKind::Planar => Some("planar"),
            _ => None,
        };
        if let Some(kind) = kind {
            let problem = Problem::NotInMjcf { joint: joint.name.clone(), kind };
            return Err(robot.error(Some(joint.line), problem));
        }
        writer.children[joint.parent.index()].push(joint.child);
    }
    writer.line(0, &format!("<mujoco model=\"{}\">", escaped(robot.name())));
    writer.line(1, "<compiler angle=\"radian\" inertiafromgeom=\"false\"/>");
    writer.assets();
    writer.line(1, "<worldbody>");
    writer.body(LinkId(0), root, 2);
    writer.line(1, "</worldbody>");
    writer.followers();
    writer.motors();
    writer.line(0, "</mujoco>");
    Ok(writer.text)
}

struct Writer<'r> {
    robot: &'r Robot,
    text: String,
    /// Of each link.
    children: Vec<Vec<LinkId>>,
}

impl Writer<'_> {
    fn line(&mut self, depth: usize, line: &str) {
        self.text.extend(std::iter::repeat_n("  ", depth));
        self.text.push_str(line);
        self.text.push('\n');
    }

    fn assets(&mut self) {
        let meshes = self.robot.links().iter().flat_map(|link| link.visuals.iter().chain(&link.collisions));
        let mut assets = BTreeMap::new();
        for shape in meshes {
            if let Geometry::Mesh(mesh) = &shape.geometry {
                let file = mesh.file_name.trim_start_matches("package://").trim_start_matches("file://");
                let [name, file] = [&mesh.file_name, file].map(escaped);
                assets.insert(
                    name.clone(),
                    format!("<mesh name=\"{name}\" file=\"{file}\"{}/>", scale(mesh.scale)),
                );
            }
        }
        if assets.is_empty() {
            return;
        }
        self.line(1, "<asset>");
        assets.values().for_each(|asset| self.line(2, asset));
        self.line(1, "</asset>");
    }

    fn body(&mut self, id: LinkId, root: Root, depth: usize) {
        // Recursion would end the process on a chain of a hundred thousand links.
        enum Next {
            Open(LinkId),
            Close,
        }
        let mut open = vec![Next::Open(id)];
        let mut depth = depth;
        while let Some(next) = open.pop() {
            let Next::Open(id) = next else {
                depth -= 1;
                self.line(depth, "</body>");
                continue;
            };
            let link = self.robot.link(id);
            let joint = link.parent.map(|joint| self.robot.joint(joint));
            let pose = joint.map_or_else(String::new, |joint| pose(&joint.parent_from_joint));
            self.line(depth, &format!("<body name=\"{}\"{pose}>", escaped(&link.name)));
            depth += 1;
            match joint {
                None if root == Root::Free => self.line(depth, "<freejoint/>"),
                Some(joint) if joint.kind != JointKind::Fixed => self.line(depth, &joint_element(joint)),
                _ => {}
            }
            self.contents(link, depth);
            open.push(Next::Close);
            open.extend(self.children[id.index()].iter().rev().map(|&child| Next::Open(child)));
        }
    }

    fn contents(&mut self, link: &Link, depth: usize) {
        if let Some(inertial) = link.inertial.filter(|inertial| inertial.mass > 0.0) {
            let rotation = DMat3::from_quat(inertial.link_from_inertial.rotation);
            let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] =
                (rotation * inertial.inertia * rotation.transpose()).to_cols_array_2d();
            let inertia = [xx, yy, zz, xy, xz, yz].map(number).join(" ");
            let (position, mass) = (vector(inertial.link_from_inertial.translation), number(inertial.mass));
            let element = format!("<inertial pos=\"{position}\" mass=\"{mass}\" fullinertia=\"{inertia}\"/>");
            self.line(depth, &element);
        }
        // MuJoCo refuses sizes of 0.
        let has_volume = |shape: &&Shape| shape.geometry.has_volume();
        for shape in link.visuals.iter().filter(has_volume) {
            self.line(depth, &geom(shape, " group=\"2\" contype=\"0\" conaffinity=\"0\""));
        }
        for shape in link.collisions.iter().filter(has_volume) {
            self.line(depth, &geom(shape, " group=\"3\""));
        }
    }

    /// Joints that follow others.
    fn followers(&mut self) {
        let followers = self.robot.joints().iter().filter_map(|joint| {
            let (mimic, follower) = (joint.mimic?, escaped(&joint.name));
            let leader = escaped(&self.robot.joint(mimic.joint).name);
            let (offset, multiplier) = (number(mimic.offset), number(mimic.multiplier));
            let polynomial = format!("polycoef=\"{offset} {multiplier} 0 0 0\"");
            Some(format!("<joint joint1=\"{follower}\" joint2=\"{leader}\" {polynomial}/>"))
        });
        self.list("equality", followers.collect());
    }

    fn motors(&mut self) {
        let motors = self.robot.coordinates().iter().filter_map(|&id| {
            let joint = self.robot.joint(id);
            let effort = joint.limits.map(|limits| limits.effort).filter(|effort| *effort > 0.0)?;
            let (name, effort) = (escaped(&joint.name), number(effort));
            let range = format!("ctrllimited=\"true\" ctrlrange=\"-{effort} {effort}\"");
            Some(format!("<motor name=\"{name}\" joint=\"{name}\" {range}/>"))
        });
        self.list("actuator", motors.collect());
    }

    fn list(&mut self, element: &str, lines: Vec<String>) {
        if !lines.is_empty() {
            self.line(1, &format!("<{element}>"));
            lines.iter().for_each(|line| self.line(2, line));
            self.line(1, &format!("</{element}>"));
        }
    }
}

fn joint_element(joint: &Joint) -> String {
    let kind = if joint.kind == JointKind::Prismatic { "slide" } else { "hinge" };
    let mut element =
        format!("<joint name=\"{}\" type=\"{kind}\" axis=\"{}\"", escaped(&joint.name), vector(joint.axis));
    if let (JointKind::Revolute | JointKind::Prismatic, Some(limits)) = (joint.kind, joint.limits) {
        let range = format!(" limited=\"true\" range=\"{} {}\"", number(limits.lower), number(limits.upper));
        element.push_str(&range);
    }
    for (name, value) in [("damping", joint.dynamics.damping), ("frictionloss", joint.dynamics.friction)] {
        if value > 0.0 {
            let _ = write!(element, " {name}=\"{}\"", number(value));
        }
    }
    element + "/>"
}

fn geom(shape: &Shape, attributes: &str) -> String {
    let geometry = match &shape.geometry {
        Geometry::Box { size } => format!("type=\"box\" size=\"{}\"", vector(*size / 2.0)),
        Geometry::Cylinder { radius, length } => {
            format!("type=\"cylinder\" size=\"{} {}\"", number(*radius), number(length / 2.0))
        }
        Geometry::Sphere { radius } => format!("type=\"sphere\" size=\"{}\"", number(*radius)),
        Geometry::Mesh(mesh) => format!("type=\"mesh\" mesh=\"{}\"", escaped(&mesh.file_name)),
    };
    let color = shape.material.as_ref().and_then(|material| material.rgba);
    let color = color.map_or_else(String::new, |rgba| {
        format!(" rgba=\"{}\"", rgba.map(|part| part.to_string()).join(" "))
    });
    format!("<geom {geometry}{}{attributes}{color}/>", pose(&shape.link_from_shape))
}

/// The attributes of a pose that is not the identity.
fn pose(isometry: &Isometry) -> String {
    let mut text = String::new();
    if isometry.translation != DVec3::ZERO {
        let _ = write!(text, " pos=\"{}\"", vector(isometry.translation));
    }
    let [x, y, z, w] = isometry.rotation.to_array();
    if [x, y, z] != [0.0; 3] {
        let _ = write!(text, " quat=\"{}\"", [w, x, y, z].map(number).join(" "));
    }
    text
}

fn scale(scale: DVec3) -> String {
    if scale == DVec3::ONE { String::new() } else { format!(" scale=\"{}\"", vector(scale)) }
}

fn vector(vector: DVec3) -> String {
    vector.to_array().map(number).join(" ")
}

/// The shortest digits that are read as the same number; not -0, which differs between platforms' rotations.
fn number(number: f64) -> String {
    (number + 0.0).to_string()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
