//! The simulator as a module: the emulated devices of a humanoid robot whose body is in a simulated world.
//!
//! Without settings the robot is the Darwin OP. Another one has a file of its numbers (`humanoid`, see
//! [`humanoid`](downbeat_darwin_op::humanoid)), whose description says how strong its servos are, and a file
//! of its servos (`description`), behind whose bus it is.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `ground_truth/odom` | nav_msgs/Odometry | pose of the root link in `world`, its velocity along its own axes |
//! | `ground_truth/ball` | geometry_msgs/PoseStamped | if the world has a ball |
//! | `camera/image_raw`, `camera/camera_info` | sensor_msgs/Image, CameraInfo | if `camera_hz` is not 0: rgb8, frame `camera_frame`; simulated |
//! | `simulation` | diagnostic_msgs/DiagnosticStatus | engine, step, seed and world; once every 10 s |
//! | `push` (in) | geometry_msgs/Vector3Stamped | an impulse in N s along the axes of the world, on the link in `frame_id`; dropped if its stamp is older or newer than `push_timeout` |
//! | `simulator/...` | services and an action of simulation_interfaces | see `services` |
//!
//! A replay leaves it out, as the emulator; of bags of simulated time it runs again with `--simulators`.

mod services;
mod settings;

use crate::camera::{Camera, Scene};
use crate::scenery::WorldFile;
use crate::simulation::{Request, Simulation, SimulationOptions, Snapshot};
use crate::spawned::Spawned;
use crate::world::Motion;
use downbeat_darwin_op::emulator::{self, Emulator, EmulatorError, EmulatorOptions, MemoryPorts, Timing};
use downbeat_executor::{
    Context, Job, JobError, Module, Publication, Received, Setting, Setup, SetupError, Time, TransitionError,
};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use downbeat_msgs::geometry_msgs::msg::{
    Point, Pose, PoseStamped, Quaternion, Twist, Vector3, Vector3Stamped,
};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_servos::servo_bus::BusPlan;
use downbeat_servos::stamps::{Stale, given_at};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use services::Services;
use settings::{Settings, value};
use std::path::PathBuf;
use std::time::Duration;

/// How often engine, step and seed are published.
const REPORT: Duration = Duration::from_secs(10);
/// The frame of the world.
const WORLD: &str = "world";
/// The largest impulse, in N s: what stops the robot at 30 m/s.
const LARGEST_PUSH: f64 = 100.0;

/// Simulates a humanoid robot; see the [module page](self).
pub struct HumanoidSimulator {
    ports: MemoryPorts,
    parts: Option<Parts>,
    services: Services,
    is_rendering: bool,
    stale: Stale,
}

/// What exists from the setup on.
struct Parts {
    simulation: Simulation,
    emulator: Option<Emulator>,
    options: EmulatorOptions,
    /// `None`: those of the Darwin OP.
    servos: Option<BusPlan>,
    /// Without what was deleted.
    world: WorldFile,
    spawned: Vec<Spawned>,
    root: String,
}

/// The keys of [`HumanoidSimulator`].
pub struct Ports {
    odometry: Publication<Odometry>,
    ball: Publication<PoseStamped>,
    images: Option<CameraPorts>,
    report: Publication<DiagnosticStatus>,
    push_timeout: Setting<f64>,
}

#[derive(Clone)]
struct CameraPorts {
    camera: Camera,
    frame: String,
    image: Publication<Image>,
    info: Publication<CameraInfo>,
    job: Job<(Time, Vec<u8>)>,
}

impl HumanoidSimulator {
    /// A simulator whose robot is behind a pseudo terminal, or among these ports in memory.
    #[must_use]
    pub fn new(ports: MemoryPorts) -> Self {
        Self {
            ports,
            parts: None,
            services: Services::default(),
            is_rendering: false,
            stale: Stale::default(),
        }
    }

    /// Brings the world to the time of the run, before anything is looked at or asked for: so it does not
    /// matter whether the hardware module ran before in the same cycle.
    fn begin(&self, now: Time) -> Option<&Parts> {
        let parts = self.parts.as_ref()?;
        if let Some(emulator) = &parts.emulator {
            emulator.begin_step(now);
        }
        Some(parts)
    }

    fn tell_truth(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(parts) = self.begin(now) else { return };
        let snapshot = parts.simulation.snapshot();
        let odometry = odometry(now, &parts.root, &snapshot.robot);
        ctx.publish(ctx.ports.odometry, odometry);
        if let Some((.., ball)) = snapshot.things.iter().find(|(name, ..)| name == "ball") {
            let pose = pose_message(&ball.world_from_body);
            ctx.publish(ctx.ports.ball, PoseStamped { header: header(now, WORLD), pose });
        }
    }

    fn look(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(&CameraPorts { job, camera, .. }) = ctx.ports.images.as_ref() else { return };
        let Some(parts) = self.begin(now).filter(|_| !self.is_rendering) else { return };
        let Snapshot { camera: Some(at), things, .. } = parts.simulation.snapshot() else { return };
        let pose_of =
            |name: &str| things.iter().find(|thing| thing.0 == name).map(|thing| thing.2.world_from_body);
        let scene = Scene::new(&parts.world, pose_of).with_spawned(&parts.spawned, pose_of);
        ctx.spawn(job, move || (now, scene.render(&camera, &at)));
        self.is_rendering = true;
    }

    fn show(&mut self, picture: Result<(Time, Vec<u8>), JobError>, ctx: &mut Context<'_, Ports>) {
        self.is_rendering = false;
        let Some(CameraPorts { image, info, camera, ref frame, .. }) = ctx.ports.images.clone() else {
            return;
        };
        match picture {
            Ok((at, data)) => {
                let Camera { width, height, .. } = camera;
                let header = header(at, frame);
                ctx.publish(info, camera.info(header.clone()));
                let encoding = "rgb8".to_owned();
                ctx.publish(
                    image,
                    Image { header, height, width, encoding, is_bigendian: 0, step: width * 3, data },
                );
            }
            Err(error) => tracing::error!("a picture was not rendered: {error}"),
        }
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(parts) = self.begin(ctx.now()) else { return };
        let message = report(&parts.simulation.options(), parts.options.seed, &parts.simulation.snapshot());
        ctx.publish(ctx.ports.report, message);
    }

    fn on_push(&mut self, push: Received<'_, Vector3Stamped>, ctx: &mut Context<'_, Ports>) {
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.push_timeout));
        if let Err(reason) = given_at(&push.header.stamp, ctx.now(), timeout) {
            return self.stale.drop_for("push", &reason);
        }
        let Some(parts) = self.begin(ctx.now()) else { return };
        let impulse = DVec3::new(push.vector.x, push.vector.y, push.vector.z);
        if impulse.is_nan() || impulse.length() > LARGEST_PUSH {
            tracing::warn!("a push of {impulse} N s is ignored; the largest one is {LARGEST_PUSH} N s");
            return;
        }
        let link = push.header.frame_id.clone();
        if !parts.simulation.request(Request::Push { link, impulse, point: DVec3::ZERO }) {
            tracing::warn!("too many pushes at once: one is ignored");
        }
    }
}

impl Module for HumanoidSimulator {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = Settings::declare(setup)?;
        let servos = settings.servos(setup)?;
        let (options, seed) = settings.simulation(setup, servos.as_ref())?;
        let camera_frame = options.model.marks.camera.clone();
        let (world, root) = (options.world.clone(), options.model.bodies[0].link.clone());
        let simulation = Simulation::new(options).map_err(|error| setup.refuse(error.to_string()))?;
        let link = value(setup, settings.link);
        let is_memory = MemoryPorts::is_memory(&link);
        let options = EmulatorOptions {
            link: Some(PathBuf::from(&link)),
            seed,
            timing: if is_memory { Timing::Stepped } else { Timing::Measured },
            faults: settings.faults(setup)?,
        };
        // Here and not when it is activated: the hardware module may look for it in the same cycle.
        let emulator = is_memory.then(|| devices_in_memory(servos.as_ref(), &options, &simulation));
        if let Some(emulator) = &emulator {
            self.ports
                .offer(&link, emulator)
                .map_err(|error| setup.refuse_value(settings.link, error.to_string()))?;
        }
        self.parts = Some(Parts { simulation, emulator, options, servos, world, spawned: Vec::new(), root });
        let interfaces = value(setup, settings.interfaces);
        services::declare(setup, &mut self.services, &interfaces)?;
        setup.subscribe("push", Self::on_push)?;
        let period = |hz: f64| Duration::from_secs_f64(1.0 / hz);
        setup.every(
            period(settings.rate(setup, settings.ground_truth_hz)?.unwrap_or(50.0)),
            Self::tell_truth,
        )?;
        setup.every(REPORT, Self::report)?;
        let images = match settings.rate(setup, settings.camera_hz)? {
            Some(hz) => {
                setup.every(period(hz), Self::look)?;
                Some(CameraPorts {
                    camera: settings.camera(setup)?,
                    frame: camera_frame,
                    image: setup.publish("camera/image_raw")?,
                    info: setup.publish("camera/camera_info")?,
                    job: setup.job(Self::show),
                })
            }
            None => None,
        };
        Ok(Ports {
            odometry: setup.publish("ground_truth/odom")?,
            ball: setup.publish("ground_truth/ball")?,
            images,
            report: setup.publish("simulation")?,
            push_timeout: settings.push_timeout,
        })
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        if let Some(parts) = self.parts.as_mut().filter(|parts| parts.emulator.is_none()) {
            parts.emulator = Some(devices_at_port(parts)?);
        }
        self.report(ctx);
        Ok(())
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_, Ports>) {
        self.close();
    }
}

impl HumanoidSimulator {
    /// A port in memory stays: it is no more than the robot itself.
    fn close(&mut self) {
        if let Some(parts) = self.parts.as_mut().filter(|parts| parts.options.timing == Timing::Measured) {
            parts.emulator = None;
        }
    }
}

fn devices_in_memory(
    servos: Option<&BusPlan>,
    options: &EmulatorOptions,
    simulation: &Simulation,
) -> Emulator {
    match servos {
        None => emulator::in_memory(options, Some(simulation.body())),
        Some(plan) => Emulator::servos_with(plan, options, simulation.body()),
    }
}

fn devices_at_port(parts: &Parts) -> Result<Emulator, EmulatorError> {
    let (options, body) = (parts.options.clone(), parts.simulation.body());
    match &parts.servos {
        None => emulator::start_with(options, body),
        Some(plan) => Emulator::start_servos_with(plan, options, body),
    }
}

fn report(options: &SimulationOptions, seed: u64, snapshot: &Snapshot) -> DiagnosticStatus {
    let SimulationOptions { model, world, step, variation, engine, .. } = options;
    let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
    DiagnosticStatus {
        level: DiagnosticStatus::OK,
        name: "simulation".to_owned(),
        message: format!("{}, simulated", model.name),
        hardware_id: engine.to_string(),
        values: vec![
            value("engine", engine.to_string()),
            value("step_ms", step.as_millis().to_string()),
            value("seed", seed.to_string()),
            value("world", world.name.clone()),
            value("variation", format!("{variation:?}")),
            value("simulated_s", format!("{:.3}", snapshot.elapsed.as_secs_f64())),
            value("steps", snapshot.steps.to_string()),
        ],
    }
}

fn header(at: Time, frame_id: &str) -> Header {
    Header { stamp: builtin_interfaces::msg::Time::from_nanos(at.as_nanos()), frame_id: frame_id.to_owned() }
}

fn odometry(now: Time, root: &str, motion: &Motion) -> Odometry {
    let root_from_world = motion.world_from_body.rotation.conjugate();
    let mut message =
        Odometry { header: header(now, WORLD), child_frame_id: root.to_owned(), ..Odometry::default() };
    message.pose.pose = pose_message(&motion.world_from_body);
    message.twist.twist = twist_message(root_from_world * motion.linear, root_from_world * motion.angular);
    message
}

fn pose_message(of: &Isometry) -> Pose {
    let (DVec3 { x, y, z }, rotation) = (of.translation, of.rotation);
    let orientation = Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w };
    Pose { position: Point { x, y, z }, orientation }
}

fn twist_message(linear: DVec3, angular: DVec3) -> Twist {
    let vector = |of: DVec3| Vector3 { x: of.x, y: of.y, z: of.z };
    Twist { linear: vector(linear), angular: vector(angular) }
}

/// The pose of a message; `None` if a number is not finite or too large, or the quaternion has another norm
/// than 1.
fn isometry(of: &Pose) -> Option<Isometry> {
    let (Point { x, y, z }, q) = (of.position, of.orientation);
    let (translation, rotation) = (DVec3::new(x, y, z), DQuat::from_xyzw(q.x, q.y, q.z, q.w));
    let is_possible = translation.abs().max_element() <= 1000.0 && (rotation.length() - 1.0).abs() < 0.01;
    is_possible.then(|| Isometry { translation, rotation: rotation.normalize() })
}
