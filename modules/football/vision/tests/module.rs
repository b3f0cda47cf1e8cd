//! The module in a core: pictures that show nothing are reported with the remedy, and it sees again after
//! them.
#![allow(clippy::unwrap_used, missing_docs)]

#[allow(dead_code)]
mod evaluation;

use downbeat_executor::{
    Clock as _, Core, Inbox, Inlet, ManualClock, ModuleOptions, Received, SettingValue, Time,
};
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_football::soccer_vision_3d_msgs::msg::{MarkingArray, RobotArray};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, TransformStamped};
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_physics::camera::{Camera as Rendered, Scene};
use downbeat_physics::{Block, Field, WorldFile};
use downbeat_transforms::Isometry;
use downbeat_vision::{View, Vision};
use glam::{DQuat, DVec3};
use std::sync::{Arc, Mutex};
use std::time::Duration;

struct Eyes {
    core: Core,
    clock: ManualClock,
    view: View,
    tf: Inlet<TFMessage>,
    infos: Inlet<CameraInfo>,
    images: Inlet<Image>,
    games: Inlet<GameState>,
    heard: Arc<Mutex<Heard>>,
    /// The teams of robots in the last picture.
    teams: Option<Vec<u8>>,
}

#[derive(Default)]
struct Heard {
    diagnostics: Vec<String>,
    markings: usize,
    /// The teams of robots in each picture.
    teams: Vec<Vec<u8>>,
}

impl Eyes {
    fn new() -> Self {
        Self::with([])
    }

    fn with<const N: usize>(settings: [(&str, SettingValue); N]) -> Self {
        let settings = settings.map(|(name, value)| (name.to_owned(), value)).into();
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
        let mut core = Core::new().with_clock(clock.clone());
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("vision", Vision::default(), options).unwrap();
        let heard = Arc::<Mutex<Heard>>::default();
        let sink = Arc::clone(&heard);
        let hear = move |told: Received<'_, DiagnosticArray>| {
            sink.lock().unwrap().diagnostics.push(told.status[0].message.clone());
        };
        core.outlet("diagnostics", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let count = move |_: Received<'_, MarkingArray>| sink.lock().unwrap().markings += 1;
        core.outlet("vision/markings", Inbox::KeepAll, count).unwrap().keep();
        let sink = Arc::clone(&heard);
        let see = move |robots: Received<'_, RobotArray>| {
            let teams = robots.robots.iter().map(|robot| robot.attributes.team).collect();
            sink.lock().unwrap().teams.push(teams);
        };
        core.outlet("vision/robots", Inbox::KeepAll, see).unwrap().keep();
        Self {
            games: core.inlet("game_state").unwrap(),
            tf: core.inlet("tf").unwrap(),
            infos: core.inlet("camera/camera_info").unwrap(),
            images: core.inlet("camera/image_raw").unwrap(),
            view: evaluation::view_at(0.45, 0.3, 0.0),
            core,
            clock,
            heard,
            teams: None,
        }
    }

    /// What the camera shows on an empty field.
    fn field(&self) -> Image {
        self.image(Vec::new())
    }

    /// What it shows of a blue and a red block as large as robots.
    fn two_teams(&self) -> Image {
        let block = |name: &str, y, colour| Block {
            name: name.to_owned(),
            position: [1.2, y, 0.225],
            size: [0.12, 0.25, 0.45],
            yaw: 0.0,
            mass: None,
            colour,
        };
        self.image(vec![block("left", 0.3, [30, 60, 200]), block("right", -0.3, [190, 30, 40])])
    }

    fn image(&self, boxes: Vec<Block>) -> Image {
        let file = WorldFile { field: Some(Field::default()), boxes, ..WorldFile::default() };
        let data = Scene::new(&file, |_| None).render(&Rendered::darwin_op(), &self.view.ground_from_camera);
        let [width, height] = self.view.camera.size;
        let encoding = "rgb8".to_owned();
        Image { width, height, step: 3 * width, encoding, data, ..Image::default() }
    }

    /// The state after a picture, if it changed, and whether the picture was looked at.
    fn show(&mut self, image: Image) -> (Option<String>, bool) {
        self.clock.advance(Duration::from_millis(100));
        let stamp = builtin_interfaces::msg::Time::from_nanos(self.clock.now().as_nanos());
        let header = |frame: &str| Header { stamp, frame_id: frame.to_owned() };
        let base = Isometry { translation: DVec3::Z * 0.3, rotation: DQuat::IDENTITY };
        let frames = [("base_link", base), ("camera", self.view.ground_from_camera)];
        let transforms = frames.map(|(child, pose)| transform(header("odom"), child, &pose)).to_vec();
        self.tf.publish(TFMessage { transforms }).unwrap();
        let camera = self.view.camera;
        let [width, height] = camera.size;
        let k = [camera.focal.x, 0.0, camera.centre.x, 0.0, camera.focal.y, camera.centre.y, 0.0, 0.0, 1.0];
        let info = CameraInfo { header: header("camera"), width, height, k, ..CameraInfo::default() };
        self.infos.publish(info).unwrap();
        self.images.publish(Image { header: header("camera"), ..image }).unwrap();
        for _ in 0..6 {
            self.core.cycle().unwrap();
            self.clock.advance(Duration::from_millis(10));
        }
        let mut heard = std::mem::take(&mut *self.heard.lock().unwrap());
        self.teams = heard.teams.pop();
        (heard.diagnostics.pop(), heard.markings > 0)
    }
}

fn transform(header: Header, child: &str, pose: &Isometry) -> TransformStamped {
    let mut message = TransformStamped { header, child_frame_id: child.to_owned(), ..Default::default() };
    let [x, y, z] = pose.translation.to_array();
    (message.transform.translation.x, message.transform.translation.y) = (x, y);
    message.transform.translation.z = z;
    let [x, y, z, w] = pose.rotation.to_array();
    message.transform.rotation = Quaternion { x, y, z, w };
    message
}

#[test]
fn pictures_that_show_nothing_are_reported_with_the_remedy_and_it_sees_again() {
    let mut eyes = Eyes::new();
    let good = eyes.field();
    let filled = |with: u8| Image { data: vec![with; good.data.len()], ..good.clone() };
    let [width, height] = eyes.view.camera.size;
    let twice = Image {
        width: 2 * width,
        height: 2 * height,
        step: 6 * width,
        data: good.data.repeat(4),
        ..good.clone()
    };
    let huge = Image { width: u32::MAX, height: u32::MAX, step: u32::MAX, ..good.clone() };
    let cases = [
        (filled(0), "lens cap"),
        (filled(255), "lower exposure"),
        (Image { encoding: "16UC1".to_owned(), ..good.clone() }, "16UC1"),
        (twice, "640"),
        (Image { data: good.data[..1000].to_vec(), ..good.clone() }, "bytes"),
        (huge, "4096 x 4096 are possible"),
    ];
    for (bad, remedy) in cases {
        assert_eq!(eyes.show(good.clone()), (Some("sees".to_owned()), true), "before {remedy:?}");
        assert_eq!(eyes.show(good.clone()), (None, true), "nothing changed");
        let told = eyes.show(bad).0.unwrap();
        println!("{told}");
        assert!(told.contains(remedy), "{told}");
    }
    assert!(eyes.show(good).1);
}

#[test]
fn robots_are_mates_or_opponents_by_what_the_referee_says_the_team_wears() {
    let (unknown, own, opponent) =
        (Attributes::TEAM_UNKNOWN, Attributes::TEAM_OWN, Attributes::TEAM_OPPONENT);
    let mut eyes = Eyes::new();
    let image = eyes.two_teams();
    eyes.show(image.clone());
    assert_eq!(eyes.teams, Some(vec![unknown, unknown]), "nobody said which colour is its own");
    for (own_colour, expected) in
        [(GameState::COLOUR_BLUE, vec![own, opponent]), (GameState::COLOUR_RED, vec![opponent, own])]
    {
        eyes.games.publish(GameState { own_colour, ..GameState::default() }).unwrap();
        eyes.show(image.clone());
        assert_eq!(eyes.teams, Some(expected));
    }
    let mut eyes = Eyes::with([("own_colour", "red".to_owned().into())]);
    eyes.games.publish(GameState { own_colour: GameState::COLOUR_BLUE, ..GameState::default() }).unwrap();
    eyes.show(image);
    assert_eq!(eyes.teams, Some(vec![opponent, own]), "the setting is worth more");
}
