//! The simulator as a module: an emulated Darwin OP whose body is in a simulated world.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `ground_truth/odom` | nav_msgs/Odometry | pose of the root link in `world`, its velocity along its own axes |
//! | `ground_truth/ball` | geometry_msgs/PoseStamped | if the world has a ball |
//! | `camera/image_raw`, `camera/camera_info` | sensor_msgs/Image, CameraInfo | if `camera_hz` is not 0: rgb8, frame `camera_optical_frame`; simulated |
//! | `simulation` | diagnostic_msgs/DiagnosticStatus | engine, step, seed and world; once every 10 s |
//! | `push` (in) | geometry_msgs/Vector3Stamped | an impulse in N s along the axes of the world, on the link in `frame_id`; dropped if its stamp is older or newer than `push_timeout` |
//! | `simulator/...` | services and an action of simulation_interfaces | see `services` |
//!
//! A replay leaves it out, as the emulator; of bags of simulated time it runs again with `--simulators`.

mod services;

use crate::camera::{Camera, Scene};
use crate::harness::DARWIN_OP;
use crate::model::Model;
use crate::simulation::{Request, Simulation, SimulationOptions, Snapshot};
use crate::spawned::Spawned;
use crate::world::{Engine, Motion, Posture, Start, Variation};
use crate::world_file::WorldFile;
use downbeat_darwin_op::emulator::{self, Emulator, EmulatorOptions, Fault, MemoryPorts, Timing};
use downbeat_executor::{
    Context, Job, JobError, Module, Publication, Received, Setting, SettingType, Setup, SetupError, Time,
    TransitionError,
};
use downbeat_kinematics::Robot;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use downbeat_msgs::geometry_msgs::msg::{
    Point, Pose, PoseStamped, Quaternion, Twist, Vector3, Vector3Stamped,
};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_servos::stamps::{Stale, given_at};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use services::Services;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often engine, step and seed are published.
const REPORT: Duration = Duration::from_secs(10);
/// The frame of the world.
const WORLD: &str = "world";
const OPTICAL_FRAME: &str = "camera_optical_frame";
/// The largest impulse, in N s: what stops the robot at 30 m/s.
const LARGEST_PUSH: f64 = 100.0;

/// Simulates a Darwin OP; see the [module page](self).
pub struct DarwinOpSimulator {
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
    /// Without what was deleted.
    world: WorldFile,
    spawned: Vec<Spawned>,
    root: String,
}

/// The keys of [`DarwinOpSimulator`].
pub struct Ports {
    odometry: Publication<Odometry>,
    ball: Publication<PoseStamped>,
    images: Option<CameraPorts>,
    report: Publication<DiagnosticStatus>,
    push_timeout: Setting<f64>,
}

struct CameraPorts {
    image: Publication<Image>,
    info: Publication<CameraInfo>,
    job: Job<(Time, Vec<u8>)>,
}

impl DarwinOpSimulator {
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
        let Some(CameraPorts { job, .. }) = ctx.ports.images else { return };
        let Some(parts) = self.begin(now).filter(|_| !self.is_rendering) else { return };
        let Snapshot { camera: Some(camera), things, .. } = parts.simulation.snapshot() else { return };
        let pose_of =
            |name: &str| things.iter().find(|thing| thing.0 == name).map(|thing| thing.2.world_from_body);
        let scene = Scene::new(&parts.world, pose_of).with_spawned(&parts.spawned, pose_of);
        ctx.spawn(job, move || (now, scene.render(&Camera::darwin_op(), &camera)));
        self.is_rendering = true;
    }

    fn show(&mut self, picture: Result<(Time, Vec<u8>), JobError>, ctx: &mut Context<'_, Ports>) {
        self.is_rendering = false;
        let Some(CameraPorts { image, info, .. }) = ctx.ports.images else { return };
        match picture {
            Ok((at, data)) => {
                let Camera { width, height, .. } = Camera::darwin_op();
                let header = header(at, OPTICAL_FRAME);
                ctx.publish(info, Camera::darwin_op().info(header.clone()));
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

impl Module for DarwinOpSimulator {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = Settings::declare(setup)?;
        let (options, seed) = settings.simulation(setup)?;
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
        let emulator = is_memory.then(|| emulator::in_memory(&options, Some(simulation.body())));
        if let Some(emulator) = &emulator {
            self.ports
                .offer(&link, emulator)
                .map_err(|error| setup.refuse_value(settings.link, error.to_string()))?;
        }
        self.parts = Some(Parts { simulation, emulator, options, world, spawned: Vec::new(), root });
        services::declare(setup, &mut self.services)?;
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
            parts.emulator = Some(emulator::start_with(parts.options.clone(), parts.simulation.body())?);
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

impl DarwinOpSimulator {
    /// A port in memory stays: it is no more than the robot itself.
    fn close(&mut self) {
        if let Some(parts) = self.parts.as_mut().filter(|parts| parts.options.timing == Timing::Measured) {
            parts.emulator = None;
        }
    }
}

/// The keys of the settings.
struct Settings {
    link: Setting<String>,
    seed: Setting<i64>,
    faults: Setting<Vec<String>>,
    physics: Setting<String>,
    urdf: Setting<String>,
    world: Setting<String>,
    step_ms: Setting<i64>,
    posture: Setting<String>,
    start: Setting<Vec<f64>>,
    mass: Setting<f64>,
    friction: Setting<f64>,
    strength: Setting<f64>,
    backlash_deg: Setting<f64>,
    latency_ms: Setting<i64>,
    ground_truth_hz: Setting<f64>,
    camera_hz: Setting<f64>,
    push_timeout: Setting<f64>,
}

impl Settings {
    fn declare(setup: &mut Setup<'_, DarwinOpSimulator>) -> Result<Self, SetupError> {
        let link = "memory:darwin_op".to_owned();
        Ok(Self {
            link: setup.read_only_setting(
                "link",
                link,
                "path of the port, or memory:NAME; the hardware module's setting \"port\" is the same",
            )?,
            seed: setup.read_only_setting("seed", 1_i64, "same seed, same noise and faults")?,
            faults: setup.read_only_setting("faults", Vec::<String>::new(), "as of darwin_op_emulator")?,
            physics: setup.read_only_choice(
                "physics",
                "rapier",
                &["rapier", "mujoco"],
                "the engine: rapier, or mujoco if it is built in",
            )?,
            urdf: setup.read_only_setting(
                "urdf",
                String::new(),
                "path of the robot; empty: the built-in Darwin OP",
            )?,
            world: setup.read_only_setting("world", String::new(), "path of the world; empty: a floor")?,
            step_ms: setup.read_only_setting("step_ms", 4_i64, "step of the physics, 1 to 10")?,
            posture: setup.read_only_choice(
                "posture",
                "standing",
                &["standing", "prone", "supine"],
                "standing, prone or supine",
            )?,
            start: setup.read_only_setting("start", vec![0.0, 0.0, 0.0], "x and y, m; heading, degrees")?,
            mass: setup.read_only_setting("mass", 1.0, "factor on all masses")?,
            friction: setup.read_only_setting("friction", 1.0, "factor on the friction of contacts")?,
            strength: setup.read_only_setting("strength", 1.0, "factor on the torque of the servos")?,
            backlash_deg: setup.read_only_setting("backlash_deg", 0.33, "free play of the gears, degrees")?,
            latency_ms: setup.read_only_setting(
                "latency_ms",
                0_i64,
                "delay of the servos beside that of the bus",
            )?,
            ground_truth_hz: setup.read_only_setting(
                "ground_truth_hz",
                50.0,
                "rate of ground_truth/*, Hz",
            )?,
            camera_hz: setup.read_only_setting("camera_hz", 0.0, "rate of camera/*, Hz; 0: no pictures")?,
            push_timeout: setup.setting_in(
                "push_timeout",
                0.5,
                0.0..=3600.0,
                "s by which the stamp of a push may be older or newer than now; 0: any; a stamp of 0 means now",
            )?,
        })
    }

    /// The simulation and its seed.
    fn simulation(
        &self,
        setup: &Setup<'_, DarwinOpSimulator>,
    ) -> Result<(SimulationOptions, u64), SetupError> {
        let urdf = value(setup, self.urdf);
        let robot = match urdf.as_str() {
            "" => Robot::from_urdf(DARWIN_OP, "darwin_op.urdf"),
            path => Robot::read(path),
        };
        let robot = robot.map_err(|error| setup.refuse_value(self.urdf, error.to_string()))?;
        robot.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
        let model = Model::new(&robot).map_err(|error| setup.refuse_value(self.urdf, error.to_string()))?;
        let world = match value(setup, self.world).as_str() {
            "" => WorldFile::default(),
            path => WorldFile::read(Path::new(path))
                .map_err(|error| setup.refuse_value(self.world, error.to_string()))?,
        };
        let engine = value(setup, self.physics).parse::<Engine>();
        let engine = engine.map_err(|error| setup.refuse_value(self.physics, error.to_string()))?;
        let posture = match value(setup, self.posture).as_str() {
            "standing" => Posture::Standing,
            "prone" => Posture::Prone,
            "supine" => Posture::Supine,
            other => {
                let refusal = format!("{other:?} is no posture; there are standing, prone and supine");
                return Err(setup.refuse_value(self.posture, refusal));
            }
        };
        let start = value(setup, self.start);
        let &[x, y, heading] = start.as_slice() else {
            return Err(setup.refuse_value(self.start, "three numbers are needed: x, y, heading"));
        };
        if ![x, y, heading].iter().all(|number| number.abs() <= 1000.0) {
            return Err(setup.refuse_value(self.start, "numbers have to be between -1000 and 1000"));
        }
        let factor = |setting| {
            let factor = value(setup, setting);
            let is_possible = (0.01..=100.0).contains(&factor);
            if is_possible {
                Ok(factor)
            } else {
                Err(setup.refuse_value(setting, "it has to be 0.01 to 100"))
            }
        };
        let (backlash, latency) = (value(setup, self.backlash_deg), value(setup, self.latency_ms));
        if !(0.0..=10.0).contains(&backlash) {
            return Err(setup.refuse_value(self.backlash_deg, "it has to be 0 to 10"));
        }
        let latency = u64::try_from(latency).ok().filter(|latency| *latency <= 1000);
        let latency = latency.ok_or_else(|| setup.refuse_value(self.latency_ms, "it has to be 0 to 1000"))?;
        let step = u64::try_from(value(setup, self.step_ms)).ok().filter(|step| (1..=10).contains(step));
        let step = step.ok_or_else(|| setup.refuse_value(self.step_ms, "it has to be 1 to 10"))?;
        let variation = Variation {
            mass: factor(self.mass)?,
            friction: factor(self.friction)?,
            strength: factor(self.strength)?,
            backlash: backlash.to_radians(),
            latency: Duration::from_millis(latency),
            ..Variation::default()
        };
        let ready = Start::walking_ready();
        let start = Start { posture, position: [x, y], yaw: heading.to_radians(), ..ready };
        // Negative seeds are valid.
        let seed = value(setup, self.seed).cast_unsigned();
        let step = Duration::from_millis(step);
        Ok((SimulationOptions { model, world, start, step, variation, engine }, seed))
    }

    fn faults(&self, setup: &Setup<'_, DarwinOpSimulator>) -> Result<Vec<Fault>, SetupError> {
        let texts = value(setup, self.faults);
        let faults: Result<_, _> = texts.iter().map(|text| text.parse::<Fault>()).collect();
        faults.map_err(|error| setup.refuse_value(self.faults, error.to_string()))
    }

    /// `None` if it is 0.
    fn rate(
        &self,
        setup: &Setup<'_, DarwinOpSimulator>,
        rate: Setting<f64>,
    ) -> Result<Option<f64>, SetupError> {
        match value(setup, rate) {
            0.0 => Ok(None),
            hz if (0.1..=1000.0).contains(&hz) => Ok(Some(hz)),
            _ => Err(setup.refuse_value(rate, "it has to be 0, or 0.1 to 1000")),
        }
    }
}

fn value<T: SettingType + Clone + Default>(setup: &Setup<'_, DarwinOpSimulator>, setting: Setting<T>) -> T {
    setup.value(setting).cloned().unwrap_or_default()
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
