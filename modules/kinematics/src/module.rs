//! Answers where the links and the centre of mass of a robot are, and how its joints bring them elsewhere.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `joint_states` (in) | sensor_msgs/JointState | positions by name; unknown names, NaN and missing positions are ignored |
//! | `centre_of_mass` | geometry_msgs/PointStamped | in the root of the robot, for each `joint_states`, once all joints are known |
//! | `forward_kinematics` | service downbeat_interfaces/ForwardKinematics | poses of links |
//! | `inverse_kinematics` | service downbeat_interfaces/InverseKinematics | joints for the pose of a link in another one |
//! | `get_centre_of_mass` | service downbeat_interfaces/GetCentreOfMass | the centre of mass |
//! | `look_at` | service downbeat_interfaces/LookAt | joints that turn a camera to a point |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `robot_description` | required | the URDF file, or its text |
//! | `camera_link` | `camera_link` | the link whose x axis `look_at` turns |
//! | `starts` | 20 | how often the search for a pose starts again before the nearest is returned |
//!
//! Requests may give positions of joints; the others are as in the last `joint_states`. A search that reaches
//! its pose takes microseconds; one for a pose out of reach takes `starts` times as long, some milliseconds.
//! Where that is too long for a cycle, run the module detached.

use crate::description::{LinkId, Robot};
use crate::inverse::{InverseKinematics, Search};
use crate::look_at::LookAt;
use crate::pose::{Masses, Pose};
use crate::robot_description::{self, NoDescription};
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, TransitionError,
};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::srv::{
    ForwardKinematicsRequest, ForwardKinematicsResponse, GetCentreOfMassRequest, GetCentreOfMassResponse,
    InverseKinematicsRequest, InverseKinematicsResponse, LookAtRequest, LookAtResponse,
};
use downbeat_msgs::geometry_msgs::msg::{Point, PointStamped, Pose as PoseMessage, PoseStamped, Quaternion};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;

/// Serves kinematics of a robot; see the [module page](self).
#[derive(Default)]
pub struct Kinematics {
    known: Option<Known>,
}

/// The keys of [`Kinematics`].
pub struct Ports {
    centre_of_mass: Publication<PointStamped>,
    camera_link: Setting<String>,
    starts: Setting<i64>,
}

/// A robot and the last positions of its joints.
struct Known {
    robot: Robot,
    /// `Err` with the reason if the description lacks masses.
    masses: Result<Masses, String>,
    coordinates: BTreeMap<String, usize>,
    /// NaN where unknown.
    positions: Vec<f64>,
    stamp: Stamp,
    pose: Pose,
    /// Those that were asked for, by base and tip.
    chains: BTreeMap<(LinkId, LinkId), InverseKinematics>,
}

impl Kinematics {
    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let Some(known) = &mut self.known else { return };
        known.set(&state);
        known.stamp = state.header.stamp;
        let (Ok(masses), true) = (&known.masses, known.positions.iter().all(|position| position.is_finite()))
        else {
            return;
        };
        known.pose.update(&known.robot, &known.positions);
        let centre_of_mass = masses.center_of_mass(&known.pose);
        ctx.publish(ctx.ports.centre_of_mass, known.point(centre_of_mass));
    }

    fn known(&mut self) -> Result<&mut Known, String> {
        self.known.as_mut().ok_or_else(|| NoDescription.to_string())
    }

    fn forward(&mut self, request: &ForwardKinematicsRequest) -> Result<ForwardKinematicsResponse, String> {
        let known = self.known()?;
        known.pose_with(&request.joint_state)?;
        let frame = known.link_or_root(&request.frame_id)?;
        let links: Vec<String> = match request.links.is_empty() {
            true => known.robot.links().iter().map(|link| link.name.clone()).collect(),
            false => request.links.clone(),
        };
        let pose = |link: &String| {
            let frame_from_link = known.pose.target_from_source(frame, known.link(link)?);
            Ok(PoseStamped { header: known.header(frame), pose: pose_message(&frame_from_link) })
        };
        let poses = links.iter().map(pose).collect::<Result<_, String>>()?;
        Ok(ForwardKinematicsResponse { success: true, links, poses, ..ForwardKinematicsResponse::default() })
    }

    fn inverse(
        &mut self,
        request: &InverseKinematicsRequest,
        search: Search,
    ) -> Result<InverseKinematicsResponse, String> {
        let known = self.known()?;
        let mut positions = known.pose_with(&request.seed)?;
        let (base, tip) = (known.link_or_root(&request.pose.header.frame_id)?, known.link(&request.link)?);
        let base_from_tip = isometry(&request.pose.pose, request.position_only)?;
        let angle_weight = if request.position_only { 0.0 } else { search.angle_weight };
        // Failing to create a chain leaves none behind.
        let created = match known.chains.contains_key(&(base, tip)) {
            true => None,
            false => {
                Some(InverseKinematics::new(&known.robot, base, tip).map_err(|error| error.to_string())?)
            }
        };
        if known.chains.len() >= MOST_CHAINS && created.is_some() {
            known.chains.clear();
        }
        known.chains.extend(created.map(|chain| ((base, tip), chain)));
        let Some(chain) = known.chains.get_mut(&(base, tip)) else {
            return Err("the chain is unknown".into());
        };
        let found = chain.solve(&base_from_tip, &mut positions, &Search { angle_weight, ..search });
        let coordinates: Vec<usize> = chain.coordinates().collect();
        let message = match found.is_reached {
            true => String::new(),
            false => format!(
                "\"{}\" does not reach the pose: it comes as near as {:.4} m and {:.4} rad",
                request.link, found.distance, found.angle
            ),
        };
        Ok(InverseKinematicsResponse {
            success: found.is_reached,
            message,
            joint_state: known.joint_state(&coordinates, &positions),
            distance: found.distance,
            angle: found.angle,
        })
    }

    fn centre_of_mass(
        &mut self,
        request: &GetCentreOfMassRequest,
    ) -> Result<GetCentreOfMassResponse, String> {
        let known = self.known()?;
        known.pose_with(&request.joint_state)?;
        let masses = known.masses.as_ref().map_err(Clone::clone)?;
        Ok(GetCentreOfMassResponse {
            success: true,
            message: String::new(),
            centre_of_mass: known.point(masses.center_of_mass(&known.pose)),
            mass: masses.total(),
        })
    }

    fn look_at(
        &mut self,
        request: &LookAtRequest,
        camera: &str,
        search: &Search,
    ) -> Result<LookAtResponse, String> {
        let known = self.known()?;
        let mut positions = known.pose_with(&JointState::default())?;
        let frame = known.link_or_root(&request.point.header.frame_id)?;
        let Point { x, y, z } = request.point.point;
        let point = DVec3::new(x, y, z);
        if !point.is_finite() {
            return Err("the point has a coordinate that is not finite".to_owned());
        }
        let base = LinkId::ROOT;
        let in_base = known.pose.base_from_link(frame).transform_point(point);
        let mut look_at =
            LookAt::new(&known.robot, base, known.link(camera)?).map_err(|error| error.to_string())?;
        let look = look_at.solve(in_base, &mut positions, search);
        let coordinates: Vec<usize> = look_at.coordinates().collect();
        let message = match look.is_reached {
            true => String::new(),
            false => {
                format!("\"{camera}\" cannot look at the point: its axis misses it by {:.4} rad", look.angle)
            }
        };
        Ok(LookAtResponse {
            success: look.is_reached,
            message,
            joint_state: known.joint_state(&coordinates, &positions),
            angle: look.angle,
        })
    }
}

impl Module for Kinematics {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        self.known = robot_description::declare(setup)?.map(|description| Known::new(description.robot));
        setup.subscribe("joint_states", Self::on_joint_states)?;
        setup.serve("forward_kinematics", |module: &mut Self, request, _| {
            let failed =
                |message| ForwardKinematicsResponse { message, ..ForwardKinematicsResponse::default() };
            Ok(module.forward(request).unwrap_or_else(failed))
        })?;
        setup.serve("inverse_kinematics", |module: &mut Self, request, ctx| {
            let failed =
                |message| InverseKinematicsResponse { message, ..InverseKinematicsResponse::default() };
            Ok(module.inverse(request, search(ctx)).unwrap_or_else(failed))
        })?;
        setup.serve("get_centre_of_mass", |module: &mut Self, request, _| {
            let failed = |message| GetCentreOfMassResponse { message, ..GetCentreOfMassResponse::default() };
            Ok(module.centre_of_mass(request).unwrap_or_else(failed))
        })?;
        setup.serve("look_at", |module: &mut Self, request, ctx| {
            let failed = |message| LookAtResponse { message, ..LookAtResponse::default() };
            let camera = ctx.get(ctx.ports.camera_link).clone();
            Ok(module.look_at(request, &camera, &search(ctx)).unwrap_or_else(failed))
        })?;
        let what = "the link whose x axis look_at turns";
        let how_often = "how often a search starts again";
        Ok(Ports {
            centre_of_mass: setup.publish("centre_of_mass")?,
            camera_link: setup.setting("camera_link", "camera_link".to_owned(), what)?,
            starts: setup.setting_in("starts", 20, 1.0..=1000.0, how_often)?,
        })
    }

    fn activate(&mut self, _: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        if self.known.is_some() { Ok(()) } else { Err(NoDescription.into()) }
    }
}

/// The maximum number of chains that are kept.
const MOST_CHAINS: usize = 64;

fn search(ctx: &Context<'_, Ports>) -> Search {
    Search { starts: u32::try_from(*ctx.get(ctx.ports.starts)).unwrap_or(1), ..Search::default() }
}

impl Known {
    fn new(robot: Robot) -> Self {
        let names = robot.coordinates().iter().map(|&id| robot.joint(id).name.clone());
        Self {
            masses: Masses::new(&robot).map_err(|error| error.to_string()),
            coordinates: names.zip(0..).collect(),
            positions: vec![f64::NAN; robot.coordinates().len()],
            stamp: Stamp::default(),
            pose: Pose::new(&robot),
            chains: BTreeMap::new(),
            robot,
        }
    }

    fn set(&mut self, state: &JointState) {
        set(&mut self.positions, &self.coordinates, state);
    }

    /// Computes the pose at the last positions with those of a request, which it returns.
    fn pose_with(&mut self, state: &JointState) -> Result<Vec<f64>, String> {
        if let Some(name) = state.name.iter().find(|name| !self.coordinates.contains_key(*name)) {
            // With a suggestion; the joints that follow others cannot be chosen.
            self.robot.joint_id(name).map_err(|error| error.to_string())?;
            return Err(format!(
                "the position of joint \"{name}\" cannot be chosen: it is fixed or follows another one"
            ));
        }
        let mut positions = self.positions.clone();
        set(&mut positions, &self.coordinates, state);
        if let Some(index) = positions.iter().position(|position| position.is_nan()) {
            let name = &self.robot.joint(self.robot.coordinates()[index]).name;
            return Err(format!(
                "the position of joint \"{name}\" is unknown: joint_states have not had it yet, and the request does not give it"
            ));
        }
        self.pose.update(&self.robot, &positions);
        Ok(positions)
    }

    fn link(&self, name: &str) -> Result<LinkId, String> {
        self.robot.link_id(name).map_err(|error| error.to_string())
    }

    fn link_or_root(&self, name: &str) -> Result<LinkId, String> {
        if name.is_empty() { Ok(LinkId::ROOT) } else { self.link(name) }
    }

    fn header(&self, link: LinkId) -> Header {
        Header { stamp: self.stamp, frame_id: self.robot.link(link).name.clone() }
    }

    /// A point in the root.
    fn point(&self, point: DVec3) -> PointStamped {
        let DVec3 { x, y, z } = point;
        PointStamped { header: self.header(LinkId::ROOT), point: Point { x, y, z } }
    }

    fn joint_state(&self, coordinates: &[usize], positions: &[f64]) -> JointState {
        let name = |&index: &usize| self.robot.joint(self.robot.coordinates()[index]).name.clone();
        JointState {
            header: Header { stamp: self.stamp, ..Header::default() },
            name: coordinates.iter().map(name).collect(),
            position: coordinates.iter().map(|&index| positions[index]).collect(),
            ..JointState::default()
        }
    }
}

fn set(positions: &mut [f64], coordinates: &BTreeMap<String, usize>, state: &JointState) {
    for (name, position) in state.name.iter().zip(&state.position) {
        if let Some(&index) = coordinates.get(name).filter(|_| position.is_finite()) {
            positions[index] = *position;
        }
    }
}

/// The pose of a message, its orientation normalised; the identity where it does not matter.
fn isometry(pose: &PoseMessage, position_only: bool) -> Result<Isometry, String> {
    let (Point { x, y, z }, orientation) = (&pose.position, &pose.orientation);
    let translation = DVec3::new(*x, *y, *z);
    let Quaternion { x, y, z, w } = orientation;
    let rotation = if position_only { DQuat::IDENTITY } else { DQuat::from_xyzw(*x, *y, *z, *w) };
    if !translation.is_finite() || !rotation.is_finite() {
        return Err("the pose has a number that is not finite".to_owned());
    }
    if (rotation.length() - 1.0).abs() > 0.01 {
        let norm = rotation.length();
        return Err(format!("the orientation of the pose is not a unit quaternion: its norm is {norm}"));
    }
    Ok(Isometry { translation, rotation: rotation.normalize() })
}

fn pose_message(isometry: &Isometry) -> PoseMessage {
    let (DVec3 { x, y, z }, rotation) = (isometry.translation, isometry.rotation);
    let orientation = Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w };
    PoseMessage { position: Point { x, y, z }, orientation }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Core, ModuleOptions};
    use std::sync::mpsc::channel;
    use std::time::Duration;

    const DARWIN_OP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/darwin_op.urdf");

    fn core() -> Core {
        let settings = [("robot_description".to_owned(), DARWIN_OP.to_owned().into())];
        let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
        let (mut core, _) = core_at_zero();
        core.add_with("kinematics", Kinematics::default(), options).unwrap();
        core
    }

    fn standing() -> JointState {
        let robot = Robot::read(DARWIN_OP).unwrap();
        let name: Vec<_> = robot.coordinates().iter().map(|&joint| robot.joint(joint).name.clone()).collect();
        JointState { position: vec![0.0; name.len()], name, ..JointState::default() }
    }

    fn publish(core: &mut Core, state: JointState) {
        core.inlet("joint_states").unwrap().publish(state).unwrap();
        (0..3).try_for_each(|_| core.cycle()).unwrap();
    }

    fn call<Q: Send + 'static, R: Send + 'static>(core: &mut Core, service: &str, request: Q) -> R {
        let caller = core.caller::<Q, R>(service).unwrap();
        let (sender, answer) = channel();
        caller.call(request, Duration::MAX, move |result| drop(sender.send(result.unwrap()))).unwrap();
        (0..4).try_for_each(|_| core.cycle()).unwrap();
        answer.try_recv().unwrap()
    }

    #[test]
    fn the_centre_of_mass_is_published_once_all_joints_are_known() {
        let mut core = core();
        let points = Collector::<PointStamped>::add(&mut core, "centre_of_mass");
        let mut incomplete = standing();
        let elbow = incomplete.name.iter().position(|name| name == "l_el").unwrap();
        incomplete.position[elbow] = f64::NAN;
        publish(&mut core, incomplete);
        assert!(points.take().is_empty());
        let request = ForwardKinematicsRequest::default();
        let response: ForwardKinematicsResponse = call(&mut core, "forward_kinematics", request);
        assert!(
            response.message.contains("the position of joint \"l_el\" is unknown"),
            "{}",
            response.message
        );
        publish(&mut core, standing());
        let points = points.take();
        assert_eq!((points.len(), &*points[0].header.frame_id), (1, "base_link"));
        let response: GetCentreOfMassResponse =
            call(&mut core, "get_centre_of_mass", GetCentreOfMassRequest::default());
        assert_eq!(response.centre_of_mass, points[0]);
        assert!((response.mass - 2.925).abs() < 1e-3);
    }

    #[test]
    fn forward_and_inverse_kinematics_agree() {
        let mut core = core();
        publish(&mut core, standing());
        let joint_state = JointState {
            name: vec!["r_knee".into(), "r_hip_pitch".into()],
            position: vec![0.8, -0.4],
            ..JointState::default()
        };
        let request =
            ForwardKinematicsRequest { joint_state, frame_id: "torso".into(), links: vec!["r_sole".into()] };
        let forward: ForwardKinematicsResponse = call(&mut core, "forward_kinematics", request);
        assert!(forward.success, "{}", forward.message);
        let pose = forward.poses[0].clone();
        assert_eq!(pose.header.frame_id, "torso");
        let request =
            InverseKinematicsRequest { pose, link: "r_sole".into(), ..InverseKinematicsRequest::default() };
        let inverse: InverseKinematicsResponse = call(&mut core, "inverse_kinematics", request.clone());
        assert!(inverse.success, "{}", inverse.message);
        let knee = inverse.joint_state.name.iter().position(|name| name == "r_knee").unwrap();
        assert!((inverse.joint_state.position[knee] - 0.8).abs() < 1e-5, "{:?}", inverse.joint_state);

        let mut too_far = request.clone();
        too_far.pose.pose.position.z = -1.0;
        let inverse: InverseKinematicsResponse = call(&mut core, "inverse_kinematics", too_far);
        assert!(!inverse.success && inverse.joint_state.name.len() == 6);
        assert!(inverse.message.contains("does not reach the pose"), "{}", inverse.message);

        let mut unknown = request.clone();
        unknown.link = "r_sol".into();
        let inverse: InverseKinematicsResponse = call(&mut core, "inverse_kinematics", unknown);
        assert!(inverse.message.ends_with("there is no link \"r_sol\", did you mean \"r_sole\"?"));
        let mut not_finite = request;
        not_finite.pose.pose.position.x = f64::NAN;
        let inverse: InverseKinematicsResponse = call(&mut core, "inverse_kinematics", not_finite);
        assert_eq!(inverse.message, "the pose has a number that is not finite");
    }

    #[test]
    fn the_head_turns_to_a_point() {
        let mut core = core();
        publish(&mut core, standing());
        let mut request = LookAtRequest::default();
        request.point.point = Point { x: 0.5, y: 0.2, z: -0.2 };
        let response: LookAtResponse = call(&mut core, "look_at", request);
        assert!(response.success && response.angle < 1e-6, "{}", response.message);
        assert_eq!(response.joint_state.name, ["head_pan", "head_tilt"]);
        assert!(response.joint_state.position[0] > 0.3);
    }

    #[test]
    fn a_module_without_a_description_does_not_start() {
        let (mut core, _) = core_at_zero();
        core.add("kinematics", Kinematics::default()).unwrap();
        core.cycle().unwrap();
        let settings = [("robot_description".to_owned(), "no.urdf".to_owned().into())];
        let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
        let error = core.add_with("other", Kinematics::default(), options).unwrap_err().to_string();
        assert!(error.contains("no.urdf: the robot description cannot be read"), "{error}");
    }
}
