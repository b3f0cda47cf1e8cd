//! Point clouds: rows of points with padding in ROS 2, points without padding in Foxglove.

use std::borrow::Cow;

use super::path::Object;
use super::special::{check_identity, put_identity};
use crate::interchange::{Problem, Value};

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
