//! Named numbers in messages: what a state or an action consists of.

use downbeat_msgs::dynamic::{Array, DynamicMessage, ValueRef};

use crate::table::{ELEMENT_NAMES, number, numbers_of};

/// The most numbers of a state or an action.
pub(super) const MOST_NUMBERS: usize = 1000;

/// Short names of the arrays of `JointState`, as LeRobot calls what motors have.
const SHORT: [(&str, &str); 3] = [("position", "pos"), ("velocity", "vel"), ("effort", "eff")];

/// The numbers in these fields of a message, with their names: of the array `position`, beside which
/// `name` names the elements, `shoulder_pan.pos`; of another array `data[3]`. Without fields those of
/// `position` if there are names, else all, without those of headers. There may be one more than
/// [`MOST_NUMBERS`], of very many.
///
/// # Errors
/// What is wrong with a field.
pub(super) fn numbers(message: &DynamicMessage, fields: &[String]) -> Result<Vec<(String, f64)>, String> {
    let mut found = Vec::new();
    let chosen = match fields {
        [] if names_beside(message, "position").is_some() => vec!["position".to_owned()],
        [] => numbers_of(message, MOST_NUMBERS + 1).into_iter().map(|number| number.field).collect(),
        fields => fields.to_vec(),
    };
    for field in &chosen {
        if fields.is_empty() && field.split('.').any(|part| part == "header") {
            continue;
        }
        match message.get(field).map_err(|error| error.to_string())? {
            ValueRef::Array(array) => {
                let names = names_beside(message, field).unwrap_or_default();
                for (index, value) in array.iter().enumerate().take(MOST_NUMBERS + 1) {
                    let Some(value) = number(value) else {
                        return Err(format!("{field} is an array of something else than numbers"));
                    };
                    let name = names.get(index).map(|name| named(name, field));
                    found.push((name.unwrap_or_else(|| format!("{field}[{index}]")), value));
                }
            }
            value => match number(value) {
                Some(value) => found.push((field.clone(), value)),
                None => return Err(format!("{field} is no number and no array of numbers")),
            },
        }
    }
    Ok(found)
}

fn named(element: &str, field: &str) -> String {
    let last = field.rsplit('.').next().unwrap_or(field);
    let short = SHORT.iter().find(|(long, _)| *long == last).map_or(last, |(_, short)| short);
    format!("{element}.{short}")
}

/// The name of the joint and the array of `JointState` that a name stands for: the reverse of [`numbers`].
pub(super) fn joint_of(name: &str) -> (&str, &'static str) {
    let known = name.rsplit_once('.').and_then(|(joint, short)| {
        SHORT.iter().find(|(_, known)| *known == short).map(|(long, _)| (joint, *long))
    });
    known.unwrap_or((name, SHORT[0].0))
}

/// The texts that name the elements of an array, if the message has them beside it.
fn names_beside<'a>(message: &'a DynamicMessage, field: &str) -> Option<&'a [String]> {
    let parent = field.rfind('.').map_or("", |end| &field[..=end]);
    ELEMENT_NAMES.iter().find_map(|array| match message.get(&format!("{parent}{array}")) {
        Ok(ValueRef::Array(Array::String(names))) if message.get(field).is_ok() => Some(names.as_slice()),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use downbeat_msgs::dynamic::DynamicType;

    fn joint_states() -> DynamicMessage {
        let text = "string[] name\nfloat64[] position\nfloat64[] velocity\n";
        let of = DynamicType::from_definition_text("my_msgs/msg/Joints", "ros2msg", text).unwrap();
        let mut message = DynamicMessage::new(&of);
        message.set("name", vec!["pan".to_owned(), "tilt".to_owned()]).unwrap();
        message.set("position", vec![0.5, f64::NAN]).unwrap();
        message.set("velocity", vec![1.0, 2.0]).unwrap();
        message
    }

    fn fields(fields: &[&str]) -> Vec<String> {
        fields.iter().map(|field| (*field).to_owned()).collect()
    }

    #[test]
    fn numbers_of_joints_have_the_names_of_lerobot() {
        let found = numbers(&joint_states(), &[]).unwrap();
        assert_eq!(found[0], ("pan.pos".to_owned(), 0.5));
        assert!(found[1].0 == "tilt.pos" && found[1].1.is_nan());
        let found = numbers(&joint_states(), &fields(&["velocity", "position[0]"])).unwrap();
        let names: Vec<_> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["pan.vel", "tilt.vel", "position[0]"]);
        assert_eq!(joint_of("pan.vel"), ("pan", "velocity"));
        assert_eq!(joint_of("x"), ("x", "position"));
    }

    #[test]
    fn a_field_that_is_no_number_is_named() {
        let error = numbers(&joint_states(), &fields(&["name"])).unwrap_err();
        assert!(error.contains("name is an array of something else"), "{error}");
        let error = numbers(&joint_states(), &fields(&["positions"])).unwrap_err();
        assert!(error.contains("positions"), "{error}");
    }
}
