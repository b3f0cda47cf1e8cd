//! Requests and responses in both directions.

use crate::common::WATCHDOG;
use crate::peer::Vendor;
use crate::{check, pairs};
use downbeat_bridge::ros::Client;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};

fn requests_are_answered(vendor: Vendor) {
    let Some(_check) = check(vendor, "services") else { return };
    for (ours, mut peer) in pairs(vendor, &["serve /theirs", "call /ours true"]) {
        let light = |request: SetBoolRequest| SetBoolResponse {
            success: request.data,
            message: format!("we were asked {}", request.data),
        };
        let _service = ours.node.serve::<SetBool>("/ours", QosProfile::SERVICES, light).unwrap();
        peer.wait_for("answered /ours we were asked true");
        let client: Client<SetBool> = ours.node.client("/theirs", QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(WATCHDOG));
        for data in [true, false] {
            let response = client.call_and_wait(&SetBoolRequest { data }, WATCHDOG).unwrap();
            assert_eq!((response.success, &*response.message), (data, &*format!("data is {data}")));
            peer.wait_for(&format!("served /theirs {data}"));
        }
    }
}

#[test]
fn requests_are_answered_to_and_from_cyclone_dds() {
    requests_are_answered(Vendor::Cyclone);
}

#[test]
fn requests_are_answered_to_and_from_fast_dds() {
    requests_are_answered(Vendor::Fast);
}
