//! The engine rapier.
//!
//! rapier works in single precision. With its feature `enhanced-determinism`, the same world and the same
//! steps give the same bits, in every process, and for worlds with one robot on x86-64 and aarch64; another
//! version, step or seed gives another path.
//!
//! # References
//! rapier3d 0.36.1: `Multibody` (reduced coordinates, armature and dry friction per degree of freedom).

use super::{
    ARMATURE, JointDrive, Motion, Plan, Posture, RobotBodies, START_HEIGHT, Start, Variation, World,
};
use crate::model::{Model, Shape};
use crate::scenery::WorldFile;
use crate::spawned::{Spawned, SpawnedShape};
use downbeat_darwin_op::emulator::FootForces;
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use downbeat_transforms::Isometry;
use glam::{DMat3, DQuat, DVec3};
use rapier3d::parry::query;
use rapier3d::prelude::*;
use std::time::Duration;

/// A world with robots. As a [`World`], it has one.
pub(crate) struct RapierWorld {
    physics: PhysicsWorld,
    steps: u64,
    robots: Vec<Robot>,
    things: Vec<Thing>,
    /// Of everything beside the robot.
    friction: f32,
    /// Of pushes in this step.
    pushed: Vec<RigidBodyHandle>,
}

struct Robot {
    links: Vec<Link>,
    feet: [Option<Foot>; 2],
}

/// A robot of a world, to be measured.
pub(crate) struct RapierRobot<'a> {
    world: &'a RapierWorld,
    robot: usize,
}

/// A body of a robot.
struct Link {
    handle: RigidBodyHandle,
    /// In the multibody; 0 for the first body.
    index: usize,
}

struct Foot {
    collider: ColliderHandle,
    /// Where the sole is in the collider.
    collider_from_sole: Isometry,
}

/// Something beside the robot.
struct Thing {
    name: String,
    handle: RigidBodyHandle,
    /// The radius and the coefficient of rolling friction of a ball.
    rolls: Option<(f32, f32)>,
}

/// The distance from the floor up to which the ball rolls, in m.
const ROLLING_GAP: f32 = 0.002;

impl RapierWorld {
    pub(super) fn new(plan: Plan<'_>) -> Self {
        let Plan { file, model, start, step, variation } = plan;
        Self::with_robots(file, model, step, &[(start, variation)])
    }

    /// A world with robots of one model. The friction of the things beside them is that of the first robot.
    pub(crate) fn with_robots(
        file: &WorldFile,
        model: &Model,
        step: Duration,
        robots: &[(&Start, &Variation)],
    ) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0, -STANDARD_GRAVITY as f32);
        physics.integration_parameters.dt = step.as_secs_f32();
        physics.integration_parameters.num_solver_iterations = 1;
        // With one, a robot that stands creeps: it turns by 0.05 rad in 10 s. More cost next to nothing.
        physics.integration_parameters.num_internal_pgs_iterations = 4;
        let friction_of = |variation: &Variation| (file.floor.friction * variation.friction) as f32;
        let friction = robots.first().map_or(file.floor.friction as f32, |(_, first)| friction_of(first));
        let things = surroundings(file).into_iter().map(|thing| thing.insert(&mut physics, friction));
        let things = things.collect();
        let mut world = Self { physics, steps: 0, robots: Vec::new(), things, friction, pushed: Vec::new() };
        for (index, (start, variation)) in robots.iter().enumerate() {
            let robot = insert_robot(&mut world.physics, model, variation, friction_of(variation));
            world.robots.push(robot);
            world.place(index, model, start);
        }
        world
    }

    /// A robot, to be measured.
    pub(crate) fn robot(&self, robot: usize) -> RapierRobot<'_> {
        RapierRobot { world: self, robot }
    }

    fn links(&self, robot: usize) -> &[Link] {
        self.robots.get(robot).map_or(&[], |robot| &robot.links)
    }

    /// Puts a robot where it starts, at rest.
    pub(crate) fn place(&mut self, robot: usize, model: &Model, start: &Start) {
        let angle = |joint: &str| {
            start.angles.iter().find(|(name, _)| name == joint).map_or(0.0, |(_, angle)| *angle)
        };
        let angles: Vec<f64> = model
            .bodies
            .iter()
            .map(|body| body.joint.as_ref().map_or(0.0, |joint| angle(&joint.name)))
            .collect();
        let poses = model.poses(&angles);
        let sole = |name: &String| {
            model.frames.get(name).map(|&(body, body_from_sole)| poses[body] * body_from_sole)
        };
        let [right, left] = &model.marks.soles;
        let upright = match (start.posture, sole(left), sole(right)) {
            (Posture::Standing, Some(left), Some(right)) => {
                // Level soles, below the midpoint of which is the origin.
                let rotation = left.rotation.conjugate();
                let middle = rotation * ((left.translation + right.translation) / 2.0);
                Isometry { rotation, translation: DVec3::new(-middle.x, -middle.y, 0.0) }
            }
            (Posture::Standing, ..) => Isometry::IDENTITY,
            (Posture::Prone, ..) => turned_about_y(std::f64::consts::FRAC_PI_2),
            (Posture::Supine, ..) => turned_about_y(-std::f64::consts::FRAC_PI_2),
        };
        let heading = Isometry {
            translation: DVec3::new(start.position[0], start.position[1], 0.0),
            rotation: DQuat::from_rotation_z(start.yaw),
        };
        self.set_coordinates(robot, heading * upright, &angles);
        let lowest = self.lowest_point(robot);
        let lifted = Isometry::from_translation(0.0, 0.0, START_HEIGHT - lowest);
        self.set_coordinates(robot, lifted * heading * upright, &angles);
    }

    /// Sets the pose of the first body and the angle of each body's joint, at rest.
    fn set_coordinates(&mut self, robot: usize, world_from_root: Isometry, angles: &[f64]) {
        let Some(links) = self.robots.get(robot).map(|robot| &robot.links) else { return };
        let Some(root) = links.first().map(|link| link.handle) else { return };
        if let Some(body) = self.physics.bodies.get_mut(root) {
            body.set_position(pose(&world_from_root), true);
        }
        let Some(link) = self.physics.multibody_joints.rigid_body_link(root).copied() else { return };
        let Some(multibody) = self.physics.multibody_joints.get_multibody_mut(link.multibody) else { return };
        let mut displacements = vec![0.0; multibody.ndofs()];
        for (link, angle) in links.iter().zip(angles).skip(1) {
            if let Some(joint) = multibody.link(link.index) {
                displacements[joint.assembly_id()] = *angle as f32 - joint.joint().coords()[3];
            }
        }
        multibody.apply_displacements(&displacements);
        multibody.generalized_velocity_mut().fill(0.0);
        multibody.forward_kinematics(&self.physics.bodies, true);
        multibody.update_rigid_bodies(&mut self.physics.bodies, true);
    }

    /// Of a robot, in m above the floor.
    fn lowest_point(&self, robot: usize) -> f64 {
        let mut lowest = f32::INFINITY;
        for link in self.links(robot) {
            let Some(body) = self.physics.bodies.get(link.handle) else { continue };
            for collider in body.colliders() {
                let Some(collider) = self.physics.colliders.get(*collider) else { continue };
                let Some(local) = collider.position_wrt_parent() else { continue };
                lowest = lowest.min(collider.shape().compute_aabb(&(*body.position() * *local)).mins.z);
            }
        }
        if lowest.is_finite() { f64::from(lowest) } else { 0.0 }
    }

    /// Slows balls down while they roll on the floor: a torque of `rolling_friction` times weight times
    /// radius against the rotation. rapier has no rolling friction.
    fn roll(&mut self) {
        let dt = self.physics.integration_parameters.dt;
        for thing in &self.things {
            let Some((radius, rolling_friction)) = thing.rolls else { continue };
            let Some(body) = self.physics.bodies.get_mut(thing.handle) else { continue };
            let speed = Vector::new(body.angvel().x, body.angvel().y, 0.0).length();
            if body.translation().z > radius + ROLLING_GAP || speed == 0.0 {
                continue;
            }
            // The torque slows down the mass (r^2) and the rotation (0.4 r^2) of a solid ball.
            let lost = rolling_friction * STANDARD_GRAVITY as f32 * dt / (1.4 * radius);
            let kept = (1.0 - lost / speed).max(0.0);
            let (linear, angular) = (body.linvel(), body.angvel());
            body.set_linvel(Vector::new(linear.x * kept, linear.y * kept, linear.z), false);
            body.set_angvel(Vector::new(angular.x * kept, angular.y * kept, angular.z), false);
        }
    }

    fn forces_on(&self, foot: &Foot) -> [f64; 4] {
        let mut forces = [0.0; 4];
        let per_step = f64::from(self.physics.integration_parameters.dt);
        let sole_from_collider = foot.collider_from_sole.inverse();
        for pair in self.physics.narrow_phase.contact_pairs_with(foot.collider) {
            for manifold in pair.solver_manifolds() {
                for point in &manifold.points {
                    let local = if pair.collider1 == foot.collider { point.local_p1 } else { point.local_p2 };
                    let at = sole_from_collider.transform_point(double(local));
                    let corner = usize::from(at.x < 0.0) * 2 + usize::from(at.y < 0.0);
                    forces[corner] += f64::from(point.data.impulse) / per_step;
                }
            }
        }
        forces
    }

    /// Advances by one step, with one drive for each body of each robot.
    pub(crate) fn step_all<'a>(&mut self, drives: impl IntoIterator<Item = &'a [JointDrive]>) {
        for (robot, drives) in self.robots.iter().zip(drives) {
            let Some(multibody) = multibody_mut(&mut self.physics, &robot.links) else { continue };
            for (link, drive) in robot.links.iter().zip(drives).skip(1) {
                if let Some(joint) = multibody.link_mut(link.index) {
                    let (goal, stiffness, damping) =
                        (drive.goal as f32, drive.stiffness as f32, drive.damping as f32);
                    let motor = &mut joint.joint.data;
                    motor.set_motor_position(JointAxis::AngX, goal, stiffness, damping);
                    // Without stiffness and damping rapier's motor is a brake.
                    motor.set_motor_max_force(JointAxis::AngX, drive.max_torque as f32);
                }
            }
        }
        self.physics.step();
        self.roll();
        for handle in self.pushed.drain(..) {
            if let Some(body) = self.physics.bodies.get_mut(handle) {
                body.reset_forces(false);
                body.reset_torques(false);
            }
        }
        self.steps += 1;
    }

    /// The first robot that touches something.
    pub(crate) fn robot_that_touches(&self, thing: &str) -> Option<usize> {
        let thing = self.things.iter().find(|known| known.name == thing)?;
        let collider = *self.physics.bodies.get(thing.handle)?.colliders().first()?;
        let mut touching = self.physics.narrow_phase.contact_pairs_with(collider).filter_map(|pair| {
            let other = if pair.collider1 == collider { pair.collider2 } else { pair.collider1 };
            let body = self.physics.colliders.get(other)?.parent()?;
            let is_part = |robot: &Robot| robot.links.iter().any(|link| link.handle == body);
            self.robots.iter().position(is_part).filter(|_| pair.has_any_active_contact())
        });
        let first = touching.next()?;
        Some(touching.fold(first, usize::min))
    }

    /// What a robot is inside of, beside the floor and other robots, and how deep in m.
    pub(crate) fn overlap_with_things(&self, robot: usize) -> Option<(&str, f64)> {
        let colliders_of = |handle| {
            let body = self.physics.bodies.get(handle);
            body.into_iter().flat_map(|body| {
                let colliders =
                    body.colliders().iter().filter_map(|handle| self.physics.colliders.get(*handle));
                colliders.filter_map(|collider| {
                    Some((*body.position() * *collider.position_wrt_parent()?, collider.shape()))
                })
            })
        };
        self.things.iter().filter(|thing| thing.name != "floor").find_map(|thing| {
            let (there, other) = colliders_of(thing.handle).next()?;
            let depths = self.links(robot).iter().flat_map(|link| colliders_of(link.handle)).filter_map(
                |(here, shape)| {
                    let contact = query::contact(&here, shape, &there, other, 0.0).ok().flatten()?;
                    (contact.dist < -TOUCHING).then(|| f64::from(-contact.dist))
                },
            );
            depths.reduce(f64::max).map(|depth| (thing.name.as_str(), depth))
        })
    }

    pub(crate) fn foot_forces_of(&self, robot: usize) -> FootForces {
        let Some(robot) = self.robots.get(robot) else { return FootForces::default() };
        let [right, left] =
            robot.feet.each_ref().map(|foot| foot.as_ref().map_or([0.0; 4], |foot| self.forces_on(foot)));
        FootForces { right, left }
    }
}

impl RobotBodies for RapierRobot<'_> {
    fn joint(&self, body: usize) -> (f64, f64) {
        let physics = &self.world.physics;
        let Some(link) = self.world.links(self.robot).get(body) else { return (0.0, 0.0) };
        let found = physics.multibody_joints.rigid_body_link(link.handle);
        let multibody = found.and_then(|id| physics.multibody_joints.get_multibody(id.multibody));
        let joint = multibody.and_then(|multibody| Some((multibody, multibody.link(link.index)?)));
        joint.map_or((0.0, 0.0), |(multibody, joint)| {
            let velocity = multibody.joint_velocity(joint);
            (f64::from(joint.joint().coords()[3]), velocity.get(0).copied().map_or(0.0, f64::from))
        })
    }

    fn motion_of(&self, body: usize, body_from_frame: &Isometry) -> Option<Motion> {
        let handle = self.world.links(self.robot).get(body)?.handle;
        Some(motion(self.world.physics.bodies.get(handle)?, body_from_frame))
    }
}

impl RobotBodies for RapierWorld {
    fn joint(&self, body: usize) -> (f64, f64) {
        self.robot(0).joint(body)
    }

    fn motion_of(&self, body: usize, body_from_frame: &Isometry) -> Option<Motion> {
        self.robot(0).motion_of(body, body_from_frame)
    }
}

impl World for RapierWorld {
    fn step(&mut self, drives: &[JointDrive]) {
        self.step_all([drives]);
    }

    fn steps(&self) -> u64 {
        self.steps
    }

    fn things(&self) -> Vec<(&str, bool)> {
        let is_dynamic = |handle| self.physics.bodies.get(handle).is_some_and(RigidBody::is_dynamic);
        self.things.iter().map(|thing| (thing.name.as_str(), is_dynamic(thing.handle))).collect()
    }

    fn motion_of_thing(&self, name: &str) -> Option<Motion> {
        let thing = self.things.iter().find(|thing| thing.name == name)?;
        Some(motion(self.physics.bodies.get(thing.handle)?, &Isometry::IDENTITY))
    }

    fn set_motion_of_thing(&mut self, name: &str, motion: &Motion) -> bool {
        let Some(thing) = self.things.iter().find(|thing| thing.name == name) else { return false };
        match self.physics.bodies.get_mut(thing.handle) {
            Some(body) if body.is_dynamic() => {
                body.set_position(pose(&motion.world_from_body), true);
                body.set_linvel(vector(motion.linear), true);
                body.set_angvel(vector(motion.angular), true);
                true
            }
            _ => false,
        }
    }

    fn spawn(&mut self, spawned: &Spawned) {
        let thing = Surrounding::of(spawned).insert(&mut self.physics, self.friction);
        self.things.push(thing);
    }

    fn delete(&mut self, name: &str) -> bool {
        let Some(index) = self.things.iter().position(|thing| thing.name == name) else { return false };
        let Thing { handle, .. } = self.things.remove(index);
        self.physics.remove_body(handle);
        true
    }

    fn overlap_of(&self, spawned: &Spawned) -> Option<(&str, f64)> {
        let new = Surrounding::of(spawned);
        let links = self.links(0).iter().map(|link| ("the robot", link.handle));
        let things = self.things.iter().map(|thing| (thing.name.as_str(), thing.handle));
        links.chain(things).find_map(|(name, handle)| {
            let body = self.physics.bodies.get(handle)?;
            if new.mass.is_none() && !body.is_dynamic() {
                return None;
            }
            let depths = body.colliders().iter().filter_map(|collider| {
                let collider = self.physics.colliders.get(*collider)?;
                let there = *body.position() * *collider.position_wrt_parent()?;
                let contact = query::contact(&new.pose, &*new.shape, &there, collider.shape(), 0.0);
                let contact = contact.ok().flatten()?;
                (contact.dist < -TOUCHING).then(|| f64::from(-contact.dist))
            });
            depths.reduce(f64::max).map(|depth| (name, depth))
        })
    }

    fn set_pose_of_robot(&mut self, world_from_root: &Isometry) {
        let angles: Vec<f64> = (0..self.links(0).len()).map(|body| self.joint(body).0).collect();
        self.set_coordinates(0, *world_from_root, &angles);
    }

    fn push(&mut self, body: usize, impulse: DVec3, point: DVec3) {
        let Some(handle) = self.links(0).get(body).map(|link| link.handle) else { return };
        let force = vector(impulse) / self.physics.integration_parameters.dt;
        if let Some(body) = self.physics.bodies.get_mut(handle) {
            body.add_force_at_point(force, vector(point), true);
            self.pushed.push(handle);
        }
    }

    fn foot_forces(&self) -> Option<FootForces> {
        Some(self.foot_forces_of(0))
    }

    fn overlap_of_robot(&self) -> Option<(&str, f64)> {
        self.overlap_with_things(0)
    }

    fn hash(&self) -> u64 {
        let numbers = self.physics.bodies.iter().flat_map(|(_, body)| {
            let Pose { rotation, translation, .. } = *body.position();
            translation.to_array().into_iter().chain(rotation.to_array())
        });
        super::hash(numbers.flat_map(|number| number.to_bits().to_le_bytes()))
    }
}

fn turned_about_y(angle: f64) -> Isometry {
    Isometry { translation: DVec3::ZERO, rotation: DQuat::from_rotation_y(angle) }
}

fn multibody_mut<'a>(physics: &'a mut PhysicsWorld, links: &[Link]) -> Option<&'a mut Multibody> {
    let id = *physics.multibody_joints.rigid_body_link(links.first()?.handle)?;
    physics.multibody_joints.get_multibody_mut(id.multibody)
}

fn insert_robot(physics: &mut PhysicsWorld, model: &Model, variation: &Variation, friction: f32) -> Robot {
    let mut links: Vec<Link> = Vec::with_capacity(model.bodies.len());
    for (index, body) in model.bodies.iter().enumerate() {
        let shift = if index == 0 { variation.centre_of_mass } else { 0.0 };
        let mass = MassProperties::with_inertia_matrix(
            vector(body.centre_of_mass + DVec3::X * shift),
            (body.mass * variation.mass) as f32,
            matrix(body.inertia * variation.mass),
        );
        let built = RigidBodyBuilder::dynamic().can_sleep(false).additional_mass_properties(mass);
        let handle = physics.insert_body(built);
        for (body_from_shape, shape) in &body.shapes {
            let collider = ColliderBuilder::new(shared_shape(shape))
                .position(pose(&(*body_from_shape * upright(shape))))
                .density(0.0)
                .friction(friction)
                .restitution(0.0);
            physics.insert_collider(collider, Some(handle));
        }
        links.push(Link { handle, index: 0 });
    }
    let mut handles = Vec::new();
    for (index, body) in model.bodies.iter().enumerate() {
        let Some(joint) = &body.joint else { continue };
        let axis = Rotation::from_rotation_arc(Vector::X, vector(joint.axis));
        let mut parent_frame = pose(&joint.parent_from_body);
        parent_frame.rotation *= axis;
        let built = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
            .local_frame1(parent_frame)
            .local_frame2(Pose::from_rotation(axis))
            .contacts_enabled(false)
            .motor_model(JointAxis::AngX, MotorModel::ForceBased)
            .motor_max_force(JointAxis::AngX, 0.0)
            .limits(JointAxis::AngX, joint.limits.map(|limit| limit as f32))
            .build();
        let (parent, child) = (links[joint.parent].handle, links[index].handle);
        handles.push((index, physics.insert_multibody_joint(parent, child, built)));
    }
    for (body, handle) in handles {
        let Some((_, index)) = handle.and_then(|handle| physics.multibody_joints.get(handle)) else {
            continue;
        };
        links[body].index = index;
    }
    if let Some(multibody) = multibody_mut(physics, &links) {
        // Shapes of neighbours overlap in folded poses, which would be wrong physics without a word.
        multibody.set_self_contacts_enabled(false);
        let mut friction_of = vec![0.0; multibody.ndofs()];
        for (link, body) in links.iter().zip(&model.bodies) {
            if let (Some(joint), Some(description)) = (multibody.link(link.index), &body.joint) {
                friction_of[joint.assembly_id()] = description.friction as f32;
            }
        }
        multibody.damping_mut().fill(0.0);
        for (index, friction) in friction_of.into_iter().enumerate().skip(6) {
            multibody.armature_mut()[index] = ARMATURE as f32;
            multibody.frictions_mut()[index] = friction;
        }
    }
    let feet = model.marks.soles.each_ref().map(|name| {
        let &(body, body_from_sole) = model.frames.get(name)?;
        let handle = links.get(body)?.handle;
        let collider = *physics.bodies.get(handle)?.colliders().first()?;
        let body_from_collider = isometry(physics.colliders.get(collider)?.position_wrt_parent()?);
        Some(Foot { collider, collider_from_sole: body_from_collider.inverse() * body_from_sole })
    });
    Robot { links, feet }
}

/// A shape beside the robot.
struct Surrounding {
    name: String,
    block: Option<usize>,
    pose: Pose,
    shape: SharedShape,
    mass: Option<f32>,
    restitution: f32,
    /// The radius and the coefficient of rolling friction of a ball.
    rolls: Option<(f32, f32)>,
}

impl Surrounding {
    fn of(spawned: &Spawned) -> Self {
        let at = pose(&spawned.world_from_body);
        let (at, shape) = match spawned.shape {
            SpawnedShape::Ball { radius, .. } => (at, SharedShape::ball(radius as f32)),
            SpawnedShape::Box { size } => {
                let half = DVec3::from(size).as_vec3() / 2.0;
                (at, SharedShape::cuboid(half.x, half.y, half.z))
            }
            SpawnedShape::Post { diameter, height } => (
                at * Pose::from_rotation(upright_f32()),
                SharedShape::cylinder(height as f32 / 2.0, diameter as f32 / 2.0),
            ),
        };
        let rolls = match spawned.shape {
            SpawnedShape::Ball { radius, rolling_friction } => Some((radius as f32, rolling_friction as f32)),
            SpawnedShape::Box { .. } | SpawnedShape::Post { .. } => None,
        };
        Self {
            name: spawned.name.clone(),
            block: None,
            pose: at,
            shape,
            mass: spawned.mass.map(|mass| mass as f32),
            restitution: spawned.restitution as f32,
            rolls,
        }
    }

    fn insert(self, physics: &mut PhysicsWorld, friction: f32) -> Thing {
        let body = match self.mass {
            None => RigidBodyBuilder::fixed(),
            Some(_) => RigidBodyBuilder::dynamic().can_sleep(false),
        };
        // The axis of a post is the z axis of its body; rapier's cylinders are along y.
        let body_from_shape = match self.shape.as_cylinder() {
            Some(_) => Pose::from_rotation(upright_f32()),
            None => Pose::identity(),
        };
        let handle = physics.insert_body(body.pose(self.pose * body_from_shape.inverse()));
        let collider = ColliderBuilder::new(self.shape)
            .position(body_from_shape)
            .friction(friction)
            .restitution(self.restitution)
            .mass(self.mass.unwrap_or(0.0));
        physics.insert_collider(collider, Some(handle));
        Thing { name: self.name, handle, rolls: self.rolls }
    }
}

/// Half of the thickness of the floor, in m.
const FLOOR_DEPTH: f32 = 0.5;

fn surroundings(file: &WorldFile) -> Vec<Surrounding> {
    let fixed = |name: &str, pose, shape| Surrounding {
        name: name.to_owned(),
        block: None,
        pose,
        shape,
        mass: None,
        restitution: file.floor.restitution as f32,
        rolls: None,
    };
    let mut all = vec![fixed(
        "floor",
        Pose::translation(0.0, 0.0, -FLOOR_DEPTH),
        SharedShape::cuboid(1000.0, 1000.0, FLOOR_DEPTH),
    )];
    if let Some(field) = &file.field {
        let (radius, half) = (field.post_diameter as f32 / 2.0, field.goal_height as f32 / 2.0);
        for (name, at) in file.posts() {
            let position = Vector::new(at.x as f32, at.y as f32, half);
            all.push(fixed(
                name,
                Pose::from_parts(position, upright_f32()),
                SharedShape::cylinder(half, radius),
            ));
        }
    }
    for (index, block) in file.boxes.iter().enumerate() {
        let isometry = Isometry {
            translation: DVec3::from(block.position),
            rotation: DQuat::from_rotation_z(block.yaw),
        };
        let half = DVec3::from(block.size) / 2.0;
        let shape = SharedShape::cuboid(half.x as f32, half.y as f32, half.z as f32);
        let mass = block.mass.map(|mass| mass as f32);
        all.push(Surrounding { block: Some(index), mass, ..fixed(&block.name, pose(&isometry), shape) });
    }
    if let Some(ball) = &file.ball {
        let radius = ball.radius as f32;
        let at = Pose::translation(ball.position[0] as f32, ball.position[1] as f32, radius);
        all.push(Surrounding {
            mass: Some(ball.mass as f32),
            restitution: ball.restitution as f32,
            rolls: Some((radius, ball.rolling_friction as f32)),
            ..fixed("ball", at, SharedShape::ball(radius))
        });
    }
    all
}

/// Two things in the same place.
pub(crate) struct Overlap {
    /// The index of the box that is in the way; `None` if it is the ball.
    pub(crate) block: Option<usize>,
    pub(crate) what: String,
    pub(crate) other: String,
    /// In m.
    pub(crate) depth: f64,
}

/// What may be inside each other, in m: single precision.
const TOUCHING: f32 = 1e-4;

/// The first two things of a world, at least one of which can move, that are in the same place.
pub(crate) fn overlap(file: &WorldFile) -> Option<Overlap> {
    let all = surroundings(file);
    let called = |thing: &Surrounding| match thing.name.as_str() {
        "floor" | "ball" => format!("the {}", thing.name),
        name => format!("\"{name}\""),
    };
    for (index, second) in all.iter().enumerate() {
        for first in &all[..index] {
            if first.mass.is_none() && second.mass.is_none() {
                continue;
            }
            let contact = query::contact(&first.pose, &*first.shape, &second.pose, &*second.shape, 0.0);
            let Some(contact) = contact.ok().flatten().filter(|contact| contact.dist < -TOUCHING) else {
                continue;
            };
            return Some(Overlap {
                block: second.block,
                what: called(second),
                other: called(first),
                depth: f64::from(-contact.dist),
            });
        }
    }
    None
}

/// rapier's cylinders are along y.
fn upright(shape: &Shape) -> Isometry {
    match shape {
        Shape::Cylinder { .. } => Isometry {
            translation: DVec3::ZERO,
            rotation: DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
        },
        Shape::Box(_) | Shape::Sphere(_) => Isometry::IDENTITY,
    }
}

fn upright_f32() -> Rotation {
    Rotation::from_rotation_x(std::f32::consts::FRAC_PI_2)
}

fn shared_shape(shape: &Shape) -> SharedShape {
    match *shape {
        Shape::Box([x, y, z]) => SharedShape::cuboid(x as f32 / 2.0, y as f32 / 2.0, z as f32 / 2.0),
        Shape::Cylinder { radius, length } => SharedShape::cylinder(length as f32 / 2.0, radius as f32),
        Shape::Sphere(radius) => SharedShape::ball(radius as f32),
    }
}

fn motion(body: &RigidBody, body_from_frame: &Isometry) -> Motion {
    let world_from_body = isometry(body.position()) * *body_from_frame;
    let linear = body.velocity_at_point(vector(world_from_body.translation));
    Motion { world_from_body, linear: double(linear), angular: double(body.angvel()) }
}

fn vector(of: DVec3) -> Vector {
    Vector::new(of.x as f32, of.y as f32, of.z as f32)
}

fn matrix(of: DMat3) -> Matrix {
    Matrix::from_cols(vector(of.x_axis), vector(of.y_axis), vector(of.z_axis))
}

fn double(of: Vector) -> DVec3 {
    DVec3::new(f64::from(of.x), f64::from(of.y), f64::from(of.z))
}

fn pose(of: &Isometry) -> Pose {
    let DQuat { x, y, z, w } = of.rotation;
    let rotation = Rotation::from_xyzw(x as f32, y as f32, z as f32, w as f32).normalize();
    Pose::from_parts(vector(of.translation), rotation)
}

fn isometry(of: &Pose) -> Isometry {
    let [x, y, z, w] = of.rotation.to_array().map(f64::from);
    Isometry { translation: double(of.translation), rotation: DQuat::from_xyzw(x, y, z, w).normalize() }
}
