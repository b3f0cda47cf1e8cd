//! Participants without security in a domain that admits none.

use crate::common::matrix::{self, Way, With};
use crate::common::rclpy;
use crate::common::wait_until;
use crate::ours::{Ours, publish};
use crate::peer::Vendor;
use crate::{check, keystore, pairs};
use downbeat_bridge::middleware::Middleware;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use serde_json::json;
use std::time::Duration;
use test_machine::free_domain;

/// What a stranger needs to be discovered, several times over.
const WHILE: Duration = Duration::from_secs(3);

fn strangers_see_and_say_nothing(vendor: Vendor) {
    let Some(_check) = check(vendor, "participants without security see nothing and are not heard") else {
        return;
    };
    for (ours, mut peer) in pairs(vendor, &["publish /theirs hello", "subscribe /ours"]) {
        let stranger = Ours::join_in_clear(ours.domain_id);
        let heard =
            [stranger.texts("/ours", QosProfile::DEFAULT), stranger.texts("/theirs", QosProfile::DEFAULT)];
        let forged = ["/ours", "/theirs"].map(|topic| stranger.publisher(topic, QosProfile::DEFAULT));
        let texts = ours.texts("/theirs", QosProfile::DEFAULT);
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["to whom it concerns"]);
        peer.wait_for("heard /ours to whom it concerns");
        texts.next();
        let start = std::time::Instant::now();
        while start.elapsed() < WHILE {
            for publisher in &forged {
                publisher.publish(cdr::to_vec(&Text { data: "forged".to_owned() }).into()).unwrap();
            }
            assert!(texts.next().starts_with("hello "));
        }
        // It hears itself.
        assert!(heard.iter().all(|texts| texts.received().iter().all(|text| text == "forged")));
        assert!(!peer.printed().iter().any(|line| line.contains("forged")));
        assert!(stranger.middleware.remote_endpoints().is_empty());
        assert!(stranger.participant.remote_nodes().is_empty());
        assert_eq!((publisher.matched_subscriptions(), texts.subscription.matched_publishers()), (1, 1));
        assert_eq!(ours.security().authenticated, 1);
        let refusals = ours.security().refusals;
        assert!(refusals.iter().any(|text| text.contains("without security")), "{refusals:?}");
    }
}

#[test]
fn strangers_see_and_say_nothing_next_to_cyclone_dds() {
    strangers_see_and_say_nothing(Vendor::Cyclone);
}

#[test]
fn strangers_see_and_say_nothing_next_to_fast_dds() {
    strangers_see_and_say_nothing(Vendor::Fast);
}

#[test]
fn rclpy_without_security_sees_and_says_nothing() {
    let domain = free_domain();
    let Some(mut rclpy) = rclpy::Peer::start(domain, "LOCALHOST") else { return };
    let feature = "participants without security see nothing and are not heard";
    let _check = matrix::check("Security", feature, With::Rclpy, Way::Both);
    let (ours, other) =
        (Ours::join(domain, keystore(), "/talker"), Ours::join(domain, keystore(), "/listener"));
    let publisher = ours.publisher("/chatter", QosProfile::DEFAULT);
    let texts = other.texts("/chatter", QosProfile::DEFAULT);
    rclpy.ask(json!({"do": "subscribe", "topic": "/chatter", "type": "std_msgs/msg/String"}));
    rclpy.ask(json!({"do": "advertise", "topic": "/forged", "type": "std_msgs/msg/String"}));
    let forged = other.texts("/forged", QosProfile::DEFAULT);
    wait_until("rclpy is refused", || {
        other.security().refusals.iter().any(|text| text.contains("without security"))
    });
    publish(&publisher, ["secret"]);
    assert_eq!(texts.next(), "secret");
    rclpy.ask(json!({"do": "publish_texts", "topic": "/forged", "size": 10, "count": 30, "period_ms": 100}));
    assert_eq!(rclpy.ask(json!({"do": "take", "topic": "/chatter"})), json!([]));
    assert_eq!(rclpy.ask(json!({"do": "nodes"})), json!(["/peer"]));
    assert_eq!(rclpy.ask(json!({"do": "matched", "topic": "/forged"})), 0);
    assert_eq!(rclpy.ask(json!({"do": "publishers_of", "topic": "/chatter"})), json!([]));
    assert_eq!(forged.received(), Vec::<String>::new());
}
