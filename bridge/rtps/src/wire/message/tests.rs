#![allow(clippy::unwrap_used)]

use super::*;

/// A message written by hand, big-endian except for the DATA.
const MESSAGE: &[u8] = &[
    b'R', b'T', b'P', b'S', 2, 1, 0x01, 0x10, // header
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, // its prefix
    0x0e, 0x00, 0, 12, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, // INFO_DST
    0x09, 0x00, 0, 8, 0, 0, 0, 1, 0x80, 0, 0, 0, // INFO_TS of 1.5 s
    0x80, 0x00, 0, 4, 0xde, 0xad, 0xbe, 0xef, // of a vendor
    0x15, 0x05, 29, 0, // DATA, little-endian
    0, 0, 16, 0, 0, 0, 2, 4, 0, 0, 1, 3, 0, 0, 0, 0, 7, 0, 0, 0, // ends and number 7
    0, 1, 0, 0, 5, 6, 7, 8, 9, // payload
    0x01, 0x00, 0, 0, // PAD
    0x07, 0x06, 0, 28, // HEARTBEAT, final, of liveliness
    0, 0, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0, 9, 0x06, 0x00, 0,
    0, // ACKNACK to the end
    0, 0, 2, 4, 0, 0, 1, 3, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 2, 0x40, 0, 0, 0, 0, 0, 0, 3,
];

const READER: EntityId = EntityId::user_reader(2);
const WRITER: EntityId = EntityId::user_writer(1);

fn submessages(bytes: &[u8]) -> Vec<Result<Submessage<'_>, Malformed>> {
    parse(bytes).unwrap().1.collect()
}

/// Reads a message with one submessage.
fn read(id: u8, flags: u8, body: &[u8]) -> Result<Submessage<'static>, Malformed> {
    let length = u16::try_from(body.len()).unwrap_or(0).to_be_bytes();
    let bytes = [&MESSAGE[..20], &[id, flags], &length, body].concat();
    let mut all = submessages(Vec::leak(bytes));
    assert_eq!(all.len(), 1);
    all.remove(0)
}

fn body(parts: &[&[u8]]) -> Vec<u8> {
    parts.concat()
}

const ENDS: &[u8] = &[0, 0, 2, 4, 0, 0, 1, 3];
const ONE: &[u8] = &[0, 0, 0, 0, 0, 0, 0, 1];
const ZERO: &[u8] = &[0; 8];
const TOO_HIGH: &[u8] = &[0x40, 0, 0, 0, 0, 0, 0, 1];
const COUNT: &[u8] = &[0, 0, 0, 5];
const NO_BITS: &[u8] = &[0; 4];

#[test]
fn a_message_is_read_to_its_end() {
    let (header, _) = parse(MESSAGE).unwrap();
    let prefix = GuidPrefix([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
    assert_eq!(header, Header { version: [2, 1], vendor: VendorId::CYCLONE, prefix });
    let mut missing = SequenceNumberSet::new(SequenceNumber(7));
    assert!(missing.insert(SequenceNumber(8)));
    let expected = [
        Submessage::InfoDestination(GuidPrefix([12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1])),
        Submessage::InfoTimestamp(Some(Timestamp::from_nanos(1_500_000_000))),
        Submessage::Unknown { id: 0x80 },
        Submessage::Data(Data {
            reader: READER,
            writer: WRITER,
            number: SequenceNumber(7),
            inline_qos: InlineQos::default(),
            payload: Payload::Data(&[0, 1, 0, 0, 5, 6, 7, 8, 9]),
        }),
        Submessage::Pad,
        Submessage::Heartbeat(Heartbeat {
            reader: EntityId::UNKNOWN,
            writer: WRITER,
            first: SequenceNumber(1 << 32),
            last: SequenceNumber((1 << 32) + 5),
            count: 9,
            is_final: true,
            is_liveliness: true,
        }),
        Submessage::AckNack(AckNack { reader: READER, writer: WRITER, missing, count: 3, is_final: false }),
    ];
    assert_eq!(submessages(MESSAGE), expected.map(Ok));
}

#[test]
fn a_message_may_end_anywhere_without_harm() {
    for length in 0..MESSAGE.len() {
        match parse(&MESSAGE[..length]) {
            Err(fault) => assert!(length < 20, "{length}: {fault}"),
            Ok((_, submessages)) => assert!(submessages.count() <= 7),
        }
    }
}

#[test]
fn nothing_is_read_after_a_malformed_submessage() {
    let mut bytes = MESSAGE.to_vec();
    bytes[20 + 3] = 11; // INFO_DST one byte short
    assert_eq!(submessages(&bytes), [Err(Malformed::Truncated)]);
}

#[test]
fn other_protocols_and_versions_are_refused() {
    assert_eq!(parse(b"").err(), Some(Malformed::NotRtps));
    assert_eq!(parse(b"RTPX").err(), Some(Malformed::NotRtps));
    assert_eq!(parse(&MESSAGE[..19]).err(), Some(Malformed::Truncated));
    for (version, result) in [(1, Some(Malformed::Version(1))), (3, Some(Malformed::Version(3))), (2, None)] {
        let mut bytes = MESSAGE.to_vec();
        (bytes[4], bytes[5]) = (version, 99);
        assert_eq!(parse(&bytes).err(), result);
    }
}

#[test]
fn submessages_that_end_early_are_malformed() {
    for (id, length) in
        [(0x06, 28), (0x07, 28), (0x08, 28), (0x09, 8), (0x0c, 20), (0x0e, 12), (0x12, 28), (0x13, 24)]
    {
        let bytes = body(&[ENDS, ONE, &[0, 0, 0, 1], &[0; 8]]);
        for short in 1..length {
            assert!(read(id, 0, &bytes[..short]).is_err(), "{id:#x} of {short} bytes");
        }
    }
    assert_eq!(submessages(&[&MESSAGE[..20], &[0x07, 0, 0]].concat()), [Err(Malformed::Truncated)]);
    assert_eq!(
        submessages(&[&MESSAGE[..20], &[0x80, 0, 0xff, 0xff, 1]].concat()),
        [Err(Malformed::Truncated)]
    );
}

#[test]
fn a_timestamp_can_be_cancelled() {
    assert_eq!(read(0x09, 0x02, &[]), Ok(Submessage::InfoTimestamp(None)));
    assert_eq!(read(0x09, 0x00, &[0xff; 8]), Ok(Submessage::InfoTimestamp(None)));
    assert_eq!(read(0x09, 0x00, &[]), Err(Malformed::Truncated));
}

#[test]
fn a_source_replaces_the_header() {
    let source = read(0x0c, 0, &body(&[&[9; 4], &[2, 3, 1, 0x0f], &[7; 12]])).unwrap();
    let header = Header { version: [2, 3], vendor: VendorId::FAST_DDS, prefix: GuidPrefix([7; 12]) };
    assert_eq!(source, Submessage::InfoSource(header));
}

#[test]
fn security_submessages_are_passed_on_and_replies_are_not_read() {
    assert_eq!(read(0x33, 0, &[1, 2]), Ok(Submessage::Security { id: 0x33, body: &[1, 2] }));
    assert_eq!(read(0x35, 0, &[1, 2]), Ok(Submessage::Unknown { id: 0x35 }));
    assert_eq!(read(0x0f, 0, &[1, 2]), Ok(Submessage::InfoReply));
}

#[test]
fn data_numbers_range_from_1_to_2_to_the_62() {
    let with = |number: &[u8]| read(0x15, 0, &body(&[&[0, 0, 0, 16], ENDS, number]));
    assert!(with(ONE).is_ok());
    for bad in [ZERO, TOO_HIGH, &[0xff; 8], &[0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]] {
        assert_eq!(with(bad), Err(Malformed::SequenceNumber));
    }
}

#[test]
fn inline_qos_lies_where_its_offset_says() {
    let list: &[u8] = &[0, 0x71, 0, 4, 0, 0, 0, 3, 0, 1, 0, 0];
    let with = |offset: u8, between: &[u8], list: &[u8]| {
        read(0x15, 0x06, &body(&[&[0, 0, 0, offset], ENDS, ONE, between, list, &[0, 1, 0, 0]]))
    };
    for (offset, between) in [(16, &[][..]), (20, &[9; 4])] {
        let Ok(Submessage::Data(data)) = with(offset, between, list) else { panic!("no data") };
        assert_eq!(data.inline_qos.status.map(|status| status.0), Some(3));
        assert_eq!(data.payload, Payload::Data(&[0, 1, 0, 0]));
    }
    assert_eq!(with(12, &[], list), Err(Malformed::Truncated), "within the fields");
    assert_eq!(with(0xff, &[], list), Err(Malformed::Truncated), "after the end");
    let without_end = body(&[&[0, 0, 0, 16], ENDS, ONE, &list[..8]]);
    assert_eq!(read(0x15, 0x06, &without_end), Err(Malformed::Truncated));
    assert_eq!(with(16, &[], &[0, 0x71, 0, 3, 0, 0, 0, 3]), Err(Malformed::ParameterList));
}

#[test]
fn a_payload_loses_the_padding_it_declares() {
    let with = |flags: u8, payload: &[u8]| {
        let data = read(0x15, flags, &body(&[&[0, 0, 0, 16], ENDS, ONE, payload]))?;
        let Submessage::Data(data) = data else { panic!("no data") };
        Ok(data.payload)
    };
    assert_eq!(with(0x04, &[0, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Data(&[0, 1, 0, 3, 9])));
    assert_eq!(with(0x08, &[0, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Key(&[0, 1, 0, 3, 9])));
    assert_eq!(with(0x04, &[0, 1, 0, 3]), Ok(Payload::Data(&[0, 1, 0, 3])));
    assert_eq!(with(0x04, &[9, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Data(&[9, 1, 0, 3, 9, 0, 0, 0])));
    assert_eq!(with(0x00, &[1, 2, 3]), Ok(Payload::None));
    for short in [&[][..], &[0], &[0, 1, 0]] {
        assert_eq!(with(0x04, short), Err(Malformed::Encapsulation));
        assert_eq!(with(0x08, short), Err(Malformed::Encapsulation));
    }
}

/// Reads a DATA_FRAG with `payload` bytes of payload.
fn fragment(first: u32, count: u16, size: u16, sample: u32, payload: usize) -> Result<usize, Malformed> {
    let numbers =
        body(&[&first.to_be_bytes(), &count.to_be_bytes(), &size.to_be_bytes(), &sample.to_be_bytes()]);
    match read(0x16, 0, &body(&[&[0, 0, 0, 28], ENDS, ONE, &numbers, &vec![7; payload]]))? {
        Submessage::DataFragment(fragment) => {
            let end = fragment.offset() as usize + fragment.payload.len();
            assert!(end <= sample as usize, "{fragment:?}");
            Ok(fragment.payload.len())
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn fragments_lie_within_their_sample() {
    assert_eq!(fragment(1, 1, 100, 250, 100), Ok(100));
    assert_eq!(fragment(1, 2, 100, 250, 200), Ok(200));
    assert_eq!(fragment(3, 1, 100, 250, 50), Ok(50), "the last is short");
    assert_eq!(fragment(1, 3, 100, 250, 252), Ok(250), "and padded");
    assert_eq!(fragment(1, 1, 65_535, 4, 4), Ok(4));
    assert_eq!(fragment(u32::MAX, 1, 1, u32::MAX, 1), Ok(1));
    assert_eq!(fragment(0x1_0001, 1, 65_535, u32::MAX, 65_535), Ok(65_535));
    for (first, count, size, sample) in [
        (0, 1, 100, 250),
        (4, 1, 100, 250),
        (1, 0, 100, 250),
        (1, 1, 0, 250),
        (1, 4, 100, 250),
        (3, 2, 100, 250),
        (1, 1, 100, 0),
        (1, 1, 100, 3),
        (u32::MAX, 1, 100, 250),
        (u32::MAX, 65_535, 65_535, u32::MAX),
        (0x1_0002, 1, 65_535, u32::MAX), // 2³² and a bit
    ] {
        assert_eq!(
            fragment(first, count, size, sample, 300),
            Err(Malformed::Fragment),
            "{first} {count} {size}"
        );
    }
}

#[test]
fn fragments_with_fewer_bytes_than_declared_are_malformed() {
    assert_eq!(fragment(1, 2, 100, 250, 199), Err(Malformed::Truncated));
    assert_eq!(fragment(3, 1, 100, 250, 49), Err(Malformed::Truncated));
    assert_eq!(fragment(1, 65_535, 65_535, u32::MAX, 1000), Err(Malformed::Truncated));
}

#[test]
fn a_heartbeat_runs_forward() {
    let with = |first: i64, last: i64| {
        read(0x07, 0, &body(&[ENDS, &first.to_be_bytes(), &last.to_be_bytes(), COUNT]))
    };
    assert!(with(1, 0).is_ok());
    assert!(with(1, 1 << 60).is_ok());
    assert!(with(SequenceNumber::MAX.0, SequenceNumber::MAX.0).is_ok());
    for (first, last) in
        [(0, 0), (-5, 5), (5, 3), (1, -1), (1, i64::MAX), (i64::MAX, i64::MAX), (1, i64::MIN)]
    {
        assert_eq!(with(first, last), Err(Malformed::SequenceNumber), "{first} {last}");
    }
}

#[test]
fn an_acknowledgement_of_nothing_is_one_and_one_that_asks_for_number_zero_is_not() {
    let with = |base: &[u8], bits: &[u8]| read(0x06, 0, &body(&[ENDS, base, bits, COUNT]));
    assert!(with(ZERO, NO_BITS).is_ok());
    assert!(with(ONE, &[0, 0, 0, 1, 0x80, 0, 0, 0]).is_ok());
    assert_eq!(with(ZERO, &[0, 0, 0, 1, 0x80, 0, 0, 0]), Err(Malformed::SequenceNumber));
    assert_eq!(with(&[0xff; 8], NO_BITS), Err(Malformed::SequenceNumber));
    assert_eq!(with(ONE, &[0, 0, 1, 1]), Err(Malformed::NumberSet));
    assert_eq!(with(ONE, &[0xff; 4]), Err(Malformed::NumberSet));
}

#[test]
fn a_gap_that_runs_backwards_is_empty() {
    let with = |start: i64, base: i64| match read(
        0x08,
        0,
        &body(&[ENDS, &start.to_be_bytes(), &base.to_be_bytes(), NO_BITS]),
    )? {
        Submessage::Gap(gap) => Ok((gap.start.0, gap.list.base().0)),
        other => panic!("{other:?}"),
    };
    assert_eq!(with(5, 1 << 40), Ok((5, 1 << 40)));
    assert_eq!(with(9, 5), Ok((5, 5)));
    for (start, base) in [(0, 5), (5, 0), (-1, 5), (1, i64::MAX), (i64::MAX, 1)] {
        assert_eq!(with(start, base), Err(Malformed::SequenceNumber));
    }
}

#[test]
fn fragments_count_from_one() {
    let nack = |base: &[u8]| read(0x12, 0, &body(&[ENDS, ONE, base, NO_BITS, COUNT]));
    let heartbeat = |last: &[u8]| read(0x13, 0, &body(&[ENDS, ONE, last, COUNT]));
    assert!(nack(&[0, 0, 0, 1]).is_ok() && heartbeat(&[0, 0, 0, 1]).is_ok());
    assert_eq!(nack(&[0; 4]), Err(Malformed::Fragment));
    assert_eq!(heartbeat(&[0; 4]), Err(Malformed::Fragment));
}
