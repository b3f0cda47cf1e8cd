//! The kinds of modules that features of this program add.

use downbeat_darwin_op::emulator::MemoryPorts;

use super::Kind;

/// The names of the kinds that features of this program add.
#[cfg(test)]
pub(crate) fn kinds_of_features() -> Vec<String> {
    of_features(&MemoryPorts::default()).map(|kind| kind.name().to_owned()).collect()
}

pub(super) fn of_features(ports: &MemoryPorts) -> impl Iterator<Item = Kind> {
    let kinds = simulators(ports).into_iter();
    #[cfg(feature = "football")]
    let kinds = kinds.chain(football(ports.clone()));
    #[cfg(feature = "leagues")]
    let kinds = kinds.chain(leagues());
    #[cfg(feature = "network")]
    let kinds = kinds.chain(network());
    #[cfg(feature = "mqtt")]
    let kinds = kinds.chain([mqtt()]);
    #[cfg(feature = "sensors")]
    let kinds = kinds.chain(super::sensors::kinds());
    #[cfg(feature = "state_machine")]
    let kinds = kinds.chain([state_machine()]);
    kinds
}

#[cfg(feature = "state_machine")]
fn state_machine() -> Kind {
    use downbeat_executor::{SettingValue, Synchrony};
    use downbeat_state_machine::StateMachineOptions;
    let options = |source: &super::ModuleSource| {
        let Some(SettingValue::Text(file)) = source.keys.get("file") else {
            return Err("`file` is the chart, such as \"player.scxml\"".to_owned());
        };
        let path = source.file_to_read(&source.folder.join(file));
        Ok(StateMachineOptions { path, is_reloaded: source.is_set("reload", true)? })
    };
    Kind::foreign(
        "state_machine",
        "decisions as a statechart in a file, a subset of SCXML (docs/state_machine.md)",
        [&["file"], &["reload"]],
        move |source| downbeat_state_machine::load(&options(source)?),
        move |source| options(source).map(|options| vec![options.path]).unwrap_or_default(),
    )
    .reloaded()
    .with_panel("Chart", downbeat_state_machine::PANEL, &["~/mermaid", "~/state"])
    .with_synchrony(Synchrony::WhenDue)
}

#[cfg(feature = "mqtt")]
fn mqtt() -> Kind {
    Kind::device_with_interfaces(
        "mqtt",
        "topics of the robot on an MQTT broker, both ways, in JSON or CBOR",
        downbeat_network::mqtt::broker::Broker::default,
        downbeat_network::mqtt::Mqtt::new,
    )
    .with_files(&["password_file"])
}

#[cfg(feature = "football")]
fn football(ports: MemoryPorts) -> [Kind; 7] {
    [
        Kind::new(
            "football_match",
            "a football field with a ball, simulated robots and a referee (docs/football.md)",
            move || downbeat_match::FootballMatch::new(ports.clone()),
        )
        .drives_device()
        .emulated()
        .with_panel(
            "Football",
            downbeat_match::PANEL,
            &["match/state", "match/field", "match/event"],
        ),
        Kind::new(
            "head",
            "turns the head of a football player: searches, looks at the ball, looks ahead",
            downbeat_player::head::Head::default,
        ),
        Kind::new(
            "team",
            "tells the team what a football player knows, and joins what mates say with what it sees",
            downbeat_player::team::Team::default,
        ),
        Kind::new(
            "truth_beliefs",
            "what a simulated player believes without eyes: the truth with noise",
            downbeat_player::truth::TruthBeliefs::default,
        ),
        Kind::new(
            "walk_to",
            "walks to a place on the field, or lines up behind the ball for a kick",
            downbeat_player::walk_to::WalkTo::default,
        ),
        Kind::new(
            "localisation",
            "where a football player and the ball are on the field, from what vision sees and odometry",
            downbeat_localisation::Localisation::default,
        ),
        Kind::new(
            "vision",
            "lines, ball, goal posts and robots in the pictures of a football player's camera",
            downbeat_vision::Vision::default,
        )
        .with_files(&["colours"])
        .detached(),
    ]
}

#[cfg(feature = "leagues")]
fn leagues() -> [Kind; 3] {
    use downbeat_leagues::game_controller::GameController;
    use downbeat_leagues::game_controller_sender::GameControllerSender;
    use downbeat_leagues::team::TeamCommunication;
    use downbeat_network::udp::Udp;
    [
        Kind::device(
            "game_controller",
            "listens to the referee's program of a football league, and answers it",
            Udp::default,
            GameController::new,
        ),
        Kind::device(
            "game_controller_sender",
            "sends what a referee decides as packets of a football league, and collects the answers",
            Udp::default,
            GameControllerSender::new,
        ),
        Kind::device(
            "team_communication",
            "team messages of the humanoid football league",
            Udp::default,
            TeamCommunication::new,
        ),
    ]
}

#[cfg(feature = "network")]
fn network() -> [Kind; 2] {
    use downbeat_network::tcp::Tcp;
    use downbeat_network::tcp_lines::TcpLines;
    use downbeat_network::udp::Udp;
    use downbeat_network::udp_lines::UdpLines;
    [
        Kind::device("tcp_lines", "lines of text on TCP, as topics", Tcp::default, TcpLines::new),
        Kind::device("udp_lines", "lines of text on UDP, as topics", Udp::default, UdpLines::new),
    ]
}

/// Humanoid robots in a simulated world, if that is built in. The Darwin OP has a name of its own; what both
/// names stand for is the same.
#[cfg(feature = "physics")]
fn simulators(ports: &MemoryPorts) -> Vec<Kind> {
    let kinds = [
        (
            "darwin_op_simulator",
            "a Darwin OP in a simulated world: rigid bodies with contacts behind the bytes of its bus",
        ),
        (
            "humanoid_simulator",
            "a humanoid robot in a simulated world, from its URDF and the description of its servos",
        ),
    ];
    let kind = |(name, about)| {
        let ports = ports.clone();
        let make = move || downbeat_physics::simulator::HumanoidSimulator::new(ports.clone());
        Kind::new(name, about, make).drives_device().emulated().with_files(&[
            "urdf",
            "world",
            "humanoid",
            "description",
        ])
    };
    kinds.map(kind).into()
}

#[cfg(not(feature = "physics"))]
fn simulators(_ports: &MemoryPorts) -> Vec<Kind> {
    Vec::new()
}
