//! The modules on sockets of this machine, and on recordings of them.
#![allow(clippy::unwrap_used)]

#[path = "../../../network/tests/common/mod.rs"]
mod common;

use std::net::UdpSocket;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Bench, free_port, options};
use downbeat_device::DeviceLink;
use downbeat_executor::{ModuleOptions, SettingValue};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage};
use downbeat_leagues::game_controller::GameController;
use downbeat_leagues::game_controller_sender::GameControllerSender;
use downbeat_leagues::packets::{Answer, ControlPacket, State, Version};
use downbeat_leagues::team::{self, TeamCommunication};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_network::udp::Udp;

#[test]
fn the_game_controller_is_heard_and_answered_and_a_recording_repeats_it() {
    let (port, referee) = (free_port(), UdpSocket::bind("127.0.0.1:0").unwrap());
    referee.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let answer_port = i64::from(referee.local_addr().unwrap().port());
    let settings = || {
        options([
            ("team", 7.into()),
            ("player", 2.into()),
            ("port", port.into()),
            ("answer_port", answer_port.into()),
        ])
    };
    let mut bench = Bench::new();
    let states = bench.collect::<GameState>("game_state");
    let datagrams = bench.collect::<BusExchange>("datagrams");
    bench.core.add_with("referee", GameController::new(DeviceLink::new(Udp::default())), settings()).unwrap();
    bench.run(2); // opens the socket
    let mut packet = ControlPacket { state: State::Playing, ..ControlPacket::new(Version::Hsl20, [3, 7]) };
    packet.teams[1].players[1].penalty = 6;
    packet.kicking_team = Some(7);
    for bytes in [b"RGme\x15\0".to_vec(), packet.build(), vec![0; 1500]] {
        referee.send_to(&bytes, ("127.0.0.1", port as u16)).unwrap();
    }
    for _ in 0..200 {
        bench.run(1);
        if !states.lock().unwrap().is_empty() {
            break;
        }
        std::thread::yield_now();
    }
    bench.run(2);
    let heard = states.lock().unwrap().clone();
    let state = heard.first().unwrap();
    assert_eq!(
        (state.state, state.kick_team, state.is_penalised),
        (GameState::PLAYING, GameState::OWN, true)
    );
    assert!(!state.own_half_is_left);
    let mut buffer = [0; 64];
    let (length, _) = referee.recv_from(&mut buffer).unwrap();
    let answer = Answer::parse(&buffer[..length]).unwrap();
    assert!(matches!(answer, Answer::Status { team: 7, player: 2, ball_age: -1.0, .. }), "{answer:?}");

    let recorded = datagrams.lock().unwrap().clone();
    let cycles = bench.clock_cycles();
    let mut again = Bench::new();
    let repeated = again.collect::<GameState>("game_state");
    again.core.add_with("referee", GameController::new(DeviceLink::recorded(recorded)), settings()).unwrap();
    again.run(cycles);
    assert_eq!(*repeated.lock().unwrap(), heard);
}

#[test]
fn several_players_of_a_machine_hear_a_referee_that_broadcasts_on_loopback_and_answer_it() {
    let (port, answer_port) = (free_port(), free_port());
    let everybody = || SettingValue::from("127.255.255.255".to_owned());
    let mut bench = Bench::new();
    let answers = bench.collect::<TeamMessage>("answers");
    let states = [1, 2].map(|player| bench.collect::<GameState>(&format!("heard_{player}/game_state")));
    let players = SettingValue::Texts([1, 2].map(|player| format!("told_{player}")).to_vec());
    let settings = options([
        ("players", players),
        ("to", everybody()),
        ("port", port.into()),
        ("address", "127.0.0.1".to_owned().into()),
        ("answer_port", answer_port.into()),
    ]);
    let sender = GameControllerSender::new(DeviceLink::new(Udp::default()));
    bench.core.add_with("sender", sender, settings).unwrap();
    let mut told = Vec::new();
    for player in [1, 2] {
        let settings = options([
            ("team", 1.into()),
            ("player", player.into()),
            ("address", everybody()),
            ("port", port.into()),
            ("answer_port", answer_port.into()),
        ]);
        let options = ModuleOptions { namespace: format!("heard_{player}"), ..settings };
        let listener = GameController::new(DeviceLink::new(Udp::default()));
        bench.core.add_with(&format!("listener_{player}"), listener, options).unwrap();
        told.push(bench.core.inlet::<GameState>(&format!("told_{player}/game_state")).unwrap());
    }
    bench.run(2); // opens the sockets
    let said = [1_u8, 2].map(|player| GameState {
        state: GameState::READY,
        own_team: 1,
        opponent_team: 2,
        own_colour: GameState::COLOUR_BLUE,
        opponent_colour: GameState::COLOUR_RED,
        own_half_is_left: true,
        player,
        is_goalkeeper: player == 1,
        message_budget: u16::MAX,
        ..GameState::default()
    });
    for (inlet, state) in told.iter().zip(&said) {
        inlet.publish(state.clone()).unwrap();
    }
    for _ in 0..200 {
        bench.run(1);
        if answers.lock().unwrap().len() >= 2 {
            break;
        }
        std::thread::yield_now();
    }
    for (heard, said) in states.iter().zip(said) {
        let heard = heard.lock().unwrap().first().unwrap().clone();
        assert_eq!(heard, GameState { header: heard.header.clone(), ..said });
    }
    let mut players: Vec<_> =
        answers.lock().unwrap().iter().map(|answer| (answer.team, answer.player)).collect();
    players.sort_unstable();
    players.dedup();
    assert_eq!(players, [(1, 1), (1, 2)]);
}

#[test]
fn team_mates_hear_each_other_at_most_ten_times_a_second_within_the_budget() {
    let (port, mate) = (free_port(), UdpSocket::bind("127.0.0.1:0").unwrap());
    mate.set_nonblocking(true).unwrap();
    let mate_port = mate.local_addr().unwrap().port();
    let mut bench = Bench::new();
    let heard = bench.collect::<TeamMessage>("team_messages");
    let sent = bench.collect::<BusExchange>("datagrams");
    let settings = options([
        ("team", 7.into()),
        ("player", 2.into()),
        ("port", port.into()),
        ("to", "127.0.0.1".to_owned().into()),
        ("reserve", 10.into()),
    ]);
    bench.core.add_with("team", TeamCommunication::new(DeviceLink::new(Udp::default())), settings).unwrap();
    let status = bench.core.inlet::<TeamMessage>("team_status").unwrap();
    let game = bench.core.inlet::<GameState>("game_state").unwrap();
    bench.run(2);
    let message = TeamMessage { player: 3, role: TeamMessage::GOALKEEPER, ..TeamMessage::default() };
    assert_ne!(i64::from(mate_port), port);
    mate.send_to(&team::encode(&message), ("127.0.0.1", port as u16)).unwrap();
    mate.send_to(&[0xff; 600], ("127.0.0.1", port as u16)).unwrap();
    let count = |sent: &Arc<Mutex<Vec<BusExchange>>>| {
        sent.lock().unwrap().iter().filter(|exchange| !exchange.instruction.is_empty()).count()
    };
    for _ in 0..50 {
        status.publish(TeamMessage::default()).unwrap();
        bench.run(1);
    }
    assert!((9..=11).contains(&count(&sent)), "{} in one second", count(&sent));
    assert_eq!(heard.lock().unwrap().iter().map(|message| message.player).collect::<Vec<_>>(), [3]);
    game.publish(GameState { message_budget: 12, ..GameState::default() }).unwrap();
    bench.run(2);
    let before = count(&sent);
    for _ in 0..100 {
        status.publish(TeamMessage::default()).unwrap();
        bench.run(1);
    }
    assert!(count(&sent) - before <= 3, "{} beyond the budget", count(&sent) - before);
}
