//! The parameters that every node of rclcpp declares by itself.

use downbeat_executor::{SettingInfo, SettingValue};
use downbeat_msgs::qos::{QosProfile, Word};

/// Whether time is that of `/clock`.
pub(super) const USE_SIM_TIME: &str = "use_sim_time";

/// The parameters of a node; `has_followed` if it has subscribed to `/clock` at some time.
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

/// As `rclcpp/detail/qos_parameters.hpp` declares them (branch jazzy), and `rmw/src/qos_string_conversions.c`
/// writes them.
fn of_qos<'a>(topic: &'a str, entity: &'a str, qos: &QosProfile) -> impl Iterator<Item = SettingInfo> + 'a {
    let word = |word: &str| SettingValue::Text(word.to_owned());
    let policies = [
        ("depth", i64::from(qos.history.depth().unwrap_or(0)).into()),
        ("durability", word(qos.durability.name())),
        ("history", word(qos.history.name())),
        ("reliability", word(qos.reliability.name())),
    ];
    policies.into_iter().map(move |(policy, value)| {
        let description = format!("qos policy {{{policy}}} for {entity} {{{topic}}}");
        parameter(&format!("qos_overrides.{topic}.{entity}.{policy}"), &description, value, true)
    })
}

fn parameter(name: &str, description: &str, value: SettingValue, is_read_only: bool) -> SettingInfo {
    let (name, description) = (name.to_owned(), description.to_owned());
    SettingInfo { name, description, value, range: None, choices: Vec::new(), is_read_only }
}
