//! Faults of the bus in words, for logs and diagnostics: which servo on which port at which speed, and what
//! to do.

use super::description::BusPlan;
use super::protocol::StatusError;
use super::reading::Unit;

/// A unit does not answer.
pub(crate) fn silent(plan: &BusPlan, unit: Unit) -> String {
    let (name, place) = (named(plan, unit), place(plan));
    let stale = match unit {
        Unit::Joint(_) => "; its joint is stale",
        Unit::Device(_) => "",
    };
    format!(
        "{name} does not answer on {place}{stale}. Check its power, its plugs and its id; `downbeat servo scan` shows what answers"
    )
}

/// A unit answers, but is not what is described.
pub(crate) fn unusable(plan: &BusPlan, unit: Unit, reason: &str) -> String {
    let (name, place) = (named(plan, unit), place(plan));
    format!("{name} on {place} cannot be used: {reason}; correct its description, or exchange it")
}

/// A servo has measured this, and reports these errors.
pub(crate) fn alarm(plan: &BusPlan, unit: Unit, error: StatusError, measured: &str) -> String {
    let (name, place) = (named(plan, unit), place(plan));
    format!("{name} on {place} reports: {error} ({measured}); {}", error.remedy())
}

/// A servo that is to get torque does not take it.
pub(crate) fn without_torque(plan: &BusPlan, unit: Unit, refusal: &str) -> String {
    format!("{} on {} gets no torque yet: {refusal}", named(plan, unit), place(plan))
}

/// The port does not work, which is tried again.
pub(crate) fn lost_port(plan: &BusPlan) -> String {
    let (place, servos) = (place(plan), servos(plan));
    format!(
        "lost the serial port {place} with {servos}, opening it again; check the plug and the power of the adapter"
    )
}

/// The port is closed.
pub(crate) fn closed_port(plan: &BusPlan) -> String {
    let (place, servos) = (place(plan), servos(plan));
    format!(
        "the serial port {place} with {servos} is closed, and is opened again; check the plug and the power of the adapter"
    )
}

/// The port, and its speed.
pub(crate) fn place(plan: &BusPlan) -> String {
    format!("{} at {} bit/s", plan.port, plan.line.baud)
}

/// A unit with its address.
pub(crate) fn named(plan: &BusPlan, unit: Unit) -> String {
    let what = match unit {
        Unit::Device(_) => "device",
        Unit::Joint(_) => "servo",
    };
    let (id, name) = plan.label(unit);
    format!("{what} {id} ({name})")
}

fn servos(plan: &BusPlan) -> String {
    let ids: Vec<String> = plan.joints.iter().map(|joint| joint.id.to_string()).collect();
    format!("the servos {}", ids.join(", "))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::Description;
    use super::super::bus::LineSettings;
    use super::super::protocol::{Id, Protocol};
    use super::super::tool::ServoError;
    use super::*;

    fn plan() -> BusPlan {
        let text = "name = \"arm\"\n[[bus]]\nname = \"b\"\nport = \"/dev/ttyUSB7\"\nbaud = 57600\nprotocol = \"dynamixel2\"\n\
                    cycle_ms = 10\n[[joint]]\nname = \"pan\"\nid = 5\nmodel = \"XM430-W350\"\nlimits = [-1.0, 1.0]\n";
        Description::load(text).unwrap().bus("").unwrap().clone()
    }

    /// What each error of a servo is remedied by.
    const ALARMS: [(StatusError, &str); 11] = [
        (StatusError::INPUT_VOLTAGE, "check that the supply"),
        (StatusError::POSITION_SENSOR, "exchange it"),
        (StatusError::OVERHEATING, "let it cool down"),
        (StatusError::OVERLOAD, "free its joint"),
        (StatusError::OVERCURRENT, "free its joint"),
        (StatusError::ALERT, "hardware_error_status"),
        (StatusError::ACCESS, "while torque_enable is 0"),
        (StatusError::ANGLE_LIMIT, "within its range"),
        (StatusError::RANGE, "within its range"),
        (StatusError::CHECKSUM, "look at its cable"),
        (StatusError::FAILED, "look at its cable"),
    ];

    #[test]
    fn each_text_names_port_servo_speed_and_remedy() {
        let (plan, unit, path) = (plan(), Unit::Joint(0), "/dev/ttyUSB7".to_owned());
        let (id, line) = (Id::new(5).unwrap(), LineSettings { baud: 57_600, protocol: Protocol::Dynamixel2 });
        let mut texts = vec![
            (silent(&plan, unit), "downbeat servo scan"),
            (unusable(&plan, unit, "it is model 1"), "correct its description"),
            (
                without_torque(&plan, unit, &format!("it answers: {}", StatusError::ACCESS.remedy())),
                "torque_enable",
            ),
            (lost_port(&plan), "check the plug"),
            (closed_port(&plan), "check the plug"),
        ];
        for (error, remedy) in ALARMS {
            texts.push((alarm(&plan, unit, error, "12.1 V"), remedy));
            let (path, doing) = (path.clone(), "write goal_position".to_owned());
            texts.push((ServoError::Refused { path, line, id, doing, error }.to_string(), remedy));
        }
        let [found, described] = ["STS3215", "XM430-W350"].map(str::to_owned);
        let errors = [
            (ServoError::Silent { path: path.clone(), id, line }, "downbeat servo scan"),
            (ServoError::UnknownModel { path: path.clone(), line, id, number: Some(9) }, "--model-file"),
            (
                ServoError::OtherModel { path: path.clone(), line, id, described, found },
                "correct its model in the description",
            ),
            (
                ServoError::Unsuitable {
                    path,
                    id,
                    name: "pan".into(),
                    line,
                    reason: "it turns without end".into(),
                },
                "correct its description",
            ),
        ];
        texts.extend(errors.map(|(error, remedy)| (error.to_string(), remedy)));
        for (text, remedy) in texts {
            for part in ["/dev/ttyUSB7", "57600 bit/s", remedy] {
                assert!(text.contains(part), "{part:?} is not in {text:?}");
            }
            assert!(["id 5", "servo 5 (pan)", "servos 5"].iter().any(|id| text.contains(id)), "{text}");
        }
    }
}
