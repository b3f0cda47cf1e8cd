//! Types whose fields do not correspond one to one.

use super::path::Object;
use crate::interchange::{Problem, Value};

/// Conversions beyond equal fields. `to_foxglove` runs after equal fields are moved, `to_ros` before.
pub(super) struct Special {
    pub(super) to_foxglove: fn(&mut Object<'_, '_>, &mut Object<'_, '_>) -> Result<(), Problem>,
    pub(super) to_ros: fn(&mut Object<'_, '_>, &mut Object<'_, '_>) -> Result<(), Problem>,
}

/// Severities of ROS 2 are ten times those of Foxglove.
pub(super) const LOG: Special = Special {
    to_foxglove: |ros, foxglove| {
        let level = (ros.unsigned("level")? / 10).min(5);
        foxglove.put("level", Value::Unsigned(level))
    },
    to_ros: |foxglove, ros| {
        let level = foxglove.unsigned("level")?.min(5) * 10;
        ros.put("level", Value::Unsigned(level))
    },
};

pub(super) const IMAGE: Special = Special {
    to_foxglove: |ros, foxglove| {
        let encoding = foxglove.text("encoding")?;
        // Names of encodings contain the bits of a channel: `mono16`, `16UC1`, `32FC1`, `bayer_rggb16`.
        let has_long_channels = ["16", "32", "64"].iter().any(|bits| encoding.contains(bits));
        if ros.unsigned("is_bigendian")? != 0 && has_long_channels {
            let text = format!("pixels of encoding {encoding} must be little-endian for Foxglove");
            return Err(Problem::new(text).in_field("is_bigendian"));
        }
        Ok(())
    },
    to_ros: |_, _| Ok(()),
};

/// `jpeg` from `rgb8; jpeg compressed bgr8`.
pub(super) const COMPRESSED_IMAGE: Special = Special {
    to_foxglove: |ros, foxglove| {
        let said = ros.text("format")?;
        // Depth images start with an additional header, so they are not PNG.
        let known = ["jpeg", "png", "webp", "avif"].into_iter().find(|format| said.contains(format));
        let format = match known {
            Some(format) if !said.contains("compressedDepth") => format.to_owned(),
            None if said.contains("jpg") => "jpeg".to_owned(),
            _ => said,
        };
        foxglove.put("format", Value::Text(format.into()))
    },
    to_ros: |foxglove, ros| {
        let format = foxglove.text("format")?;
        ros.put("format", Value::Text(format.into()))
    },
};

pub(super) const LASER_SCAN: Special = Special {
    to_foxglove: |_, foxglove| put_identity(foxglove),
    to_ros: |foxglove, ros| {
        check_identity(foxglove)?;
        let (start, end) = (foxglove.float("start_angle")?, foxglove.float("end_angle")?);
        let steps = match foxglove.field("ranges")?.1 {
            Value::Packed(ranges) => (ranges.len() / 8).saturating_sub(1),
            _ => 0,
        };
        let increment = if steps == 0 { 0.0 } else { (end - start) / steps as f64 };
        ros.put("angle_increment", Value::Float32(increment as f32))
    },
};

/// Lists of names and values become a list of joints. Lists as long as that of the names are preserved.
pub(super) const JOINT_STATE: Special = Special {
    to_foxglove: |ros, foxglove| {
        let names = ros.take_list("name")?.1;
        let mut columns = Vec::new();
        for column in ["position", "velocity", "effort"] {
            let numbers = ros.take_packed(column)?;
            let numbers: Vec<f64> =
                numbers.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
            if !numbers.is_empty() && numbers.len() != names.len() {
                let text = format!("has {} elements, but there are {} names", numbers.len(), names.len());
                return Err(Problem::new(text).in_field(column));
            }
            columns.push(numbers);
        }
        let joints = names.into_iter().enumerate().map(|(index, name)| {
            let value = |column: usize| {
                columns.get(column).and_then(|numbers: &Vec<f64>| numbers.get(index)).copied()
            };
            let number = |column| value(column).map_or(Value::Absent, Value::Float64);
            // Name, position, velocity, acceleration, effort.
            let name = match name {
                Value::Text(text) => Value::Text(text.into_owned().into()),
                other => return Err(Problem::new(format!("{other:?} is not a name"))),
            };
            Ok(Value::Record(vec![name, number(0), number(1), Value::Absent, number(2)]))
        });
        foxglove.put("joints", Value::List(joints.collect::<Result<_, _>>()?))
    },
    to_ros: |foxglove, ros| {
        let joints = foxglove.take_list("joints")?.1;
        let (mut names, mut columns) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
        let count = joints.len();
        for (index, joint) in joints.into_iter().enumerate() {
            let Value::Record(fields) = joint else {
                return Err(Problem::new("is not a joint").in_field("joints"));
            };
            let [Value::Text(name), position, velocity, _, effort] = &fields[..] else {
                return Err(Problem::new("is not a joint").at_index(index).in_field("joints"));
            };
            names.push(Value::Text(name.to_string().into()));
            for (column, value) in columns.iter_mut().zip([position, velocity, effort]) {
                if let Value::Float64(value) = value {
                    column.extend(value.to_le_bytes());
                }
            }
        }
        ros.put("name", Value::List(names))?;
        for (name, column) in ["position", "velocity", "effort"].into_iter().zip(columns) {
            // In ROS 2 either all joints have a value or none.
            if !column.is_empty() && column.len() != count * 8 {
                let text = "some joints have it and some do not, which ROS 2 cannot express";
                return Err(Problem::new(text).in_field(name));
            }
            ros.put(name, Value::Packed(column.into()))?;
        }
        Ok(())
    },
};

pub(super) const POINT_CLOUD: Special =
    Special { to_foxglove: super::point_cloud::to_foxglove, to_ros: super::point_cloud::to_ros };

/// Sets the identity pose.
pub(super) fn put_identity(foxglove: &mut Object<'_, '_>) -> Result<(), Problem> {
    foxglove.put("pose.orientation.w", Value::Float64(1.0))
}

/// Checks that the pose is the identity, since the ROS 2 message has no pose. A missing pose is the identity.
pub(super) fn check_identity(foxglove: &mut Object<'_, '_>) -> Result<(), Problem> {
    let w = foxglove.float("pose.orientation.w")?;
    let names = ["position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z"];
    let mut is_elsewhere = w != 0.0 && w.abs() != 1.0;
    for name in names {
        is_elsewhere |= foxglove.float(&format!("pose.{name}"))? != 0.0;
    }
    if is_elsewhere {
        return Err(
            Problem::new("is not the identity, which the ROS 2 message cannot express").in_field("pose")
        );
    }
    Ok(())
}
