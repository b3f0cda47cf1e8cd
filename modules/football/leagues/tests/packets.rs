//! Packets of GameControllers, against the layouts in the headers of the leagues, and against bytes that are
//! none.
#![allow(clippy::unwrap_used)]

use downbeat_leagues::packets::{Answer, ControlPacket, PacketError, Phase, Player, SetPlay, State, Version};
use fuzzing::{Random, rounds};

/// `sizeof(RoboCupGameControlData)`; the size of 20 is asserted in its header, the others follow from the
/// fields.
const SIZES: [(Version, usize); 5] = [
    (Version::Humanoid12, 688),
    (Version::Spl15, 118),
    (Version::Spl18, 118),
    (Version::Hsl19, 198),
    (Version::Hsl20, 158),
];

fn any_packet(version: Version, random: &mut Random) -> ControlPacket {
    let is_humanoid = version == Version::Humanoid12;
    let is_spl = matches!(version, Version::Spl15 | Version::Spl18);
    let mut packet = ControlPacket::new(version, [random.bits() as u8, random.bits() as u8]);
    packet.packet_number = random.bits() as u8;
    packet.players_per_team = random.bits() as u8;
    packet.competition_phase = if is_spl { random.bits() as u8 } else { 0 };
    packet.competition_type = random.bits() as u8;
    packet.is_stopped = !is_spl && !is_humanoid && random.one_in(2);
    packet.phase = *random.choose(&[Phase::Normal, Phase::PenaltyShootOut, Phase::ExtraTime, Phase::TimeOut]);
    let states = [State::Initial, State::Ready, State::Set, State::Playing, State::Finished, State::Standby];
    packet.state = *random.choose(if version == Version::Spl18 { &states } else { &states[..5] });
    let set_plays = [
        SetPlay::None,
        SetPlay::GoalKick,
        SetPlay::CornerKick,
        SetPlay::ThrowIn,
        SetPlay::DirectFreeKick,
        SetPlay::PenaltyKick,
        SetPlay::IndirectFreeKick,
    ];
    packet.set_play = *random.choose(if is_spl { &set_plays[..6] } else { &set_plays });
    if is_humanoid && packet.set_play != SetPlay::None {
        packet.phase = Phase::Normal;
        packet.set_play_stage = random.below(3) as u8;
    }
    packet.is_first_half = random.one_in(2);
    packet.kicking_team = (!random.one_in(3)).then(|| random.below(255) as u8);
    packet.seconds_remaining = random.bits() as i16;
    packet.secondary_seconds = random.bits() as i16;
    for team in &mut packet.teams {
        team.field_player_colour = random.bits() as u8;
        team.goalkeeper_colour = if is_humanoid { 0 } else { random.bits() as u8 };
        team.goalkeeper = random.below(version.players() + 1) as u8;
        team.score = random.bits() as u8;
        team.penalty_shot = random.bits() as u8;
        team.single_shots = random.bits() as u16;
        team.message_budget = (!is_humanoid).then(|| random.bits() as u16);
        for player in team.players.iter_mut().take(version.players()) {
            *player = Player {
                penalty: random.bits() as u8,
                seconds_penalised: random.bits() as u8,
                warnings: if is_humanoid || version == Version::Hsl19 { random.bits() as u8 } else { 0 },
                cautions: if is_spl { 0 } else { random.bits() as u8 },
                red_cards: if is_humanoid { random.bits() as u8 } else { 0 },
            };
        }
    }
    packet
}

#[test]
fn a_packet_that_is_built_is_parsed_as_it_was() {
    let mut random = Random::new(1);
    for _ in rounds(2000) {
        for (version, size) in SIZES {
            let packet = any_packet(version, &mut random);
            let bytes = packet.build();
            assert_eq!(bytes.len(), size);
            assert_eq!(ControlPacket::parse(&bytes).unwrap(), packet);
        }
    }
}

#[test]
fn no_bytes_panic_and_what_is_parsed_is_built_again() {
    let mut random = Random::new(2);
    let (mut parsed, mut refused) = (0, 0);
    for _ in rounds(20_000) {
        let (version, _) = *random.choose(&SIZES);
        let mut bytes = any_packet(version, &mut random).build();
        for _ in 0..random.below(4) {
            let at = random.below(bytes.len());
            bytes[at] = random.bits() as u8;
        }
        if random.one_in(4) {
            bytes.truncate(random.below(bytes.len()));
        }
        match ControlPacket::parse(&bytes) {
            Ok(packet) => {
                assert_eq!(ControlPacket::parse(&packet.build()).as_ref(), Ok(&packet));
                parsed += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        }
        let _ = Answer::parse(&bytes);
        let noise: Vec<u8> = (0..random.below(40)).map(|_| random.bits() as u8).collect();
        assert!(ControlPacket::parse(&noise).is_err());
    }
    assert!(parsed > 0 && refused > 0, "{parsed} parsed, {refused} refused");
}

/// Offsets as the headers give them: every field is set in bytes here, not by `build`.
#[test]
fn fields_are_where_the_headers_of_the_leagues_say() {
    // Version, offsets of: state, set play, kicking team, seconds, second team, its score, its third player.
    let layouts = [
        (Version::Spl15, [10, 11, 13, 14, 68, 72, 68 + 10 + 2 * 2]),
        (Version::Spl18, [10, 11, 13, 14, 68, 72, 68 + 10 + 2 * 2]),
        (Version::Hsl19, [10, 11, 13, 14, 108, 112, 108 + 10 + 2 * 4]),
        (Version::Hsl20, [10, 11, 13, 14, 88, 92, 88 + 10 + 2 * 3]),
        (Version::Humanoid12, [9, 12, 11, 20, 356, 358, 356 + 7 + 253 + 6 + 2 * 6]),
    ];
    for (version, [state, set_play, kicking, seconds, team, score, player]) in layouts {
        let length = SIZES.iter().find(|(of, _)| *of == version).unwrap().1;
        let mut bytes = vec![0; length];
        bytes[..4].copy_from_slice(b"RGme");
        bytes[4] = version.number() as u8;
        bytes[state] = 3;
        bytes[kicking] = 17;
        bytes[seconds..seconds + 2].copy_from_slice(&(-5_i16).to_le_bytes());
        bytes[team] = 42;
        bytes[score] = 6;
        bytes[player] = 9;
        bytes[player + 1] = 30;
        let packet = ControlPacket::parse(&bytes).unwrap();
        assert_eq!((packet.state, packet.kicking_team), (State::Playing, Some(17)), "{version:?}");
        assert_eq!((packet.seconds_remaining, packet.secondary_seconds), (-5, 0), "{version:?}");
        let second = &packet.teams[1];
        assert_eq!((second.number, second.score), (42, 6), "{version:?}");
        assert_eq!((second.players[2].penalty, second.players[2].seconds_penalised), (9, 30), "{version:?}");
        // SET_PLAY_CORNER_KICK is 3 in 15, 6 in 19 and 20; STATE2_CORNER_KICK is 7.
        bytes[set_play] = match version {
            Version::Spl15 | Version::Spl18 => 3,
            Version::Hsl19 | Version::Hsl20 => 6,
            Version::Humanoid12 => 7,
        };
        assert_eq!(ControlPacket::parse(&bytes).unwrap().set_play, SetPlay::CornerKick, "{version:?}");
    }
}

#[test]
fn another_version_is_refused_with_the_remedy() {
    let mut bytes = ControlPacket::new(Version::Hsl20, [1, 2]).build();
    bytes[4] = 21;
    let error = ControlPacket::parse(&bytes).unwrap_err();
    assert_eq!(error, PacketError::Version(21));
    assert!(error.to_string().contains("known are 12, 15, 18, 19 and 20"), "{error}");
    bytes[4] = 19;
    let length = PacketError::Length { version: 19, expected: 198, found: 158 };
    assert_eq!(ControlPacket::parse(&bytes), Err(length));
}

#[test]
fn answers_have_the_layout_of_the_return_packets() {
    let status = Answer::Status {
        team: 5,
        player: 2,
        is_fallen: true,
        pose: [1000.0, -500.0, 0.5],
        ball_age: 1.5,
        ball: [300.0, 20.0],
    };
    let bytes = status.build();
    assert_eq!((bytes.len(), &bytes[..8]), (32, &b"RGrt\x04\x02\x05\x01"[..]));
    assert_eq!(bytes[20..24], 1.5_f32.to_le_bytes()); // ballAge follows header, four bytes and pose[3]
    assert_eq!(Answer::parse(&bytes), Ok(status));
    let alive = Answer::Alive { team: 5, player: 2, message: Answer::ALIVE };
    assert_eq!(alive.build(), b"RGrt\x02\x05\x02\x02");
    assert_eq!(Answer::parse(&alive.build()), Ok(alive));
}
