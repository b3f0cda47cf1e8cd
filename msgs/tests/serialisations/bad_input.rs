//! Invalid input causes errors with positions, no panics, and bounded use of memory.

use downbeat_msgs::encoding::{Codec, Encoding};

use crate::random::Random;
use crate::types::{catalog, every_type, name};

const READABLE: [Encoding; 6] = [
    Encoding::Json,
    Encoding::Cbor,
    Encoding::Protobuf,
    Encoding::FoxgloveProtobuf,
    Encoding::FlatBuffers,
    Encoding::FoxgloveFlatBuffers,
];

fn codec(encoding: Encoding, type_name: &str) -> Codec {
    encoding.codec(catalog(), &name(type_name)).unwrap()
}

fn error(encoding: Encoding, type_name: &str, bytes: &[u8]) -> String {
    codec(encoding, type_name).decode(bytes).unwrap_err().to_string()
}

#[test]
fn no_prefix_and_no_flipped_bit_of_any_message_makes_a_reader_panic() {
    let mut random = Random::new(0xbad);
    let mut refused = 0_usize;
    for of in every_type() {
        let value = (of.random)(&mut random);
        for encoding in READABLE {
            let codec = codec(encoding, of.name);
            // Random images and clouds are inconsistent, which Foxglove's schemas may not be able to
            // represent.
            let Ok(bytes) = codec.encode(&value) else { continue };
            for end in (0..bytes.len()).step_by(bytes.len() / 40 + 1) {
                refused += usize::from(codec.decode(&bytes[..end]).is_err());
            }
            for place in (0..bytes.len()).step_by(bytes.len() / 40 + 1) {
                let mut flipped = bytes.clone();
                flipped[place] ^= 1 << (place % 8);
                refused += usize::from(codec.decode(&flipped).is_err());
            }
        }
    }
    assert!(refused > 10_000, "only {refused} were refused");
}

#[test]
fn errors_name_the_byte_and_the_field() {
    assert_eq!(
        error(Encoding::Protobuf, "sensor_msgs/msg/Imu", b"\x0a\x04\x12\x7fab"),
        "sensor_msgs/msg/Imu: cannot read protobuf at byte 4, field `header`: needs 127 more bytes, but there are only 2"
    );
    assert_eq!(
        error(Encoding::Protobuf, "std_msgs/msg/String", b"\x0a\x02\xff\xfe"),
        "std_msgs/msg/String: cannot read protobuf at byte 2, field `data`: the string is not UTF-8 after its first 0 bytes"
    );
    assert_eq!(
        error(Encoding::Protobuf, "std_msgs/msg/UInt8", b"\x08\xac\x02"),
        "std_msgs/msg/UInt8: cannot read protobuf at byte 1, field `data`: 300 is out of the range of UInt8"
    );
    assert_eq!(
        error(Encoding::Protobuf, "rmw_dds_common/msg/Gid", b"\x0a\x02ab"),
        "rmw_dds_common/msg/Gid: cannot read protobuf, field `data`: has 2 elements, but the type has exactly 16"
    );
    let short = error(Encoding::FlatBuffers, "std_msgs/msg/String", b"\xff\xff\xff\xff");
    assert_eq!(
        short,
        "std_msgs/msg/String: cannot read flatbuffers at byte 4294967295: needs 4 bytes here, the buffer has 4"
    );
    let json = error(Encoding::Json, "std_msgs/msg/UInt8", br#"{"data": 256}"#);
    assert!(json.contains("field `data`") && json.contains("line 1 column"), "{json}");
    let json = error(Encoding::Json, "std_msgs/msg/UInt8", b"{}");
    assert!(json.contains("missing field `data`"), "{json}");
    let json = error(Encoding::Json, "std_msgs/msg/UInt8", br#"{"data": 1, "data": 2}"#);
    assert!(json.contains("duplicate field `data`"), "{json}");
}

#[test]
fn tables_that_share_what_they_refer_to_do_not_take_memory_without_bound() {
    // A list of 100 000 offsets to one table of a type that takes a kilobyte: geometry_msgs/msg/PoseArray.
    let mut bytes = Vec::new();
    let put =
        |bytes: &mut Vec<u8>, numbers: &[u32]| numbers.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    put(&mut bytes, &[12]);
    bytes.extend([8, 0, 8, 0, 0, 0, 4, 0]); // The vtable: no header, poses at 4.
    put(&mut bytes, &[8, 4]); // The table: its vtable 8 back, the vector 4 on.
    const COUNT: u32 = 100_000;
    put(&mut bytes, &[COUNT]);
    let first = bytes.len() as u32;
    let shared = first + 4 * COUNT + 4;
    (0..COUNT).for_each(|index| put(&mut bytes, &[shared - first - 4 * index]));
    bytes.extend([4, 0, 4, 0]); // A vtable without fields, and its table.
    put(&mut bytes, &[4]);
    let codec = codec(Encoding::FlatBuffers, "geometry_msgs/msg/PoseArray");
    // An encapsulation header, an empty `Header`, a length and padding, and the poses.
    let poses = codec.decode(&bytes).map(|cdr| cdr.len());
    assert!(poses.as_ref().is_ok_and(|length| *length == 4 + 24 + 56 * COUNT as usize), "{poses:?}");

    // The same with a type that takes much more is refused.
    let error = error(Encoding::FlatBuffers, "test_msgs/msg/MultiNested", &sharing_arrays());
    assert!(error.contains("bytes of memory, too many for an input of this size"), "{error}");
}

/// A `MultiNested` with a list that refers to one `Arrays` a hundred thousand times.
fn sharing_arrays() -> Vec<u8> {
    const COUNT: u32 = 100_000;
    let mut bytes = Vec::new();
    let put =
        |bytes: &mut Vec<u8>, numbers: &[u32]| numbers.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    put(&mut bytes, &[28]);
    bytes.extend([22, 0, 8, 0]);
    bytes.extend([0; 12]); // Six absent fields,
    bytes.extend([4, 0]); // the list of `Arrays` of any length,
    bytes.extend([0; 6]); // and the remaining fields and padding.
    put(&mut bytes, &[24, 4, COUNT]);
    let first = bytes.len() as u32;
    let shared = first + 4 * COUNT + 4;
    (0..COUNT).for_each(|index| put(&mut bytes, &[shared - first - 4 * index]));
    bytes.extend([4, 0, 4, 0]);
    put(&mut bytes, &[4]);
    bytes
}
