//! What a line of the settings says about a topic.

use std::str::FromStr;
use std::time::Duration;

use downbeat_msgs::encoding::Encoding;

/// One topic of the robot and where it is on the broker: `TOPIC TYPE MQTT_TOPIC`, and options.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Route {
    pub(super) topic: String,
    pub(super) type_name: String,
    /// A topic or, when receiving, a filter.
    pub(super) remote: String,
    pub(super) encoding: Encoding,
    pub(super) qos: u8,
    pub(super) is_retained: bool,
    /// The shortest time between two messages.
    pub(super) period: Option<Duration>,
}

/// Which way messages go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Out,
    In,
}

impl Route {
    pub(super) fn parse(text: &str, way: Way) -> Result<Self, String> {
        let refuse = |reason: String| format!("{text:?}: {reason}");
        let mut words = text.split_whitespace();
        let (Some(topic), Some(type_name), Some(remote)) = (words.next(), words.next(), words.next()) else {
            return Err(refuse(
                "it has to begin with a topic, its type and the topic on the broker".to_owned(),
            ));
        };
        check(remote, way).map_err(refuse)?;
        let mut route = Self {
            topic: topic.to_owned(),
            type_name: type_name.to_owned(),
            remote: remote.to_owned(),
            encoding: Encoding::Json,
            qos: 0,
            is_retained: false,
            period: None,
        };
        for word in words {
            match (word, way) {
                ("json", _) => route.encoding = Encoding::Json,
                ("cbor", _) => route.encoding = Encoding::Cbor,
                ("qos0", _) => route.qos = 0,
                ("qos1", _) => route.qos = 1,
                ("qos2", _) => route.qos = 2,
                ("retain", Way::Out) => route.is_retained = true,
                (_, Way::Out) if word.starts_with("hz=") => {
                    let rate = word.strip_prefix("hz=").and_then(|rate| f64::from_str(rate).ok());
                    let Some(rate) = rate.filter(|rate| (0.001..=1000.0).contains(rate)) else {
                        return Err(refuse(format!("{word:?} is no rate from hz=0.001 to hz=1000")));
                    };
                    route.period = Some(Duration::from_secs_f64(1.0 / rate));
                }
                _ => {
                    let known = match way {
                        Way::Out => "json, cbor, qos0, qos1, qos2, retain, hz=RATE",
                        Way::In => "json, cbor, qos0, qos1, qos2",
                    };
                    return Err(refuse(format!("unknown option {word:?}; there are {known}")));
                }
            }
        }
        Ok(route)
    }
}

/// Checks a topic or a filter by the rules of MQTT 5, 4.7.
fn check(remote: &str, way: Way) -> Result<(), String> {
    if remote.len() > usize::from(u16::MAX) || remote.contains('\0') {
        return Err("a topic on a broker has at most 65535 bytes and no NUL".to_owned());
    }
    let mut levels = remote.split('/').peekable();
    while let Some(level) = levels.next() {
        match (level, way) {
            ("+", Way::In) => {}
            ("#", Way::In) if levels.peek().is_none() => {}
            _ if !level.contains(['+', '#']) => {}
            (_, Way::In) => {
                return Err(format!("in {remote:?}, + has to be a whole level and # the last one"));
            }
            (_, Way::Out) => return Err(format!("{remote:?} is a filter; messages are sent to one topic")),
        }
    }
    Ok(())
}

/// Whether a filter selects a topic (MQTT 5, 4.7.1 and 4.7.2).
pub(super) fn selects(filter: &str, topic: &str) -> bool {
    if topic.starts_with('$') && filter.starts_with(['+', '#']) {
        return false;
    }
    let mut levels = topic.split('/');
    for wanted in filter.split('/') {
        if wanted == "#" {
            return true;
        }
        match levels.next() {
            Some(level) if wanted == "+" || wanted == level => {}
            _ => return false,
        }
    }
    levels.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_topics_type_and_options() {
        let route = Route::parse(
            "battery sensor_msgs/msg/BatteryState robot/battery cbor qos1 retain hz=2",
            Way::Out,
        );
        let expected = Route {
            topic: "battery".to_owned(),
            type_name: "sensor_msgs/msg/BatteryState".to_owned(),
            remote: "robot/battery".to_owned(),
            encoding: Encoding::Cbor,
            qos: 1,
            is_retained: true,
            period: Some(Duration::from_millis(500)),
        };
        assert_eq!(route, Ok(expected));
    }

    #[test]
    fn wrong_lines_are_refused_with_the_reason() {
        for (line, way, reason) in [
            ("battery sensor_msgs/msg/BatteryState", Way::Out, "begin with a topic"),
            ("a b robot/+", Way::Out, "is a filter"),
            ("a b robot/#/c", Way::In, "# the last one"),
            ("a b robot/c+", Way::In, "+ has to be a whole level"),
            ("a b c retain", Way::In, "unknown option"),
            ("a b c hz=0", Way::Out, "no rate"),
            ("a b c hz=NaN", Way::Out, "no rate"),
        ] {
            let refused = Route::parse(line, way).expect_err(line);
            assert!(refused.contains(reason), "{refused}");
        }
    }

    #[test]
    fn filters_select_as_the_standard_says() {
        // The examples of MQTT 5, 4.7.1.2 and 4.7.1.3.
        for (filter, topic, is_selected) in [
            ("sport/tennis/player1/#", "sport/tennis/player1", true),
            ("sport/tennis/player1/#", "sport/tennis/player1/score/wimbledon", true),
            ("#", "é", true),
            ("sport/tennis/+", "sport/tennis/player1", true),
            ("sport/tennis/+", "sport/tennis/player1/ranking", false),
            ("sport/+", "sport", false),
            ("sport/+", "sport/", true),
            ("+/+", "/finance", true),
            ("+", "/finance", false),
            ("#", "$SYS/uptime", false),
            ("$SYS/#", "$SYS/uptime", true),
        ] {
            assert_eq!(selects(filter, topic), is_selected, "{filter} {topic}");
        }
    }
}
