//! Compares bytes with `cyclonedds`, the other DDS implementation that ROS 2 supports.

use crate::bags::is_known;
use crate::every_type::{Type, every_type};
use crate::peer::{Peer, hex, unhex};
use crate::values::{self, samples};

#[test]
fn cyclonedds_reads_what_we_write_and_we_read_what_it_writes_in_both_versions_and_byte_orders() {
    let Some(peer) = Peer::find() else { return };
    let types = every_type();
    let types: Vec<&Type> = types.iter().filter(|of| is_known(of)).collect();
    let ours = samples(&types, 20);
    let answer = peer.ask("cyclone_convert", &[], &(values::definitions(&types) + &values::lines(&ours)));
    let lines = answer.lines::<5>();
    assert_eq!(lines.len(), ours.len());
    for (sample, [json, little, big, little_2, big_2]) in ours.iter().zip(lines) {
        sample.check_value(json, "cyclonedds");
        sample.check_bytes(&unhex(little));
        sample.check_swapped(&unhex(big));
        // For final types, which those of ROS 2 are.
        for (bytes, representation) in [(unhex(little_2), [0, 7]), (unhex(big_2), [0, 6])] {
            assert!(bytes.starts_with(&representation), "{}: {}", sample.label(), hex(&bytes));
            sample.check_read(&bytes);
        }
    }
}

#[test]
fn appendable_types_written_by_cyclonedds_are_read() {
    let Some(peer) = Peer::find() else { return };
    let types = every_type();
    let types: Vec<&Type> = types.iter().filter(|of| is_known(of)).collect();
    let ours = samples(&types, 5);
    let answer = peer.ask("cyclone_delimit", &[], &(values::definitions(&types) + &values::lines(&ours)));
    let lines = answer.lines::<2>();
    assert_eq!(lines.len(), ours.len());
    for (sample, [little, big]) in ours.iter().zip(lines) {
        for (bytes, representation) in [(unhex(little), [0, 9]), (unhex(big), [0, 8])] {
            assert!(bytes.starts_with(&representation), "{}: {}", sample.label(), hex(&bytes));
            sample.check_read(&bytes);
        }
    }
}
