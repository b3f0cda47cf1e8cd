//! Bytes against rclpy, which is Fast CDR beneath.

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
fn what_rclpy_writes_is_read_and_written_again_to_the_byte() {
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
            // Our bytes of their value are theirs, and come from reading theirs: so what was read is the value.
            assert_same(&(of.write)(&parse(json)), &theirs, what);
            let again = (of.read)(&theirs).unwrap_or_else(|error| panic!("{}: {error}: {json}", what()));
            assert_same(&again, &theirs, what);
        }
    }
}

#[test]
fn what_we_write_is_read_and_written_again_by_rclpy_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let types = types_of_the_wheels(&peer);
    let ours = samples(&types.iter().collect::<Vec<_>>(), VALUES_PER_TYPE);
    let answer = peer.ask("ros_read", &[], &values::lines(&ours));
    check_read(&ours, &answer, "rclpy");
}

/// What rclpy cannot write it reads: its numbers are swapped where the header says so.
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

/// Checks values and bytes that it gives for ours.
fn check_read(ours: &[Sample], answer: &Answer, by: &str) {
    let lines = answer.lines::<2>();
    assert_eq!(lines.len(), ours.len());
    for (sample, [json, theirs]) in ours.iter().zip(lines) {
        sample.check_value(json, by);
        assert_same(&sample.bytes, &unhex(theirs), || sample.label());
    }
}

/// `serialize_message` gives a buffer as long as the size it estimated beforehand (`rmw_serialize` in
/// rmw_fastrtps_shared_cpp takes the length from `getEstimatedSerializedSize`), which is the greatest size for types that have
/// one, and counts padding before empty sequences for others. What stands behind the value is no part of it.
fn assert_same(ours: &[u8], theirs: &[u8], what: impl Fn() -> String) {
    let rest = theirs.strip_prefix(ours).unwrap_or_else(|| {
        let same = ours.iter().zip(theirs).take_while(|(a, b)| a == b).count();
        panic!("{}: differ from byte {same} on: we write {}, they {}", what(), hex(ours), hex(theirs))
    });
    assert!(rest.iter().all(|byte| *byte == 0), "{}: behind {} rclpy has {}", what(), hex(ours), hex(rest));
}
