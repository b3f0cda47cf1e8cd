//! The numbers in a message, by their paths.

use std::borrow::Cow;
use std::collections::BTreeMap;

use downbeat_msgs::definitions::suggestion;
use downbeat_msgs::dynamic::{
    Array, DynamicMessage, DynamicType, DynamicView, FieldProblem, ValueRef, ViewError, ViewValue,
};
use serde::{Deserialize, Serialize};

use super::{MOST_ELEMENTS, Visit, visit};

/// A number in a message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NumberField {
    /// Its path: `position[3]`.
    pub field: String,
    /// The name of the element, if the message has an array of names beside the array of the number:
    /// `head_tilt`.
    pub element: Option<String>,
}

/// Arrays that name the elements of the arrays beside them: in `JointState`, and in `JointTrajectory`,
/// `MultiDOFJointState` and others.
pub const ELEMENT_NAMES: [&str; 2] = ["name", "joint_names"];

/// Lists the numbers and booleans of a message, at most `most`, in the order of its fields. Bytes, and arrays
/// of more than [`MOST_ELEMENTS`], are left out.
pub(crate) fn numbers_of(message: &DynamicMessage, most: usize) -> Vec<NumberField> {
    let mut found = Found { numbers: Vec::new(), names: BTreeMap::new(), most };
    visit(message.as_message(), &mut found);
    let Found { numbers, names, .. } = found;
    let element = |field: &str| {
        let (before, rest) = field.split_once('[')?;
        let (index, _) = rest.split_once(']')?;
        let parent = before.rfind('.').map_or("", |end| &before[..=end]);
        ELEMENT_NAMES.iter().find_map(|array| names.get(&format!("{parent}{array}[{index}]")).cloned())
    };
    numbers.into_iter().map(|field| NumberField { element: element(&field), field }).collect()
}

struct Found {
    numbers: Vec<String>,
    /// By the paths of the names.
    names: BTreeMap<String, String>,
    most: usize,
}

impl Visit for Found {
    fn leaf(&mut self, _: &[usize], path: &str, value: ValueRef<'_>) {
        match value {
            ValueRef::String(name) if path.ends_with(']') => {
                self.names.insert(path.to_owned(), name.to_owned());
            }
            value if number(value).is_some() && self.numbers.len() < self.most => {
                self.numbers.push(path.to_owned());
            }
            _ => {}
        }
    }

    fn is_whole(&mut self, _: &[usize], array: &Array) -> bool {
        matches!(array, Array::UInt8(_)) || array.len() > MOST_ELEMENTS
    }
}

/// Returns a number, or a boolean as 0 or 1. It may be NaN or infinite.
pub(crate) fn number(value: ValueRef<'_>) -> Option<f64> {
    match value {
        ValueRef::Bool(value) => Some(f64::from(u8::from(value))),
        value => value.as_f64(),
    }
}

/// Reads the finite number at a path of a message: `position[3]`, or by the name of an element,
/// `position[head_tilt]`.
///
/// # Errors
/// Returns a sentence about what is there instead.
pub(crate) fn number_at(message: &DynamicView<'_>, path: &str) -> Result<f64, String> {
    let value = message.get(&with_index(message, path)?).map_err(problem)?;
    let found = match &value {
        ViewValue::Value(value) => number(ValueRef::from(value)),
        _ => None,
    };
    found.filter(|value| value.is_finite()).ok_or_else(|| match value {
        ViewValue::Value(_) => "it is no finite number".to_owned(),
        ViewValue::Array(_) => is_array(path),
        ViewValue::Message(_) => "it is a message: select one of its fields".to_owned(),
        _ => "it is text".to_owned(),
    })
}

/// Checks that messages of a type can have a number at a path. Elements of sequences are not checked, because
/// the type does not tell how many there are.
///
/// # Errors
/// Returns a sentence about the problem, with the most similar name of a field.
pub(crate) fn check_number(of: &DynamicType, path: &str) -> Result<(), String> {
    let path = match name_in(path) {
        Some(Named { before, behind, .. }) => Cow::Owned(format!("{before}[0]{behind}")),
        None => Cow::Borrowed(path),
    };
    match DynamicMessage::new(of).get(&path) {
        Ok(value) if number(value).is_some() => Ok(()),
        Ok(ValueRef::Array(_)) => Err(is_array(&path)),
        Ok(ValueRef::Message(_)) => Err("it is a message: select one of its fields".to_owned()),
        Ok(_) => Err("it is text".to_owned()),
        Err(error) if matches!(error.problem, FieldProblem::Index { .. }) => Ok(()),
        Err(error) => Err(error.problem.to_string()),
    }
}

fn is_array(path: &str) -> String {
    format!("it is an array: select an element, such as {path}[0]")
}

fn problem(error: ViewError) -> String {
    match error {
        ViewError::Field(error) => error.problem.to_string(),
        error => error.to_string(),
    }
}

/// An element selected by its name.
struct Named<'a> {
    before: &'a str,
    name: &'a str,
    behind: &'a str,
}

/// Returns the first name in brackets.
fn name_in(path: &str) -> Option<Named<'_>> {
    let mut from = 0;
    while let Some(open) = path[from..].find('[').map(|open| from + open) {
        let close = open + path[open..].find(']')?;
        let name = &path[open + 1..close];
        if !name.is_empty() && !name.bytes().all(|byte| byte.is_ascii_digit()) {
            return Some(Named { before: &path[..open], name, behind: &path[close + 1..] });
        }
        from = close;
    }
    None
}

/// Replaces the name of an element by its index.
fn with_index<'p>(message: &DynamicView<'_>, path: &'p str) -> Result<Cow<'p, str>, String> {
    let Some(Named { before, name, behind }) = name_in(path) else { return Ok(Cow::Borrowed(path)) };
    let parent = before.rfind('.').map_or("", |end| &before[..=end]);
    let names = ELEMENT_NAMES.iter().find_map(|array| match message.get(&format!("{parent}{array}")) {
        Ok(ViewValue::Array(names)) => match names.to_array() {
            Ok(Array::String(names)) => Some(names),
            _ => None,
        },
        _ => None,
    });
    let names = names.ok_or("its elements have no names: select one by its index")?;
    match names.iter().position(|known| known == name) {
        Some(index) => Ok(Cow::Owned(format!("{before}[{index}]{behind}"))),
        None => Err(format!("no element has the name \"{name}\"{}", suggestion(name, &names))),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use downbeat_msgs::cdr;
    use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};

    use super::*;

    fn joint_state() -> JointState {
        JointState {
            name: vec!["head_pan".into(), "head_tilt".into()],
            position: vec![0.5, -0.25],
            velocity: vec![f64::NAN],
            ..JointState::default()
        }
    }

    #[test]
    fn numbers_are_read_by_index_and_by_the_name_of_an_element() {
        let (bytes, of) = (cdr::to_vec(&joint_state()), DynamicType::of::<JointState>().unwrap());
        let view = DynamicView::new(&of, &bytes).unwrap();
        assert_eq!(number_at(&view, "position[1]"), Ok(-0.25));
        assert_eq!(number_at(&view, "position[head_tilt]"), Ok(-0.25));
        assert_eq!(number_at(&view, "header.stamp.sec"), Ok(0.0));
        for (path, expected) in [
            ("position[2]", "there is no element 2, there are 2, counted from 0"),
            ("position[head_til]", "no element has the name \"head_til\", did you mean \"head_tilt\"?"),
            ("velocity[0]", "it is no finite number"),
            ("position", "it is an array: select an element, such as position[0]"),
            ("name[0]", "it is text"),
            ("header", "it is a message"),
            ("positon[0]", "did you mean `position`?"),
            ("position[", "invalid path"),
            ("", "invalid path"),
        ] {
            let error = number_at(&view, path).unwrap_err();
            assert!(error.contains(expected), "{path}: {error}");
        }
    }

    #[test]
    fn a_type_is_checked_before_there_is_a_message() {
        let of = DynamicType::of::<JointState>().unwrap();
        for path in ["position[100]", "position[head_tilt]", "header.stamp.nanosec"] {
            assert_eq!(check_number(&of, path), Ok(()));
        }
        for (path, expected) in [
            ("positon[1]", "did you mean `position`?"),
            ("positon[left]", "did you mean `position`?"),
            ("position", "such as position[0]"),
            ("header", "select one of its fields"),
            ("header.frame_id", "it is text"),
        ] {
            let error = check_number(&of, path).unwrap_err();
            assert!(error.contains(expected), "{path}: {error}");
        }
    }

    #[test]
    fn numbers_are_listed_with_the_names_of_their_elements() {
        let message = |bytes: &[u8], of: &DynamicType| DynamicMessage::from_cdr(of, bytes).unwrap();
        let of = DynamicType::of::<JointState>().unwrap();
        let found = numbers_of(&message(&cdr::to_vec(&joint_state()), &of), 100);
        let found: Vec<_> = found.iter().map(|one| (&*one.field, one.element.as_deref())).collect();
        let expected = [
            ("header.stamp.sec", None),
            ("header.stamp.nanosec", None),
            ("position[0]", Some("head_pan")),
            ("position[1]", Some("head_tilt")),
            ("velocity[0]", Some("head_pan")),
        ];
        assert_eq!(found, expected);
        let of = DynamicType::of::<Imu>().unwrap();
        let imu = message(&cdr::to_vec(&Imu::default()), &of);
        assert!(numbers_of(&imu, 100).iter().any(|one| one.field == "angular_velocity.x"));
        assert_eq!(numbers_of(&imu, 3).len(), 3);
    }
}
