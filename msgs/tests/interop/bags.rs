//! Compares bytes with `rosbags`, for types that the wheels lack and for big-endian messages.

use crate::every_type::{Type, every_type};
use crate::peer::{Peer, unhex};
use crate::values::{self, samples};

/// Returns whether rosbags can read the type with our definition text. It does not support the texts of
/// events (which are those of services), wide strings, and some unusual names.
pub fn is_known(of: &Type) -> bool {
    !of.name.ends_with("_Event") && !of.definition.contains("wstring") && !of.name.starts_with("odd_msgs/")
}

#[test]
fn rosbags_reads_what_we_write_and_we_read_what_it_writes_in_both_byte_orders() {
    let Some(peer) = Peer::find() else { return };
    let types = every_type();
    let types: Vec<&Type> = types.iter().filter(|of| is_known(of)).collect();
    let ours = samples(&types, 200);
    let answer = peer.ask("bags_convert", &[], &(values::definitions(&types) + &values::lines(&ours)));
    let lines = answer.lines::<3>();
    assert_eq!(lines.len(), ours.len());
    for (sample, [json, little, big]) in ours.iter().zip(lines) {
        sample.check_value(json, "rosbags");
        sample.check_bytes(&unhex(little));
        sample.check_swapped(&unhex(big));
    }
}
