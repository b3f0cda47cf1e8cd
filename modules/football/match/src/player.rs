//! The modules of a football player: a robot that walks, kicks, gets up, turns its head and localises itself.

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_darwin_op::motions::MotionPlayer;
use downbeat_executor::{Core, Module, ModuleOptions, SettingValue, SetupError};
use downbeat_imu_filter::ImuFilter;
use downbeat_player::head::Head;
use downbeat_player::team::Team;
use downbeat_player::truth::TruthBeliefs;
use downbeat_player::walk_to::WalkTo;
use downbeat_servos::joint_command_mux::JointCommandMux;

/// The topics of joint commands, in the order of precedence.
const SOURCES: [&str; 4] =
    ["falls/joint_commands", "motions/joint_commands", "gait/joint_commands", "head/joint_commands"];

/// The height of `base_link` of a simulated Darwin OP, in m: the setting of `head` in the robot files.
const HEIGHT: f64 = 0.29;

/// How long a servo that has switched itself off rests, in s: the setting of `hardware` in the robot files.
const SHUTDOWN_REST_S: f64 = 2.0;

/// How far the gait may be behind its commands, in m and rad: the settings of `gait` in the robot files.
const LEASHES: [f64; 2] = [0.04, 0.12];

/// The field of the matches: the setting of `walk_to` in the robot files.
const FIELD: &str = "kid_size_2013";

/// Adds the modules of a player with all skills, without the decision-making, as in
/// `robots/football/player.toml`: in the namespace of its name, at the port `memory:NAME`. The seed is that
/// of the noise of its beliefs.
///
/// # Errors
/// If a module cannot join.
pub fn add_skills(core: &mut Core, ports: &MemoryPorts, name: &str, seed: i64) -> Result<(), SetupError> {
    add_modules(core, ports, name, (HEIGHT, false))?;
    Player { core, name }.add("beliefs", TruthBeliefs::default(), [("seed", seed.into())])
}

/// As [`add_skills`], without `pose`, `ball` and `robots`, for a player with vision.
///
/// # Errors
/// If a module cannot join.
pub fn add_body(
    core: &mut Core,
    ports: &MemoryPorts,
    name: &str,
    head_height: f64,
) -> Result<(), SetupError> {
    add_modules(core, ports, name, (head_height, true))
}

fn add_modules(
    core: &mut Core,
    ports: &MemoryPorts,
    name: &str,
    (head_height, glances): (f64, bool),
) -> Result<(), SetupError> {
    let mut player = Player { core, name };
    let port = ("port", format!("memory:{name}").into());
    let mut hardware = player.options([port, ("shutdown_rest_s", SHUTDOWN_REST_S.into())]);
    hardware.remaps.insert("joint_commands".to_owned(), "joint_goals".to_owned());
    player.add_with("hardware", DarwinOp::new(Box::new(ports.bus())), hardware)?;
    player.add("imu_filter", ImuFilter::default(), [])?;
    let [path_leash, heading_leash] = LEASHES.map(SettingValue::from);
    let settings = [("start", true.into()), ("path_leash", path_leash), ("heading_leash", heading_leash)];
    player.add("gait", Gait::default(), settings)?;
    player.add("motions", MotionPlayer::default(), [])?;
    player.add("falls", Falls::default(), [])?;
    player.add("team", Team::default(), [])?;
    // Both follow the ball of the team.
    let joint = |topic: &str| (topic.to_owned(), format!("team/{topic}"));
    let head = player.options([("height", head_height.into()), ("glances", glances.into())]);
    player.add_with("head", Head::default(), ModuleOptions { remaps: [joint("ball")].into(), ..head })?;
    let remaps = [joint("ball"), joint("robots")].into();
    let walk_to = ModuleOptions { remaps, ..player.options([("field", FIELD.to_owned().into())]) };
    player.add_with("walk_to", WalkTo::default(), walk_to)?;
    let sources = SOURCES.map(str::to_owned).to_vec();
    player.add("mux", JointCommandMux::default(), [("sources", sources.into())])
}

struct Player<'a> {
    core: &'a mut Core,
    name: &'a str,
}

impl Player<'_> {
    fn options<const N: usize>(&self, settings: [(&str, SettingValue); N]) -> ModuleOptions {
        ModuleOptions {
            namespace: self.name.to_owned(),
            settings: settings.map(|(name, value)| (name.to_owned(), value)).into(),
            ..ModuleOptions::default()
        }
    }

    fn add<const N: usize>(
        &mut self,
        name: &str,
        module: impl Module,
        settings: [(&str, SettingValue); N],
    ) -> Result<(), SetupError> {
        self.add_with(name, module, self.options(settings))
    }

    fn add_with(
        &mut self,
        name: &str,
        module: impl Module,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        self.core.add_with(&format!("{}/{name}", self.name), module, options)
    }
}
