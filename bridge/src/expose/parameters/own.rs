//! The parameters that every node of rclcpp declares by itself.

use downbeat_executor::{SettingInfo, SettingValue};
use downbeat_msgs::qos::{Durability, History, QosProfile, Reliability};

/// Whether time is that of `/clock`.
pub(super) const USE_SIM_TIME: &str = "use_sim_time";

/// Those of a node; `has_followed` if it has subscribed `/clock` at some time.
pub(super) fn parameters(is_following: bool, has_followed: bool) -> Vec<SettingInfo> {
    let service = "Start the ~/get_type_description service for this node.";
    let mut parameters = vec![
        parameter("start_type_description_service", service, true.into(), true),
        parameter(USE_SIM_TIME, "Follow the time on /clock.", is_following.into(), false),
    ];
    parameters.extend(of_qos("/parameter_events", "publisher", &QosProfile::PARAMETER_EVENTS));
    if has_followed {
        parameters.extend(of_qos("/clock", "subscription", &QosProfile::CLOCK));
    }
    parameters
}

/// As `rclcpp/detail/qos_parameters.hpp` declares them (branch jazzy), and `rmw/src/qos_string_conversions.c` writes them.
fn of_qos<'a>(topic: &'a str, entity: &'a str, qos: &QosProfile) -> impl Iterator<Item = SettingInfo> + 'a {
    let (history, depth) = match qos.history {
        History::KeepLast(depth) => ("keep_last", i64::from(depth)),
        History::KeepAll => ("keep_all", 0),
    };
    let durability = match qos.durability {
        Durability::Volatile => "volatile",
        Durability::TransientLocal => "transient_local",
    };
    let reliability = match qos.reliability {
        Reliability::Reliable => "reliable",
        Reliability::BestEffort => "best_effort",
    };
    let word = |word: &str| SettingValue::Text(word.to_owned());
    let policies = [
        ("depth", depth.into()),
        ("durability", word(durability)),
        ("history", word(history)),
        ("reliability", word(reliability)),
    ];
    policies.into_iter().map(move |(policy, value)| {
        let description = format!("qos policy {{{policy}}} for {entity} {{{topic}}}");
        parameter(&format!("qos_overrides.{topic}.{entity}.{policy}"), &description, value, true)
    })
}

fn parameter(name: &str, description: &str, value: SettingValue, is_read_only: bool) -> SettingInfo {
    let (name, description) = (name.to_owned(), description.to_owned());
    SettingInfo { name, description, value, range: None, is_read_only }
}
