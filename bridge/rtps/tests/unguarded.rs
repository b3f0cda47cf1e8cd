//! Tests of participants that hold only without security, each with the reason.

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::time::Duration;

use common::{Network, latched};

const SECOND: Duration = Duration::from_secs(1);

/// A participant with security announces no name to strangers.
#[test]
fn the_graph_has_names_policies_and_user_data() {
    let mut network = Network::new(1);
    network.join(|config| {
        config.user_data = "enclave=/;".into();
        config.name = "other".into();
    });
    let writer = network.writer(1, "rt/a", latched(3));
    network.run_for(SECOND);
    let ours = &network.nodes[0].participant;
    let [remote] = ours.remote_participants().collect::<Vec<_>>()[..] else { panic!("one participant") };
    assert_eq!((remote.user_data.as_slice(), remote.name.as_str()), (b"enclave=/;".as_slice(), "other"));
    let data = ours.remote_endpoint(network.guid(1, writer)).expect("the writer");
    assert_eq!((data.topic.as_str(), data.type_name.as_str()), ("rt/a", "std_msgs::msg::dds_::String_"));
    assert_eq!(data.user_data, b"typehash=RIHS01_00;");
    assert_eq!(data.qos.durability, latched(3).durability);
    assert_eq!(ours.remote_endpoints().count(), 1);
}
