//! Changes of a description of servos, which keep its comments and order.

use anyhow::Context;
use downbeat_servos::servo_bus::{JointCalibration, JointOffset};
use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, value};

/// The text with what calibration found of a joint.
pub(super) fn with_calibration(text: &str, found: &JointCalibration) -> anyhow::Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let joint = joint(&mut document, &found.name)?;
    // It is part of the new zero.
    joint.remove("offset");
    set(joint, "zero", value(found.zero));
    set(joint, "sign", value(found.sign));
    if let Some(limits) = found.limits {
        set(joint, "limits", value(limits.into_iter().collect::<Array>()));
    }
    if let Some(offset) = found.homing_offset {
        // Otherwise the next run writes the old one, and the zero is wrong.
        let registers = joint.entry("registers").or_insert_with(|| value(InlineTable::new()));
        let registers = registers.as_table_like_mut().context("\"registers\" is no table")?;
        registers.insert("homing_offset", value(offset));
    }
    Ok(document.to_string())
}

/// The text with a joint whose offset is larger by this.
pub(super) fn with_offset(text: &str, found: &JointOffset) -> anyhow::Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let joint = joint(&mut document, &found.name)?;
    let before = joint.get("offset").and_then(|offset| offset.as_integer()).unwrap_or_default();
    set(joint, "offset", value(before + found.steps));
    Ok(document.to_string())
}

/// The table of a joint.
fn joint<'a>(document: &'a mut DocumentMut, name: &str) -> anyhow::Result<&'a mut Table> {
    let joints = document.get_mut("joint").and_then(|joints| joints.as_array_of_tables_mut());
    let joints = joints.context("the description has no [[joint]]")?;
    let is_it = |known: Option<&str>| known == Some(name);
    let joint = joints.iter_mut().find(|joint| is_it(joint.get("name").and_then(|name| name.as_str())));
    joint.with_context(|| format!("the description has no joint \"{name}\""))
}

/// Sets a key, and keeps the comment behind its value.
fn set(table: &mut Table, key: &str, new: Item) {
    match table.get_mut(key) {
        Some(old) => {
            let decor = old.as_value().map(|old| old.decor().clone());
            *old = new;
            if let (Some(new), Some(decor)) = (old.as_value_mut(), decor) {
                *new.decor_mut() = decor;
            }
        }
        None => drop(table.insert(key, new)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_what_was_found_changes() {
        let text = "# An arm.\nname = \"arm\"\n\n[[joint]]\nname = \"pan\"  # left and right\nid = 1\nlimits = [-1.9, 1.9]  # rad\n\
                    offset = 12\n\n[[joint]]\nname = \"tilt\"\nid = 2\nlimits = [-1.0, 1.0]\nsign = -1\n";
        let found = |name: &str, limits| JointCalibration {
            name: name.to_owned(),
            zero: 2100,
            sign: 1,
            limits,
            homing_offset: None,
        };
        let calibrated = with_calibration(text, &found("tilt", None)).unwrap();
        let calibrated = with_calibration(&calibrated, &found("pan", Some([-1.25, 1.0]))).unwrap();
        let expected = "# An arm.\nname = \"arm\"\n\n[[joint]]\nname = \"pan\"  # left and right\nid = 1\nlimits = [-1.25, 1.0]  # rad\n\
                        zero = 2100\nsign = 1\n\n[[joint]]\nname = \"tilt\"\nid = 2\nlimits = [-1.0, 1.0]\nsign = 1\nzero = 2100\n";
        assert_eq!(calibrated, expected);
        let of_pan = JointCalibration { homing_offset: Some(-7), ..found("pan", None) };
        let registers = |text: &str| with_calibration(text, &of_pan).unwrap();
        assert!(registers(text).contains("registers = { homing_offset = -7 }\n"));
        let described = text.replace("offset = 12", "registers = { homing_offset = 3, torque_limit = 500 }");
        assert!(registers(&described).contains("registers = { homing_offset = -7, torque_limit = 500 }"));
        let unknown = with_calibration(text, &found("roll", None)).unwrap_err().to_string();
        assert!(unknown.contains("no joint \"roll\""), "{unknown}");
        let moved =
            |name: &str| JointOffset { name: name.to_owned(), reference: 0.0, steps: -20, angle: 0.0 };
        let tuned = with_offset(&with_offset(text, &moved("pan")).unwrap(), &moved("tilt")).unwrap();
        assert_eq!(
            tuned,
            text.replace("offset = 12", "offset = -8").replace("sign = -1\n", "sign = -1\noffset = -20\n")
        );
    }
}
