//! Compares bytes with rclpy, which uses Fast CDR.

use crate::SEED;
use crate::every_type::{Type, every_type};
use crate::peer::{Answer, Peer, hex, unhex};
use crate::values::{self, Sample, label, parse, samples};

/// Random values of each type, in each direction.
const VALUES_PER_TYPE: usize = 200;

fn types_of_the_wheels(peer: &Peer) -> Vec<Type> {
    every_type().into_iter().filter(|of| peer.has_package_of(of.name)).collect()
}

#[test]
fn messages_of_rclpy_are_read_and_written_again_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let types = types_of_the_wheels(&peer);
    let names = types.iter().fold(String::new(), |names, of| names + of.name + "\n");
    let answer = peer.ask("ros_write", &[&VALUES_PER_TYPE.to_string(), &SEED.to_string()], &names);
    let lines = answer.lines::<3>();
    let (of_each, rest) = lines.as_chunks::<{ VALUES_PER_TYPE + 1 }>();
    assert_eq!((of_each.len(), rest.len()), (types.len(), 0));
    for (of, lines) in types.iter().zip(of_each) {
        for (number, [name, theirs, json]) in lines.iter().enumerate() {
            assert_eq!(*name, of.name);
            let what = || format!("{} written by rclpy", label(of.name, number));
            let theirs = unhex(theirs);
            if number == 0 {
                assert_same(&(of.default)(), &theirs, || format!("the default of {name}"));
            }
            // Our bytes for their value equal theirs and come from reading theirs, so we read the right
            // value.
            assert_same(&(of.write)(&parse(json)), &theirs, what);
            let again = (of.read)(&theirs).unwrap_or_else(|error| panic!("{}: {error}: {json}", what()));
            assert_same(&again, &theirs, what);
        }
    }
}

#[test]
fn our_messages_are_read_and_written_again_by_rclpy_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let types = types_of_the_wheels(&peer);
    let ours = samples(&types.iter().collect::<Vec<_>>(), VALUES_PER_TYPE);
    let answer = peer.ask("ros_read", &[], &values::lines(&ours));
    check_read(&ours, &answer, "rclpy");
}

/// rclpy does not write big-endian bytes but reads them.
#[test]
fn rclpy_reads_the_same_values_from_big_endian_bytes() {
    let Some(peer) = Peer::find() else { return };
    let types = types_of_the_wheels(&peer);
    let types: Vec<&Type> = types.iter().filter(|of| crate::bags::is_known(of)).collect();
    let ours = samples(&types, 20);
    let swapped = peer.ask("bags_convert", &[], &(values::definitions(&types) + &values::lines(&ours)));
    let request =
        ours.iter().zip(swapped.lines::<3>()).fold(String::new(), |request, (sample, [_, _, big])| {
            assert!(big.starts_with("00000000"), "{}: {big}", sample.label());
            request + sample.name + "\t" + big + "\n"
        });
    check_read(&ours, &peer.ask("ros_read", &[], &request), "rclpy from big-endian bytes");
}

/// Checks the values and bytes that it returns for ours.
fn check_read(ours: &[Sample], answer: &Answer, by: &str) {
    let lines = answer.lines::<2>();
    assert_eq!(lines.len(), ours.len());
    for (sample, [json, theirs]) in ours.iter().zip(lines) {
        sample.check_value(json, by);
        assert_same(&sample.bytes, &unhex(theirs), || sample.label());
    }
}

/// `serialize_message` returns a buffer with the estimated size (`rmw_serialize` in rmw_fastrtps_shared_cpp
/// uses `getEstimatedSerializedSize`), which is the maximum size for types that have one, and includes
/// padding before empty sequences for others. Bytes after the value are not part of it.
fn assert_same(ours: &[u8], theirs: &[u8], what: impl Fn() -> String) {
    let rest = theirs.strip_prefix(ours).unwrap_or_else(|| {
        let same = ours.iter().zip(theirs).take_while(|(a, b)| a == b).count();
        panic!("{}: differ from byte {same} on: we write {}, they {}", what(), hex(ours), hex(theirs))
    });
    assert!(rest.iter().all(|byte| *byte == 0), "{}: after {} rclpy has {}", what(), hex(ours), hex(rest));
}
