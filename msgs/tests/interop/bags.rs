//! Bytes against `rosbags`, for types the wheels do not have, and for big-endian ones.

use crate::every_type::{Type, every_type};
use crate::peer::{Peer, unhex};
use crate::values::{self, samples};

/// Whether rosbags understands the type by our definition text. It reads no texts of events (they are those of services), has
/// no wide strings, and not all that is odd in names.
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
