//! Transforms of the Darwin OP, as a module receives them, compared with MuJoCo.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
use downbeat_kinematics::robot_state_publisher::RobotStatePublisher;
use downbeat_kinematics::{Robot, Root, to_mjcf};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_transforms::{At, TransformBuffer, listen};
use fuzzing::Random;
use python_peer::Python;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};

const DARWIN_OP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/darwin_op.urdf");

/// Collects transforms.
struct Listener(Arc<Mutex<TransformBuffer>>, TransformBuffer);

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        listen(setup, |listener| &mut listener.1)?;
        setup.each_run(|listener, _| *listener.0.lock().unwrap() = listener.1.clone());
        Ok(())
    }
}

#[test]
fn transforms_of_all_links_agree_with_mujoco() {
    let (robot, mut random) = (Robot::read(DARWIN_OP).unwrap(), Random::new(6));
    let unit = |random: &mut Random| (random.bits() >> 11) as f64 / (1_u64 << 53) as f64;
    let names: Vec<String> = robot.coordinates().iter().map(|&id| robot.joint(id).name.clone()).collect();
    let poses: Vec<Vec<f64>> =
        (0..5).map(|_| names.iter().map(|_| 2.0 * unit(&mut random) - 1.0).collect()).collect();

    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock);
    let settings = [("robot_description".to_owned(), DARWIN_OP.to_owned().into())];
    let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
    core.add_with("robot_state_publisher", RobotStatePublisher::default(), options).unwrap();
    let heard = Arc::<Mutex<TransformBuffer>>::default();
    core.add("listener", Listener(Arc::clone(&heard), TransformBuffer::new())).unwrap();
    let inlet = core.inlet("joint_states").unwrap();
    for (second, positions) in (1..).zip(&poses) {
        let mut state =
            JointState { name: names.clone(), position: positions.clone(), ..JointState::default() };
        state.header.stamp = Stamp { sec: second, nanosec: 0 };
        inlet.publish(state).unwrap();
        (0..4).try_for_each(|_| core.cycle()).unwrap();
    }

    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/mujoco_peer.py");
    let asked = json!({"model": to_mjcf(&robot, Root::Fixed).unwrap(), "joints": names, "poses": poses});
    let heard = heard.lock().unwrap();
    let Some(python) = Python::find() else { return };
    let theirs: Value = serde_json::from_str(&python.ask(script, "pose", &asked.to_string())).unwrap();
    for (second, theirs) in (1..).zip(theirs["poses"].as_array().unwrap()) {
        for link in robot.links() {
            let time = At::from(Time::from_nanos(second * 1_000_000_000));
            let found = heard.lookup("base_link", &link.name, time).unwrap().target_from_source;
            let ours: Vec<f64> =
                found.translation.to_array().into_iter().chain(found.rotation.to_array()).collect();
            let theirs: Vec<f64> = theirs["frames"][&link.name]
                .as_array()
                .unwrap()
                .iter()
                .map(|part| part.as_f64().unwrap())
                .collect();
            // Both signs of a quaternion are the same rotation.
            let sign = (3..7).map(|part| ours[part] * theirs[part]).sum::<f64>().signum();
            for part in 0..7 {
                let sign = if part < 3 { 1.0 } else { sign };
                assert!((ours[part] - sign * theirs[part]).abs() < 1e-9, "{} at {second} s", link.name);
            }
        }
    }
}
