//! Foxglove's schemas: names, Protobuf numbers, FlatBuffers ids.

use crate::interchange::{Enumeration, Field, Kind, Record, Schema, Shape};

/// The type of a field.
#[derive(Clone, Copy)]
enum Type {
    U32,
    F64,
    /// With its default in FlatBuffers.
    F64Or(f64),
    OptionalF64,
    F64s,
    Text,
    Bytes,
    Time,
    /// Name in Protobuf, name in FlatBuffers, values.
    Enumeration(&'static str, &'static str, &'static [&'static str]),
    Record(&'static str),
    OptionalRecord(&'static str),
    Records(&'static str),
}

use Type::{Bytes, F64, F64Or, F64s, OptionalF64, OptionalRecord, Records, Text, Time, U32};

/// Name, number, id, type.
type Row = (&'static str, u32, u16, Type);

const NUMERIC_TYPE: Type = Type::Enumeration(
    "NumericType",
    "foxglove.NumericType",
    &["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"],
);
const COVARIANCE_TYPE: Type = Type::Enumeration(
    "PositionCovarianceType",
    "foxglove.PositionCovarianceType",
    &["UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN"],
);
const LEVEL: Type = Type::Enumeration(
    "Level",
    "foxglove.LogLevel",
    &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"],
);

const TIMESTAMP: Row = ("timestamp", 1, 0, Time);
const POSE: Type = Type::Record("foxglove.Pose");
const VECTOR3: Type = Type::Record("foxglove.Vector3");

/// Fields in the order in which FlatBuffers and the `.proto` files declare them.
const RECORDS: &[(&str, &[Row])] = &[
    (
        "foxglove.CameraCalibration",
        &[
            TIMESTAMP,
            ("frame_id", 9, 1, Text),
            ("width", 2, 2, U32),
            ("height", 3, 3, U32),
            ("distortion_model", 4, 4, Text),
            ("D", 5, 5, F64s),
            ("K", 6, 6, F64s),
            ("R", 7, 7, F64s),
            ("P", 8, 8, F64s),
        ],
    ),
    (
        "foxglove.Color",
        &[("r", 1, 0, F64Or(1.0)), ("g", 2, 1, F64Or(1.0)), ("b", 3, 2, F64Or(1.0)), ("a", 4, 3, F64Or(1.0))],
    ),
    (
        "foxglove.CompressedImage",
        &[TIMESTAMP, ("frame_id", 4, 1, Text), ("data", 2, 2, Bytes), ("format", 3, 3, Text)],
    ),
    (
        "foxglove.FrameTransform",
        &[
            TIMESTAMP,
            ("parent_frame_id", 2, 1, Text),
            ("child_frame_id", 3, 2, Text),
            ("translation", 4, 3, VECTOR3),
            ("rotation", 5, 4, Type::Record("foxglove.Quaternion")),
        ],
    ),
    ("foxglove.FrameTransforms", &[("transforms", 1, 0, Records("foxglove.FrameTransform"))]),
    (
        "foxglove.JointState",
        &[
            ("name", 1, 0, Text),
            ("position", 2, 1, OptionalF64),
            ("velocity", 3, 2, OptionalF64),
            ("acceleration", 4, 3, OptionalF64),
            ("effort", 5, 4, OptionalF64),
        ],
    ),
    ("foxglove.JointStates", &[TIMESTAMP, ("joints", 2, 1, Records("foxglove.JointState"))]),
    ("foxglove.KeyValuePair", &[("key", 1, 0, Text), ("value", 2, 1, Text)]),
    (
        "foxglove.LaserScan",
        &[
            TIMESTAMP,
            ("frame_id", 2, 1, Text),
            ("pose", 3, 2, POSE),
            ("start_angle", 4, 3, F64),
            ("end_angle", 5, 4, F64),
            ("ranges", 6, 5, F64s),
            ("intensities", 7, 6, F64s),
        ],
    ),
    (
        "foxglove.LocationFix",
        &[
            ("timestamp", 6, 0, Time),
            ("frame_id", 7, 1, Text),
            ("latitude", 1, 2, F64),
            ("longitude", 2, 3, F64),
            ("altitude", 3, 4, F64),
            ("position_covariance", 4, 5, F64s),
            ("position_covariance_type", 5, 6, COVARIANCE_TYPE),
            ("heading", 10, 9, OptionalF64),
            ("velocity", 11, 10, OptionalRecord("foxglove.Vector3")),
            ("color", 8, 7, OptionalRecord("foxglove.Color")),
            ("metadata", 9, 8, Records("foxglove.KeyValuePair")),
        ],
    ),
    (
        "foxglove.Log",
        &[
            TIMESTAMP,
            ("level", 2, 1, LEVEL),
            ("message", 3, 2, Text),
            ("name", 4, 3, Text),
            ("file", 5, 4, Text),
            ("line", 6, 5, U32),
        ],
    ),
    (
        "foxglove.Odometry",
        &[
            TIMESTAMP,
            ("frame_id", 2, 1, Text),
            ("body_frame_id", 3, 2, Text),
            ("pose", 4, 3, POSE),
            ("linear_velocity", 5, 4, OptionalRecord("foxglove.Vector3")),
            ("angular_velocity", 6, 5, OptionalRecord("foxglove.Vector3")),
            ("pose_covariance", 7, 6, F64s),
            ("velocity_covariance", 8, 7, F64s),
            ("metadata", 9, 8, Records("foxglove.KeyValuePair")),
        ],
    ),
    (
        "foxglove.PackedElementField",
        &[("name", 1, 0, Text), ("offset", 2, 1, U32), ("type", 3, 2, NUMERIC_TYPE)],
    ),
    ("foxglove.Point3", &[("x", 1, 0, F64), ("y", 2, 1, F64), ("z", 3, 2, F64)]),
    (
        "foxglove.Point3InFrame",
        &[TIMESTAMP, ("frame_id", 2, 1, Text), ("point", 3, 2, Type::Record("foxglove.Point3"))],
    ),
    (
        "foxglove.PointCloud",
        &[
            TIMESTAMP,
            ("frame_id", 2, 1, Text),
            ("pose", 3, 2, POSE),
            ("point_stride", 4, 3, U32),
            ("fields", 5, 4, Records("foxglove.PackedElementField")),
            ("data", 6, 5, Bytes),
        ],
    ),
    (
        "foxglove.Pose",
        &[("position", 1, 0, VECTOR3), ("orientation", 2, 1, Type::Record("foxglove.Quaternion"))],
    ),
    ("foxglove.PoseInFrame", &[TIMESTAMP, ("frame_id", 2, 1, Text), ("pose", 3, 2, POSE)]),
    (
        "foxglove.PosesInFrame",
        &[TIMESTAMP, ("frame_id", 2, 1, Text), ("poses", 3, 2, Records("foxglove.Pose"))],
    ),
    ("foxglove.Quaternion", &[("x", 1, 0, F64), ("y", 2, 1, F64), ("z", 3, 2, F64), ("w", 4, 3, F64Or(1.0))]),
    (
        "foxglove.RawImage",
        &[
            TIMESTAMP,
            ("frame_id", 7, 1, Text),
            ("width", 2, 2, U32),
            ("height", 3, 3, U32),
            ("encoding", 4, 4, Text),
            ("step", 5, 5, U32),
            ("data", 6, 6, Bytes),
        ],
    ),
    ("foxglove.Vector3", &[("x", 1, 0, F64), ("y", 2, 1, F64), ("z", 3, 2, F64)]),
];

/// The schema of that name with the records it needs; `None` if there is none.
pub(super) fn schema(name: &str) -> Option<Schema> {
    let mut schema = Schema::default();
    add(&mut schema, name)?;
    Some(schema)
}

fn add(schema: &mut Schema, name: &str) -> Option<usize> {
    if let Some(index) = schema.records.iter().position(|record| record.name == name) {
        return Some(index);
    }
    let (_, rows) = RECORDS.iter().find(|(record, _)| *record == name)?;
    let index = schema.records.len();
    schema.records.push(Record { name: name.into(), fields: Vec::new(), least_size: 1 });
    for &(field_name, number, id, of) in *rows {
        let (kind, shape) = match of {
            Type::U32 => (Kind::Fixed32, Shape::Single),
            Type::F64 | Type::F64Or(_) => (Kind::Float64, Shape::Single),
            Type::OptionalF64 => (Kind::Float64, Shape::Single),
            Type::F64s => (Kind::Float64, Shape::Sequence),
            Type::Text => (Kind::Text { bound: None }, Shape::Single),
            Type::Bytes => (Kind::UInt8, Shape::Sequence),
            Type::Time => (Kind::Time, Shape::Single),
            Type::Enumeration(nested_name, name, values) => {
                schema.enumerations.push(Enumeration { owner: index, nested_name, name, values });
                (Kind::Enumeration(schema.enumerations.len() - 1), Shape::Single)
            }
            Type::Record(inner) => (Kind::Record(add(schema, inner)?), Shape::Single),
            Type::OptionalRecord(inner) => (Kind::Record(add(schema, inner)?), Shape::Single),
            Type::Records(inner) => (Kind::Record(add(schema, inner)?), Shape::Sequence),
        };
        let default = if let Type::F64Or(default) = of { default } else { 0.0 };
        schema.records[index].fields.push(Field {
            name: field_name.into(),
            number,
            id,
            kind,
            shape,
            is_optional: matches!(of, Type::OptionalF64 | Type::OptionalRecord(_)),
            default,
            initial: None,
        });
    }
    Some(index)
}
