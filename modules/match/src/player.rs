//! The core of a football player: a robot that walks, kicks, gets up, turns its head and knows where it is.

use downbeat_executor::{Core, ModuleOptions, SettingValue, SetupError};
use downbeat_modules::darwin_op::DarwinOp;
use downbeat_modules::darwin_op_emulator::MemoryBus;
use downbeat_modules::falls::Falls;
use downbeat_modules::gait::Gait;
use downbeat_modules::imu_filter::ImuFilter;
use downbeat_modules::joint_command_mux::JointCommandMux;
use downbeat_modules::motions::MotionPlayer;
use downbeat_player::head::Head;
use downbeat_player::truth::TruthBeliefs;
use downbeat_player::walk_to::WalkTo;

/// Topics of joint commands, those with precedence first.
const SOURCES: [&str; 4] =
    ["falls/joint_commands", "motions/joint_commands", "gait/joint_commands", "head/joint_commands"];

/// Adds the modules of a player with all skills to a core, without what decides. The seed is that of the noise of what it believes.
///
/// # Errors
/// If a module cannot join.
pub fn with_skills(mut core: Core, bus: MemoryBus, seed: i64) -> Result<Core, SetupError> {
    let with = |setting: &str, value: SettingValue| ModuleOptions {
        settings: [(setting.to_owned(), value)].into(),
        ..ModuleOptions::default()
    };
    let mut hardware = ModuleOptions::default();
    hardware.remaps.insert("joint_commands".to_owned(), "joint_goals".to_owned());
    core.add_with("hardware", DarwinOp::new(Box::new(bus)), hardware)?;
    core.add("imu_filter", ImuFilter::default())?;
    core.add_with("gait", Gait::default(), with("start", true.into()))?;
    core.add("motions", MotionPlayer::default())?;
    core.add("falls", Falls::default())?;
    core.add_with("beliefs", TruthBeliefs::default(), with("seed", seed.into()))?;
    core.add("head", Head::default())?;
    core.add("walk_to", WalkTo::default())?;
    let sources = SOURCES.map(str::to_owned).to_vec();
    core.add_with("mux", JointCommandMux::default(), with("sources", sources.into()))?;
    Ok(core)
}
