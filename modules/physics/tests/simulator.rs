//! The simulator as a module, and what it offers to tools.
#![allow(clippy::unwrap_used)]

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_executor::{Clock, Core, Inbox, ManualClock, ModuleOptions, Received, SettingValue, Time};
use downbeat_msgs::geometry_msgs::msg::{Point, PoseStamped, Vector3Stamped};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::simulation_interfaces::action::{
    SimulateStepsSendGoalRequest, SimulateStepsSendGoalResponse,
};
use downbeat_msgs::simulation_interfaces::msg::{
    EntityCategory, Result as Outcome, SimulationState, SimulatorFeatures,
};
use downbeat_msgs::simulation_interfaces::srv::{
    DeleteEntityRequest, DeleteEntityResponse, GetEntitiesRequest, GetEntitiesResponse,
    GetEntityStateRequest, GetEntityStateResponse, GetSimulatorFeaturesRequest, GetSimulatorFeaturesResponse,
    GetSpawnablesRequest, GetSpawnablesResponse, ResetSimulationRequest, ResetSimulationResponse,
    SetEntityStateRequest, SetEntityStateResponse, SetSimulationStateRequest, SetSimulationStateResponse,
    SpawnEntityRequest, SpawnEntityResponse, StepSimulationRequest, StepSimulationResponse,
};
use downbeat_physics::simulator::HumanoidSimulator;
use downbeat_physics::version_2::simulation_interfaces as version_2;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

/// Simulator and hardware module in a core with a manual clock.
struct Robot {
    core: Core,
    clock: ManualClock,
    odometry: Receiver<Odometry>,
    ball: Receiver<PoseStamped>,
    _folder: tempfile::TempDir,
}

impl Robot {
    fn new(world: &str) -> Self {
        Self::with(world, &[])
    }

    fn with(world: &str, settings: &[(&str, SettingValue)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("world.toml");
        std::fs::write(&path, world).unwrap();
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
        let mut core = Core::new().with_clock(clock.clone());
        let ports = MemoryPorts::default();
        let options = |settings: &[(&str, SettingValue)]| ModuleOptions {
            settings: settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect(),
            ..ModuleOptions::default()
        };
        let port = SettingValue::from("memory:robot".to_owned());
        let path = SettingValue::from(path.to_str().unwrap().to_owned());
        let all = [&[("link", port.clone()), ("world", path)], settings].concat();
        core.add_with("simulator", HumanoidSimulator::new(ports.clone()), options(&all)).unwrap();
        core.add_with("hardware", DarwinOp::new(Box::new(ports.bus())), options(&[("port", port)])).unwrap();
        let odometry = received(&mut core, "ground_truth/odom");
        let ball = received(&mut core, "ground_truth/ball");
        Self { core, clock, odometry, ball, _folder: folder }
    }

    fn run_for(&mut self, time: Duration) {
        let end = self.clock.now() + time;
        while let Some(next) = self.core.next_event().filter(|next| *next < end) {
            self.clock.set(next);
            self.core.cycle().unwrap();
        }
        self.clock.set(end);
    }

    /// Calls a service and runs until it is answered.
    fn call<Q: Send + 'static, R: Send + 'static>(&mut self, service: &str, request: Q) -> R {
        let caller = self.core.caller::<Q, R>(service).unwrap();
        let (sender, answer) = channel();
        caller.call(request, Duration::MAX, move |result| drop(sender.send(result.unwrap()))).unwrap();
        for _ in 0..100_000 {
            if let Ok(answer) = answer.try_recv() {
                return answer;
            }
            self.run_for(MS);
        }
        panic!("{service} was not answered");
    }

    fn set_state(&mut self, state: u8) -> u8 {
        let request = SetSimulationStateRequest { state: SimulationState { state } };
        self.call::<_, SetSimulationStateResponse>("simulator/set_simulation_state", request).result.result
    }

    fn spawn(&mut self, name: &str, resource: &str, position: [f64; 3]) -> SpawnEntityResponse {
        let mut request = SpawnEntityRequest { name: name.into(), ..Default::default() };
        let is_description = resource.contains('=');
        *(if is_description { &mut request.resource_string } else { &mut request.uri }) = resource.into();
        let [x, y, z] = position;
        request.initial_pose.pose.position = Point { x, y, z };
        self.call("simulator/spawn_entity", request)
    }

    fn delete(&mut self, name: &str) -> u8 {
        let request = DeleteEntityRequest { entity: name.into() };
        self.call::<_, DeleteEntityResponse>("simulator/delete_entity", request).result.result
    }

    fn entities(&mut self) -> Vec<String> {
        self.run_for(20 * MS);
        self.call::<_, GetEntitiesResponse>("simulator/get_entities", GetEntitiesRequest::default()).entities
    }

    fn ball(&mut self) -> GetEntityStateResponse {
        self.call("simulator/get_entity_state", GetEntityStateRequest { entity: "ball".into() })
    }
}

fn received<T: Clone + Send + Sync + 'static>(core: &mut Core, topic: &str) -> Receiver<T> {
    let (sender, receiver) = channel();
    let send = move |message: Received<'_, T>| drop(sender.send(message.clone()));
    core.outlet(topic, Inbox::KeepAll, send).unwrap().keep();
    receiver
}

#[test]
fn ground_truth_is_published() {
    let mut robot = Robot::new("[ball]\nposition = [0.3, 0.1]");
    robot.run_for(1010 * MS);
    let odometry: Vec<_> = robot.odometry.try_iter().collect();
    assert_eq!(odometry.len(), 50);
    let last = &odometry[49];
    assert_eq!((last.header.frame_id.as_str(), last.child_frame_id.as_str()), ("world", "base_link"));
    assert!((0.15..0.25).contains(&last.pose.pose.position.z), "{last:?}");
    let ball = robot.ball.try_iter().last().unwrap().pose.position;
    assert!((ball.x - 0.3).abs() < 1e-3 && (ball.y - 0.1).abs() < 1e-3, "{ball:?}");
}

#[test]
fn a_push_throws_the_robot_over() {
    let mut robot = Robot::new("");
    robot.run_for(1000 * MS);
    let mut push = Vector3Stamped::default();
    push.header.frame_id = "torso".into();
    push.vector.y = 2.0;
    robot.core.inlet("push").unwrap().publish(push).unwrap();
    robot.run_for(1500 * MS);
    assert!(robot.odometry.try_iter().last().unwrap().pose.pose.position.z < 0.12);
}

#[test]
fn a_push_with_an_old_or_a_future_stamp_is_dropped() {
    let mut robot = Robot::new("");
    robot.run_for(1000 * MS);
    let mut push = Vector3Stamped::default();
    push.header.frame_id = "torso".into();
    push.vector.y = 2.0;
    let height = |robot: &Robot| robot.odometry.try_iter().last().unwrap().pose.pose.position.z;
    let inlet = robot.core.inlet("push").unwrap();
    for seconds in [-10, 10] {
        push.header.stamp = robot.odometry.try_iter().last().unwrap().header.stamp;
        push.header.stamp.sec += seconds;
        inlet.publish(push.clone()).unwrap();
        robot.run_for(1500 * MS);
        assert!(height(&robot) > 0.12, "{seconds}");
        robot.run_for(100 * MS);
    }
    push.header.stamp = robot.odometry.try_iter().last().unwrap().header.stamp;
    inlet.publish(push).unwrap();
    robot.run_for(1500 * MS);
    assert!(height(&robot) < 0.12);
}

#[test]
fn pictures_come_with_their_camera() {
    let mut robot = Robot::with("[field]\n[ball]\nposition = [0.4, 0.0]", &[("camera_hz", 5.0.into())]);
    let images: Receiver<Image> = received(&mut robot.core, "camera/image_raw");
    let infos: Receiver<CameraInfo> = received(&mut robot.core, "camera/camera_info");
    robot.run_for(1010 * MS);
    let (images, infos): (Vec<_>, Vec<_>) = (images.try_iter().collect(), infos.try_iter().collect());
    assert_eq!((images.len(), infos.len()), (5, 5));
    let image = &images[4];
    assert_eq!((image.width, image.height, image.step, image.encoding.as_str()), (320, 240, 960, "rgb8"));
    assert_eq!(image.header, infos[4].header);
    assert_eq!(image.header.frame_id, "camera_optical_frame");
    let orange = image.data.chunks(3).filter(|pixel| pixel[0] > 140 && pixel[1] < 110 && pixel[2] < 60);
    assert!(orange.count() > 200, "the ball is in front of the robot");
}

#[test]
fn a_robot_that_its_files_do_not_fit_is_refused_with_the_setting() {
    let refused = |settings: &[(&str, SettingValue)]| {
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        let simulator = HumanoidSimulator::new(MemoryPorts::default());
        Core::new().add_with("simulator", simulator, options).err().unwrap().to_string()
    };
    let text = |text: &str| SettingValue::from(text.to_owned());
    let servos = "name = 'arm'\n[[bus]]\nname = 'arm'\nport = 'p'\nbaud = 1_000_000\nprotocol = 'feetech_sts'\n\
                  cycle_ms = 10\n[[joint]]\nname = 'wrist'\nid = 3\nmodel = 'STS3215'\nlimits = [-1.7, 1.7]";
    let error = refused(&[("description", text(servos))]);
    assert!(error.contains("the robot \"darwin_op\" has no joint \"wrist\", which a servo turns"), "{error}");
    let error = refused(&[("description", text("/no/such.toml"))]);
    assert!(error.contains("\"description\"") && error.contains("/no/such.toml"), "{error}");
    let error = refused(&[("humanoid", text("/no/such.toml"))]);
    assert!(error.contains("\"humanoid\"") && error.contains("/no/such.toml"), "{error}");
    let picture = [("camera_hz", 5.0.into()), ("camera_size", vec![320_i64].into())];
    assert!(refused(&picture).contains("two numbers from 1 to 4096 are needed"), "{}", refused(&picture));
}

#[test]
fn features_are_those_that_are_offered() {
    let mut robot = Robot::new("");
    let answer: GetSimulatorFeaturesResponse =
        robot.call("simulator/get_simulator_features", GetSimulatorFeaturesRequest::default());
    let has = |feature: u8| answer.features.features.contains(&u16::from(feature));
    assert!(has(SimulatorFeatures::SPAWNING) && has(SimulatorFeatures::DELETING));
}

#[test]
fn a_paused_world_moves_by_steps_only() {
    let mut robot = Robot::new("[ball]");
    robot.run_for(1000 * MS);
    let mut state = robot.ball().state;
    state.twist.linear.x = 1.0;
    let request = SetEntityStateRequest { entity: "ball".into(), state };
    let set: SetEntityStateResponse = robot.call("simulator/set_entity_state", request);
    assert_eq!(set.result.result, Outcome::RESULT_OK, "{}", set.result.error_message);
    let refused: StepSimulationResponse =
        robot.call("simulator/step_simulation", StepSimulationRequest { steps: 1 });
    assert_eq!(refused.result.result, Outcome::RESULT_OPERATION_FAILED);
    assert_eq!(robot.set_state(SimulationState::STATE_PAUSED), Outcome::RESULT_OK);
    assert_eq!(
        robot.set_state(SimulationState::STATE_PAUSED),
        SetSimulationStateResponse::ALREADY_IN_TARGET_STATE
    );
    robot.run_for(20 * MS);
    let x = |robot: &mut Robot| robot.ball().state.pose.position.x;
    let paused = x(&mut robot);
    robot.run_for(500 * MS);
    assert_eq!(x(&mut robot), paused);
    let done: StepSimulationResponse =
        robot.call("simulator/step_simulation", StepSimulationRequest { steps: 25 });
    assert_eq!(done.result.result, Outcome::RESULT_OK);
    let moved = x(&mut robot) - paused;
    assert!((0.05..0.11).contains(&moved), "25 steps of 4 ms at about 1 m/s: {moved}");
    let goal = SimulateStepsSendGoalRequest { goal: Default::default(), ..Default::default() };
    let accepted: SimulateStepsSendGoalResponse =
        robot.call("simulator/simulate_steps/_action/send_goal", goal);
    assert!(accepted.accepted);
    assert_eq!(robot.set_state(SimulationState::STATE_PLAYING), Outcome::RESULT_OK);
    robot.run_for(100 * MS);
    assert!(x(&mut robot) > paused + moved);
}

#[test]
fn a_reset_puts_everything_back() {
    let mut robot = Robot::new("[ball]");
    robot.run_for(1000 * MS);
    let start = robot.ball().state.pose.position;
    let mut state = robot.ball().state;
    state.pose.position.x = 2.0;
    let request = SetEntityStateRequest { entity: "ball".into(), state };
    let _: SetEntityStateResponse = robot.call("simulator/set_entity_state", request);
    robot.run_for(20 * MS);
    assert!((robot.ball().state.pose.position.x - 2.0).abs() < 0.01);
    let reset: ResetSimulationResponse =
        robot.call("simulator/reset_simulation", ResetSimulationRequest::default());
    assert_eq!(reset.result.result, Outcome::RESULT_OK);
    robot.run_for(20 * MS);
    assert!((robot.ball().state.pose.position.x - start.x).abs() < 0.01);
    robot.run_for(2000 * MS);
    assert!(robot.odometry.try_iter().last().unwrap().pose.pose.position.z > 0.15, "it stands again");
}

#[test]
fn entities_are_found_by_name_and_category() {
    let mut robot = Robot::new("[field]\n[ball]\n[[wall]]\nfrom = [2, -1]\nto = [2, 1]");
    let mut find = |filter: &str, category: Option<u8>| {
        let mut request = GetEntitiesRequest::default();
        request.filters.filter = filter.into();
        request.filters.categories =
            category.map(|category| EntityCategory { category }).into_iter().collect();
        robot.call::<_, GetEntitiesResponse>("simulator/get_entities", request)
    };
    assert_eq!(find("", Some(EntityCategory::CATEGORY_ROBOT)).entities, ["darwin_op"]);
    assert_eq!(find("", Some(EntityCategory::CATEGORY_DYNAMIC_OBJECT)).entities, ["ball"]);
    assert_eq!(find("^goal_post", None).entities.len(), 4);
    assert_eq!(find("wall_.", None).entities, ["wall_1"]);
    assert_eq!(find("(", None).result.result, Outcome::RESULT_OPERATION_FAILED);
    let missing: GetEntityStateResponse =
        robot.call("simulator/get_entity_state", GetEntityStateRequest { entity: "bal".into() });
    assert_eq!(missing.result.result, Outcome::RESULT_NOT_FOUND);
    let fixed = SetEntityStateRequest { entity: "wall_1".into(), ..Default::default() };
    let refused: SetEntityStateResponse = robot.call("simulator/set_entity_state", fixed);
    assert!(refused.result.error_message.contains("fixed"), "{}", refused.result.error_message);
}

#[test]
fn spawned_things_fall_roll_and_stand_until_they_are_deleted() {
    let mut robot = Robot::new("");
    robot.run_for(1000 * MS);
    let known: GetSpawnablesResponse =
        robot.call("simulator/get_spawnables", GetSpawnablesRequest::default());
    for (index, spawnable) in known.spawnables.iter().enumerate() {
        let uri = &spawnable.uri;
        let answer = robot.spawn(&format!("my_{uri}"), uri, [1.0, index as f64, 0.6]);
        assert_eq!(answer.result.result, Outcome::RESULT_OK, "{}", answer.result.error_message);
    }
    let table = "kind = \"box\"\nsize = [0.2, 0.2, 0.1]\nmass = 0.0";
    assert_eq!(robot.spawn("table", table, [0.5, 0.0, 0.2]).entity_name, "table");
    assert_eq!(robot.entities(), ["darwin_op", "my_ball", "my_box", "my_post", "table"]);
    robot.run_for(1500 * MS);
    let mut height = |entity: &str| {
        let request = GetEntityStateRequest { entity: entity.into() };
        robot.call::<_, GetEntityStateResponse>("simulator/get_entity_state", request).state.pose.position.z
    };
    let heights = ["my_ball", "my_box", "my_post", "table"].map(&mut height);
    for (height, expected) in heights.into_iter().zip([0.05, 0.05, 0.6, 0.2]) {
        assert!((height - expected).abs() < 0.005, "{heights:?}");
    }
    assert_eq!(robot.delete("my_box"), Outcome::RESULT_OK);
    assert_eq!(robot.entities(), ["darwin_op", "my_ball", "my_post", "table"]);
    assert_eq!(robot.delete("my_box"), Outcome::RESULT_NOT_FOUND);
    assert_eq!(robot.delete("darwin_op"), Outcome::RESULT_OPERATION_FAILED);
    let reset = ResetSimulationRequest { scope: ResetSimulationRequest::SCOPE_SPAWNED };
    let reset: ResetSimulationResponse = robot.call("simulator/reset_simulation", reset);
    assert_eq!(reset.result.result, Outcome::RESULT_OK);
    assert_eq!(robot.entities(), ["darwin_op"]);
}

#[test]
fn what_cannot_be_spawned_is_refused_with_the_reason() {
    let mut robot = Robot::new("[field]\n[ball]");
    robot.run_for(1000 * MS);
    let free = [2.0, 1.0, 0.5];
    for (name, resource, position, result, message) in [
        ("one", "", free, SpawnEntityResponse::NO_RESOURCE, "neither uri nor resource_string"),
        ("one", "cone", free, SpawnEntityResponse::NO_RESOURCE, "one of ball, box, post"),
        ("one", "kind = \"cone\"", free, SpawnEntityResponse::RESOURCE_PARSE_ERROR, "unknown variant `cone`"),
        ("one", "kind = \"ball\"\nmass = -1", free, SpawnEntityResponse::RESOURCE_PARSE_ERROR, "mass is -1"),
        ("ball", "ball", free, SpawnEntityResponse::NAME_NOT_UNIQUE, "choose another name"),
        ("", "ball", free, SpawnEntityResponse::NAME_INVALID, "allow renaming"),
        ("one", "ball", [0.0; 3], SpawnEntityResponse::INVALID_POSE, "be thrown out"),
        ("one", "ball", [f64::NAN; 3], SpawnEntityResponse::INVALID_POSE, "beyond 1000 m"),
    ] {
        let answer = robot.spawn(name, resource, position).result;
        assert_eq!(answer.result, result, "{resource}: {}", answer.error_message);
        assert!(answer.error_message.contains(message), "{}", answer.error_message);
    }
    let mut request = SpawnEntityRequest { name: "ball".into(), allow_renaming: true, ..Default::default() };
    request.uri = "ball".into();
    request.initial_pose.pose.position.z = 2.0;
    let renamed: SpawnEntityResponse = robot.call("simulator/spawn_entity", request);
    assert_eq!(renamed.entity_name, "ball_1");
    assert_eq!(robot.delete("goal_post_1"), Outcome::RESULT_OPERATION_FAILED);
}

#[test]
fn the_services_of_version_2_are_served_on_request() {
    let mut robot = Robot::with("[ball]", &[("interfaces", "2.1".to_owned().into())]);
    robot.run_for(1000 * MS);
    let known: version_2::srv::GetSpawnablesResponse =
        robot.call("simulator/get_spawnables", version_2::srv::GetSpawnablesRequest::default());
    let uris = known.spawnables.iter().map(|spawnable| &*spawnable.entity_resource.uri);
    assert_eq!(uris.collect::<Vec<_>>(), ["ball", "box", "post"]);
    let mut request = version_2::srv::SpawnEntityRequest { name: "parcel".into(), ..Default::default() };
    request.entity_resource.uri = "box".into();
    request.initial_pose.pose.position.x = 2.0;
    request.initial_pose.pose.position.z = 0.5;
    let spawned: version_2::srv::SpawnEntityResponse = robot.call("simulator/spawn_entity", request);
    assert_eq!((spawned.result.result, &*spawned.entity_name), (Outcome::RESULT_OK, "parcel"));

    // Only what the flags name is set.
    let start = robot.ball().state;
    let mut request = version_2::srv::SetEntityStateRequest {
        entity: "ball".into(),
        set_twist: true,
        ..Default::default()
    };
    request.state.pose.position.x = 2.0;
    request.state.twist.linear.x = 1.0;
    let set: version_2::srv::SetEntityStateResponse =
        robot.call("simulator/set_entity_state", request.clone());
    assert_eq!(set.result.result, Outcome::RESULT_OK, "{}", set.result.error_message);
    robot.run_for(100 * MS);
    let moved = robot.ball().state.pose.position.x - start.pose.position.x;
    assert!((0.05..0.15).contains(&moved), "{moved}");
    request.set_pose = true;
    request.state.pose.orientation.w = 2.0;
    let refused: version_2::srv::SetEntityStateResponse = robot.call("simulator/set_entity_state", request);
    assert_eq!(refused.result.result, version_2::srv::SetEntityStateResponse::INVALID_POSE);
}

#[test]
fn a_deleted_thing_of_the_world_returns_with_a_reset() {
    let mut robot = Robot::new("[ball]");
    robot.run_for(1000 * MS);
    assert_eq!(robot.delete("ball"), Outcome::RESULT_OK);
    assert_eq!(robot.entities(), ["darwin_op"]);
    let _: ResetSimulationResponse =
        robot.call("simulator/reset_simulation", ResetSimulationRequest::default());
    assert_eq!(robot.entities(), ["darwin_op", "ball"]);
}
