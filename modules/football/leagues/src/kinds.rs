//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;
use downbeat_network::udp::Udp;

use crate::game_controller::GameController;
use crate::game_controller_sender::GameControllerSender;
use crate::team::TeamCommunication;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
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
