//! Types whose fields do not correspond one to one.

use std::borrow::Cow;

use super::object::Object;
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

pub(super) const POINT_CLOUD: Special = Special { to_foxglove, to_ros };

/// Sets the identity pose.
fn put_identity(foxglove: &mut Object<'_, '_>) -> Result<(), Problem> {
    foxglove.put("pose.orientation.w", Value::Float64(1.0))
}

/// Checks that the pose is the identity, since the ROS 2 message has no pose. A missing pose is the identity.
fn check_identity(foxglove: &mut Object<'_, '_>) -> Result<(), Problem> {
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

/// For each numeric type of `sensor_msgs/msg/PointField`, starting at 1: Foxglove's number, and its size.
const TYPES: [(u64, u64); 8] = [(2, 1), (1, 1), (4, 2), (3, 2), (6, 4), (5, 4), (7, 4), (8, 8)];

/// Maximum number of values in a point: the longest descriptors have a few hundred.
const MOST_FIELDS: u64 = 4096;

pub(super) fn to_foxglove(ros: &mut Object<'_, '_>, foxglove: &mut Object<'_, '_>) -> Result<(), Problem> {
    put_identity(foxglove)?;
    let is_bigendian = ros.unsigned("is_bigendian")? != 0;
    let stride = foxglove.unsigned("point_stride")?;
    let mut fields = Vec::new();
    for (index, field) in ros.take_list("fields")?.1.into_iter().enumerate() {
        add_field(field, is_bigendian, stride, &mut fields)
            .map_err(|problem| problem.at_index(index).in_field("fields"))?;
    }
    foxglove.put("fields", Value::List(fields))?;

    let (width, height) = (ros.unsigned("width")?, ros.unsigned("height")?);
    // 32 bits each, so that the products cannot overflow.
    let (row, padded_row) = (width * stride, ros.unsigned("row_step")?);
    let (_, data) = foxglove.field("data")?;
    let Value::Packed(bytes) = data else {
        return Err(Problem::new("is not a list of bytes").in_field("data"));
    };
    if padded_row == row || height <= 1 {
        return Ok(());
    }
    let (row, padded_row) =
        (usize::try_from(row).unwrap_or(usize::MAX), usize::try_from(padded_row).unwrap_or(usize::MAX));
    if padded_row < row || padded_row.checked_mul(height as usize).is_none_or(|size| size > bytes.len()) {
        let text = format!(
            "{height} rows of {padded_row} bytes with {row} bytes of points do not fit into {} bytes",
            bytes.len()
        );
        return Err(Problem::new(text).in_field("row_step"));
    }
    let rows = bytes.chunks_exact(padded_row).take(height as usize);
    let points: Vec<u8> = rows.flat_map(|padded| &padded[..row]).copied().collect();
    *bytes = Cow::Owned(points);
    Ok(())
}

/// A field of several values becomes one field for each value.
fn add_field<'v>(
    field: Value<'_>,
    is_bigendian: bool,
    stride: u64,
    fields: &mut Vec<Value<'v>>,
) -> Result<(), Problem> {
    let Value::Record(parts) = field else { return Err(Problem::new("is not a point field")) };
    // Name, offset, datatype, count.
    let [Value::Text(name), Value::Unsigned(offset), Value::Unsigned(datatype), Value::Unsigned(count)] =
        &parts[..]
    else {
        return Err(Problem::new("is not a point field"));
    };
    let place = usize::try_from(*datatype).ok().and_then(|datatype| datatype.checked_sub(1));
    let Some((number, size)) = place.and_then(|place| TYPES.get(place)).copied() else {
        return Err(Problem::new(format!("{datatype} is not a numeric type")).in_field("datatype"));
    };
    if is_bigendian && size > 1 {
        return Err(Problem::new("big-endian numbers, Foxglove supports little-endian only").in_field(name));
    }
    let count = (*count).max(1);
    if offset.saturating_add(count.saturating_mul(size)) > stride {
        let text = format!("{count} values of {size} bytes at {offset} exceed a point of {stride} bytes");
        return Err(Problem::new(text).in_field(name));
    }
    if count.saturating_add(fields.len() as u64) > MOST_FIELDS {
        return Err(Problem::new(format!("more than {MOST_FIELDS} values in a point")).in_field(name));
    }
    for index in 0..count {
        let name = if count == 1 { name.to_string() } else { format!("{name}[{index}]") };
        let offset = offset + index * size;
        fields.push(Value::Record(vec![
            Value::Text(name.into()),
            Value::Unsigned(offset),
            Value::Unsigned(number),
        ]));
    }
    Ok(())
}

pub(super) fn to_ros(foxglove: &mut Object<'_, '_>, ros: &mut Object<'_, '_>) -> Result<(), Problem> {
    check_identity(foxglove)?;
    let mut fields = Vec::new();
    for (index, field) in foxglove.take_list("fields")?.1.into_iter().enumerate() {
        let no_field = |text: &str| Problem::new(text).at_index(index).in_field("fields");
        let Value::Record(parts) = field else { return Err(no_field("is not a field")) };
        let [Value::Text(name), offset, Value::Unsigned(number)] = &parts[..] else {
            return Err(no_field("is not a field"));
        };
        let Some(place) = TYPES.iter().position(|(of, _)| of == number) else {
            return Err(no_field(&format!("{number} is not a numeric type of ROS 2")));
        };
        let numbers = [place as u64 + 1, 1].map(Value::Unsigned);
        let [datatype, count] = numbers;
        let offset = Value::Unsigned(offset.bits().unwrap_or(0));
        fields.push(Value::Record(vec![Value::Text(name.to_string().into()), offset, datatype, count]));
    }
    ros.put("fields", Value::List(fields))?;
    let stride = foxglove.unsigned("point_stride")?;
    let length = match foxglove.field("data")?.1 {
        Value::Packed(bytes) => bytes.len() as u64,
        _ => 0,
    };
    let width = length.checked_div(stride).unwrap_or(0);
    if width * stride != length || u32::try_from(length).is_err() {
        let text = format!("{length} bytes are not points of {stride} bytes, or too many for ROS 2");
        return Err(Problem::new(text).in_field("data"));
    }
    ros.put("height", Value::Unsigned(1))?;
    ros.put("width", Value::Unsigned(width))?;
    ros.put("row_step", Value::Unsigned(length))
}
