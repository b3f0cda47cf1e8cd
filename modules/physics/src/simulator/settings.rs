//! The settings of the simulator.

use super::services::VERSIONS;
use crate::camera::Camera;
use crate::harness::{DARWIN_OP, joint_names};
use crate::model::{Marks, Model};
use crate::scenery::WorldFile;
use crate::simulation::SimulationOptions;
use crate::world::{Engine, Posture, Start, Variation};
use downbeat_darwin_op::emulator::Fault;
use downbeat_darwin_op::humanoid::Humanoid;
use downbeat_executor::{Module, Setting, SettingType, Setup, SetupError};
use downbeat_kinematics::Robot;
use downbeat_servos::servo_bus::{BusPlan, Description};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The most columns or rows of a picture.
const LARGEST_PICTURE: u32 = 4096;

/// The keys of the settings.
pub(super) struct Settings {
    pub(super) link: Setting<String>,
    seed: Setting<i64>,
    faults: Setting<Vec<String>>,
    physics: Setting<String>,
    /// The robot's numbers.
    humanoid: Arc<Humanoid>,
    description: Setting<String>,
    bus: Setting<String>,
    urdf: Setting<String>,
    imu_frame: Setting<String>,
    camera_frame: Setting<String>,
    camera_size: Setting<Vec<i64>>,
    camera_focal: Setting<Vec<f64>>,
    world: Setting<String>,
    step_ms: Setting<i64>,
    posture: Setting<String>,
    start: Setting<Vec<f64>>,
    mass: Setting<f64>,
    friction: Setting<f64>,
    strength: Setting<f64>,
    backlash_deg: Setting<f64>,
    latency_ms: Setting<i64>,
    pub(super) ground_truth_hz: Setting<f64>,
    pub(super) camera_hz: Setting<f64>,
    pub(super) push_timeout: Setting<f64>,
    pub(super) interfaces: Setting<String>,
}

impl Settings {
    pub(super) fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
        let link = "memory:darwin_op".to_owned();
        let humanoid = Humanoid::declare(setup)?;
        let (marks, camera) = (Marks::default(), Camera::darwin_op());
        Ok(Self {
            humanoid,
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
            description: setup.read_only_setting(
                "description",
                String::new(),
                "file of the robot's servos, as of servo_bus; empty: the bus of the Darwin OP",
            )?,
            bus: setup.read_only_setting("bus", String::new(), "the bus of that file, if it has several")?,
            urdf: setup.read_only_setting(
                "urdf",
                String::new(),
                "path of the robot; empty: that of the setting humanoid",
            )?,
            imu_frame: setup.read_only_setting("imu_frame", marks.imu, "the link that is the IMU")?,
            camera_frame: setup.read_only_setting(
                "camera_frame",
                marks.camera,
                "the link that is the camera, with z ahead and y down",
            )?,
            camera_size: setup.read_only_setting(
                "camera_size",
                vec![i64::from(camera.width), i64::from(camera.height)],
                "columns and rows of its pictures",
            )?,
            camera_focal: setup.read_only_setting(
                "camera_focal",
                camera.focal.to_vec(),
                "its focal lengths, horizontal and vertical, pixels",
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
            interfaces: setup.read_only_choice(
                "interfaces",
                VERSIONS[0],
                &VERSIONS,
                "the version of simulation_interfaces whose services are served; Jazzy and Kilted have 1.5",
            )?,
        })
    }

    /// The servos of the robot; `None` for those of the Darwin OP.
    pub(super) fn servos<M: Module>(&self, setup: &Setup<'_, M>) -> Result<Option<BusPlan>, SetupError> {
        let text = value(setup, self.description);
        if text.is_empty() {
            return Ok(None);
        }
        let loaded = Description::load(&text)
            .map_err(|error| setup.refuse_value(self.description, error.to_string()))?;
        let plan = loaded.bus(&value(setup, self.bus));
        plan.map(|plan| Some(plan.clone())).map_err(|error| setup.refuse_value(self.bus, error.to_string()))
    }

    /// The camera.
    pub(super) fn camera<M: Module>(&self, setup: &Setup<'_, M>) -> Result<Camera, SetupError> {
        let (size, focal) = (value(setup, self.camera_size), value(setup, self.camera_focal));
        let pixels = |size: i64| u32::try_from(size).ok().filter(|size| (1..=LARGEST_PICTURE).contains(size));
        let [Some(width), Some(height)] = [0, 1].map(|axis| pixels(*size.get(axis)?)) else {
            let refusal = format!("two numbers from 1 to {LARGEST_PICTURE} are needed: columns, rows");
            return Err(setup.refuse_value(self.camera_size, refusal));
        };
        match focal[..] {
            [x, y] if [x, y].iter().all(|focal| (1.0..=1e5).contains(focal)) => {
                Ok(Camera { width, height, focal: [x, y] })
            }
            _ => Err(setup.refuse_value(self.camera_focal, "two numbers from 1 to 100000 are needed")),
        }
    }

    /// The model of the robot.
    fn model<M: Module>(&self, setup: &Setup<'_, M>) -> Result<Model, SetupError> {
        let urdf = value(setup, self.urdf);
        let robot = match (urdf.as_str(), self.humanoid.description()) {
            ("", None) => Robot::from_urdf(DARWIN_OP, "darwin_op.urdf"),
            ("", Some(path)) => Robot::read(path),
            (path, _) => Robot::read(path),
        };
        let robot = robot.map_err(|error| setup.refuse_value(self.urdf, error.to_string()))?;
        robot.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
        let model = Model::new(&robot).map_err(|error| setup.refuse_value(self.urdf, error.to_string()))?;
        let soles = self.humanoid.soles().clone();
        let marks =
            Marks { soles, imu: value(setup, self.imu_frame), camera: value(setup, self.camera_frame) };
        Ok(Model { marks, ..model })
    }

    /// The simulation and its seed.
    pub(super) fn simulation<M: Module>(
        &self,
        setup: &Setup<'_, M>,
        servos: Option<&BusPlan>,
    ) -> Result<(SimulationOptions, u64), SetupError> {
        let model = self.model(setup)?;
        let joints = match servos {
            None => joint_names(),
            Some(plan) => plan.joints.iter().map(|joint| joint.name.clone()).collect(),
        };
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
        let ready = Start::standing(&self.humanoid);
        let start = Start { posture, position: [x, y], yaw: heading.to_radians(), ..ready };
        // Negative seeds are valid.
        let seed = value(setup, self.seed).cast_unsigned();
        let step = Duration::from_millis(step);
        Ok((SimulationOptions { model, joints, world, start, step, variation, engine }, seed))
    }

    pub(super) fn faults<M: Module>(&self, setup: &Setup<'_, M>) -> Result<Vec<Fault>, SetupError> {
        let texts = value(setup, self.faults);
        let faults: Result<_, _> = texts.iter().map(|text| text.parse::<Fault>()).collect();
        faults.map_err(|error| setup.refuse_value(self.faults, error.to_string()))
    }

    /// `None` if it is 0.
    pub(super) fn rate<M: Module>(
        &self,
        setup: &Setup<'_, M>,
        rate: Setting<f64>,
    ) -> Result<Option<f64>, SetupError> {
        match value(setup, rate) {
            0.0 => Ok(None),
            hz if (0.1..=1000.0).contains(&hz) => Ok(Some(hz)),
            _ => Err(setup.refuse_value(rate, "it has to be 0, or 0.1 to 1000")),
        }
    }
}

pub(super) fn value<T: SettingType + Clone + Default, M: Module>(
    setup: &Setup<'_, M>,
    setting: Setting<T>,
) -> T {
    setup.value(setting).cloned().unwrap_or_default()
}
