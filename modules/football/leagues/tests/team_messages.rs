//! Team messages, against Protobuf of Python and against bytes that are none.
#![allow(clippy::unwrap_used)]

use downbeat_football::football_interfaces::msg::{SeenRobot, TeamMessage};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_leagues::team::{LONGEST, decode, encode};
use fuzzing::{Random, rounds};

fn message() -> TeamMessage {
    let mut message = TeamMessage {
        team: 4,
        player: 3,
        state: TeamMessage::PENALISED,
        role: TeamMessage::STRIKER,
        sees_ball: true,
        ball_variance: 0.25,
        time_to_ball: 2.5,
        ..TeamMessage::default()
    };
    message.header.stamp.sec = 1_700_000_000;
    message.header.stamp.nanosec = 250_000_000;
    message.pose.pose.position.x = 1.5;
    message.pose.pose.position.y = -2.25;
    message.pose.pose.orientation.w = 1.0;
    message.pose.covariance[0] = 0.5;
    message.pose.covariance[35] = 0.125;
    message.ball.x = 3.0;
    message.ball_velocity.y = -0.5;
    let other = |team, x, player_number| SeenRobot { team, player_number, x, y: 0.5, variance: 0.0625 };
    message.others = vec![other(Attributes::TEAM_OPPONENT, 1.25, 0), other(Attributes::TEAM_OWN, -1.25, 2)];
    message
}

#[test]
fn a_message_is_decoded_as_it_was_and_within_the_length_of_the_league() {
    let bytes = encode(&message());
    assert!(bytes.len() <= LONGEST, "{} bytes", bytes.len());
    assert_eq!(decode(&bytes, 4).unwrap(), message());
    // Of many robots as many as fit.
    let mut full = message();
    full.others = full.others.repeat(4);
    let bytes = encode(&full);
    assert!(bytes.len() <= LONGEST, "{} bytes", bytes.len());
    assert_eq!(decode(&bytes, 4).unwrap().others, full.others[..6]);
}

#[test]
fn no_bytes_panic() {
    let mut random = Random::new(3);
    let mut decoded = 0;
    for _ in rounds(20_000) {
        let mut bytes = encode(&message());
        for _ in 0..random.below(5) {
            let at = random.below(bytes.len());
            bytes[at] = random.bits() as u8;
        }
        bytes.truncate(random.below(bytes.len() * 2));
        decoded += u32::from(decode(&bytes, 4).is_ok());
    }
    assert!(decoded > 0);
}

#[test]
fn protobuf_of_python_reads_and_writes_the_same() {
    let Some(python) = python_peer::Python::find() else { return };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/team_message.py");
    let hex: String = encode(&message()).iter().map(|byte| format!("{byte:02x}")).collect();
    let output = python.run(script, &[&hex]);
    let mut lines = output.lines();
    assert_eq!(
        lines.next().unwrap(),
        "3 2 1700000000 250000000 1.5 -2.25 0.5 0.125 3.0 -0.5 0.25 2.5 3 [(0, 1, 1.25, 0.0625), (2, 2, -1.25, 0.0625)]"
    );
    let again = lines.next().unwrap();
    let bytes: Vec<u8> =
        (0..again.len()).step_by(2).map(|at| u8::from_str_radix(&again[at..at + 2], 16).unwrap()).collect();
    assert_eq!(decode(&bytes, 4).unwrap(), message());
}
