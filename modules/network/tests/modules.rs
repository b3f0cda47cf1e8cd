//! The modules on sockets of this machine, and on recordings of them.
#![allow(clippy::unwrap_used)]

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::{Core, Inbox, ManualClock, ModuleOptions, OutletInbox, Received, SettingValue, Time};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage};
use downbeat_modules::device::DeviceLink;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::String as Line;
use downbeat_network::game_controller::GameController;
use downbeat_network::game_controller_sender::GameControllerSender;
use downbeat_network::packets::{Answer, ControlPacket, State, Version};
use downbeat_network::tcp::Tcp;
use downbeat_network::tcp_lines::TcpLines;
use downbeat_network::team::{self, TeamCommunication};
use downbeat_network::udp::Udp;
use downbeat_network::udp_lines::UdpLines;

fn options<const N: usize>(settings: [(&str, SettingValue); N]) -> ModuleOptions {
    let settings = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

fn free_port() -> i64 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().into()
}

/// A core with one module, and what it publishes on one topic.
struct Bench {
    core: Core,
    clock: ManualClock,
}

impl Bench {
    fn new() -> Self {
        let clock = ManualClock::new(Time::ZERO);
        Self { core: Core::new().with_clock(clock.clone()), clock }
    }

    fn collect<T: Clone + Send + Sync + 'static>(&mut self, topic: &str) -> Arc<Mutex<Vec<T>>> {
        let collected = Arc::new(Mutex::new(Vec::new()));
        let all = Arc::clone(&collected);
        let inbox = OutletInbox::new(topic, Inbox::KeepAll);
        let take = move |received: Received<'_, T>| all.lock().unwrap().push((*received).clone());
        self.core.outlet(topic, &inbox, take).unwrap().keep();
        collected
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.clock.advance(Duration::from_millis(20));
            self.core.cycle().unwrap();
        }
    }
}

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

impl Bench {
    fn clock_cycles(&self) -> usize {
        use downbeat_executor::Clock;
        (self.clock.now().as_nanos() / 20_000_000) as usize
    }
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

#[test]
fn lines_pass_both_ways() {
    let (port, peer) = (free_port(), UdpSocket::bind("127.0.0.1:0").unwrap());
    peer.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let mut bench = Bench::new();
    let received = bench.collect::<Line>("lines/received");
    let settings = options([
        ("listen", format!("127.0.0.1:{port}").into()),
        ("to", peer.local_addr().unwrap().to_string().into()),
    ]);
    bench.core.add_with("lines", UdpLines::new(DeviceLink::new(Udp::default())), settings).unwrap();
    let send = bench.core.inlet::<Line>("lines/send").unwrap();
    bench.run(2);
    peer.send_to(b"one\r\ntwo\nthr\xff", ("127.0.0.1", port as u16)).unwrap();
    send.publish(Line { data: "left".to_owned() }).unwrap();
    bench.run(3);
    let lines: Vec<_> = received.lock().unwrap().iter().map(|line| line.data.clone()).collect();
    assert_eq!(lines, ["one", "two", "thr\u{fffd}"]);
    let mut buffer = [0; 64];
    let length = peer.recv(&mut buffer).unwrap();
    assert_eq!(&buffer[..length], b"left\n");
}

fn tcp_lines(side: &str, port: u16) -> (Bench, Arc<Mutex<Vec<Line>>>, downbeat_executor::Inlet<Line>) {
    let mut bench = Bench::new();
    let received = bench.collect::<Line>("lines/received");
    let settings =
        options([("side", side.to_owned().into()), ("address", format!("127.0.0.1:{port}").into())]);
    bench.core.add_with("lines", TcpLines::new(DeviceLink::new(Tcp::default())), settings).unwrap();
    let send = bench.core.inlet::<Line>("lines/send").unwrap();
    bench.run(2);
    (bench, received, send)
}

fn run_until(bench: &mut Bench, mut is_so: impl FnMut() -> bool) {
    for _ in 0..2000 {
        bench.run(1);
        if is_so() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("waited in vain");
}

fn free_tcp_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

#[test]
fn a_tcp_server_hears_all_peers_and_tells_all_and_drops_lines_without_end() {
    let port = free_tcp_port();
    let (mut bench, received, send) = tcp_lines("server", port);
    let mut peers = [0, 1].map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap());
    let [first, second] = &mut peers;
    first.write_all(b"one\r\ntw").unwrap();
    first.write_all(&vec![b'x'; 1_000_000]).unwrap();
    first.write_all(b"\nafter\n").unwrap();
    second.write_all(b"last \xff\nunfinished").unwrap();
    second.shutdown(Shutdown::Write).unwrap();
    run_until(&mut bench, || received.lock().unwrap().len() >= 3);
    let mut lines: Vec<_> = received.lock().unwrap().iter().map(|line| line.data.clone()).collect();
    lines.sort();
    assert_eq!(lines, ["after", "last \u{fffd}", "one"]);
    send.publish(Line { data: "left".to_owned() }).unwrap();
    bench.run(3);
    let mut buffer = [0; 5];
    first.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    first.read_exact(&mut buffer).unwrap();
    assert_eq!(&buffer, b"left\n");
}

#[test]
fn a_tcp_client_connects_again_when_its_server_comes_back() {
    let port = free_tcp_port();
    let (mut bench, received, send) = tcp_lines("client", port);
    bench.run(5); // nobody is there
    for round in 1..=2 {
        let server = TcpListener::bind(("127.0.0.1", port)).unwrap();
        server.set_nonblocking(true).unwrap();
        let mut peer = None;
        run_until(&mut bench, || {
            peer = server.accept().ok();
            peer.is_some()
        });
        let (mut peer, _) = peer.unwrap();
        peer.write_all(b"hello\n").unwrap();
        run_until(&mut bench, || received.lock().unwrap().len() == round);
        send.publish(Line { data: "back".to_owned() }).unwrap();
        bench.run(3);
        peer.set_nonblocking(false).unwrap();
        peer.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut buffer = [0; 5];
        peer.read_exact(&mut buffer).unwrap();
        assert_eq!(&buffer, b"back\n");
    }
}
