//! Foxglove's own schemas, compared with the published ones, and messages as read by its libraries.

use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::geometry_msgs::msg::{
    Point, PointStamped, Pose, PoseArray, PoseStamped, Quaternion, Transform, TransformStamped, Vector3,
};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::sensor_msgs::msg::{
    CameraInfo, CompressedImage, Image, JointState, LaserScan, NavSatFix, PointCloud2, PointField,
};
use downbeat_msgs::std_msgs::msg::{ColorRGBA, Header};
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_msgs::{Message, cdr, foxglove};
use serde_json::{Value, json};
use std::fmt::Write as _;

use crate::python::{ask, hex, unhex};
use crate::types::{catalog, name};

fn header() -> Header {
    Header { stamp: Time { sec: 1_700_000_000, nanosec: 250_000_000 }, frame_id: "base".into() }
}

fn pose() -> Pose {
    Pose {
        position: Point { x: 1.0, y: 0.0, z: -2.5 },
        orientation: Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 },
    }
}

fn pose_json() -> Value {
    json!({
        "position": { "x": 1.0, "y": 0.0, "z": -2.5 },
        "orientation": { "x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8 }
    })
}

fn identity_json() -> Value {
    json!({
        "position": { "x": 0.0, "y": 0.0, "z": 0.0 },
        "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 }
    })
}

fn transform() -> TransformStamped {
    TransformStamped {
        header: header(),
        child_frame_id: "head".into(),
        transform: Transform {
            translation: Vector3 { x: 0.5, y: 0.0, z: 0.0 },
            rotation: pose().orientation,
        },
    }
}

/// A message, its expected form in Foxglove, and the result of converting it back.
struct Example {
    type_name: &'static str,
    cdr: Vec<u8>,
    /// Without its timestamp, which is that of [`header`].
    json: Value,
    back: Vec<u8>,
}

impl Example {
    fn of<T: Message>(message: &T, json: Value) -> Self {
        Self::returning(message, json, message)
    }

    fn returning<T: Message>(message: &T, json: Value, back: &T) -> Self {
        Self { type_name: T::TYPE_NAME, cdr: cdr::to_vec(message), json, back: cdr::to_vec(back) }
    }
}

fn examples() -> Vec<Example> {
    let field =
        |name: &str, offset, datatype, count| PointField { name: name.into(), offset, datatype, count };
    // Two rows of two points of eight bytes, each row padded to twenty.
    let rows: Vec<u8> = (0..40).collect();
    let points: Vec<u8> = (0..16).chain(20..36).collect();
    let cloud = PointCloud2 {
        header: header(),
        height: 2,
        width: 2,
        fields: vec![field("x", 0, PointField::FLOAT32, 1), field("rgb", 4, PointField::UINT8, 3)],
        point_step: 8,
        row_step: 20,
        data: rows,
        is_dense: true,
        ..PointCloud2::default()
    };
    let cloud_back = PointCloud2 {
        header: header(),
        height: 1,
        width: 4,
        fields: vec![
            field("x", 0, PointField::FLOAT32, 1),
            field("rgb[0]", 4, PointField::UINT8, 1),
            field("rgb[1]", 5, PointField::UINT8, 1),
            field("rgb[2]", 6, PointField::UINT8, 1),
        ],
        point_step: 8,
        row_step: 32,
        data: points.clone(),
        ..PointCloud2::default()
    };
    let scan = LaserScan {
        header: header(),
        angle_min: -0.5,
        angle_max: 0.5,
        angle_increment: 0.25,
        ranges: vec![1.0, f32::INFINITY, 2.5, 0.25, 4.0],
        intensities: vec![10.0],
        range_max: 30.0,
        ..LaserScan::default()
    };
    let mut odometry = Odometry { header: header(), child_frame_id: "body".into(), ..Odometry::default() };
    odometry.pose.pose = pose();
    odometry.pose.covariance[35] = 0.5;
    odometry.twist.twist.angular.z = 0.1;
    let mut covariance = vec![0.0; 36];
    covariance[35] = 0.5;
    let log = Log {
        stamp: header().stamp,
        level: Log::WARN,
        name: "hardware".into(),
        msg: "servo 5 is hot".into(),
        file: "servo.rs".into(),
        function: "read".into(),
        line: 42,
    };
    let state = JointState {
        header: header(),
        name: vec!["pan".into(), "tilt".into()],
        position: vec![0.0, 1.5],
        effort: vec![0.25, -0.0],
        ..JointState::default()
    };
    let image = Image {
        header: header(),
        height: 1,
        width: 2,
        encoding: "mono8".into(),
        is_bigendian: 1,
        step: 2,
        data: vec![0, 255],
    };
    let compressed = CompressedImage {
        header: header(),
        format: "rgb8; jpeg compressed bgr8".into(),
        data: vec![0xff, 0xd8],
    };
    let info = CameraInfo {
        header: header(),
        height: 480,
        width: 640,
        distortion_model: "plumb_bob".into(),
        d: vec![0.1, 0.0],
        k: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0],
        binning_x: 2,
        ..CameraInfo::default()
    };
    let fix = NavSatFix {
        header: header(),
        latitude: 51.5,
        longitude: -0.125,
        altitude: 30.0,
        position_covariance: [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0],
        position_covariance_type: NavSatFix::COVARIANCE_TYPE_DIAGONAL_KNOWN,
        ..NavSatFix::default()
    };
    let transform_json = json!({
        "parent_frame_id": "base", "child_frame_id": "head",
        "translation": { "x": 0.5, "y": 0.0, "z": 0.0 },
        "rotation": { "x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8 }
    });
    let mut stamped = transform_json.clone();
    stamped["timestamp"] = timestamp();
    vec![
        Example::returning(
            &image,
            json!({ "frame_id": "base", "width": 2, "height": 1, "encoding": "mono8", "step": 2, "data": [0, 255] }),
            &Image { is_bigendian: 0, ..image.clone() },
        ),
        Example::returning(
            &compressed,
            json!({ "frame_id": "base", "data": [255, 216], "format": "jpeg" }),
            &CompressedImage { format: "jpeg".into(), ..compressed.clone() },
        ),
        Example::returning(
            &info,
            json!({
                "frame_id": "base", "width": 640, "height": 480, "distortion_model": "plumb_bob", "D": [0.1, 0.0],
                "K": [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0], "R": vec![0.0; 9], "P": vec![0.0; 12]
            }),
            &CameraInfo { binning_x: 0, ..info.clone() },
        ),
        Example::returning(
            &cloud,
            json!({
                "frame_id": "base", "pose": identity_json(), "point_stride": 8, "data": points,
                "fields": [
                    { "name": "x", "offset": 0, "type": 7 }, { "name": "rgb[0]", "offset": 4, "type": 1 },
                    { "name": "rgb[1]", "offset": 5, "type": 1 }, { "name": "rgb[2]", "offset": 6, "type": 1 }
                ]
            }),
            &cloud_back,
        ),
        Example::returning(
            &scan,
            json!({
                "frame_id": "base", "pose": identity_json(), "start_angle": -0.5, "end_angle": 0.5,
                "ranges": [1.0, null, 2.5, 0.25, 4.0], "intensities": [10.0]
            }),
            &LaserScan { range_max: 0.0, ..scan.clone() },
        ),
        Example::of(
            &fix,
            json!({
                "frame_id": "base", "latitude": 51.5, "longitude": -0.125, "altitude": 30.0,
                "position_covariance": [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0],
                "position_covariance_type": 2, "metadata": []
            }),
        ),
        Example::returning(
            &state,
            json!({ "joints": [
                { "name": "pan", "position": 0.0, "effort": 0.25 }, { "name": "tilt", "position": 1.5, "effort": -0.0 }
            ] }),
            &JointState { header: Header { frame_id: String::new(), ..header() }, ..state.clone() },
        ),
        Example::of(&transform(), transform_json),
        Example::of(
            &TFMessage { transforms: vec![transform(), transform()] },
            json!({ "transforms": [stamped, stamped] }),
        ),
        Example::of(
            &PoseStamped { header: header(), pose: pose() },
            json!({ "frame_id": "base", "pose": pose_json() }),
        ),
        Example::of(
            &PoseArray { header: header(), poses: vec![pose(), Pose::default()] },
            json!({ "frame_id": "base", "poses": [pose_json(), identity_json()] }),
        ),
        Example::of(
            &PointStamped { header: header(), point: pose().position },
            json!({ "frame_id": "base", "point": { "x": 1.0, "y": 0.0, "z": -2.5 } }),
        ),
        Example::of(
            &odometry,
            json!({
                "frame_id": "base", "body_frame_id": "body", "pose": pose_json(),
                "linear_velocity": { "x": 0.0, "y": 0.0, "z": 0.0 },
                "angular_velocity": { "x": 0.0, "y": 0.0, "z": 0.1 },
                "pose_covariance": covariance, "velocity_covariance": vec![0.0; 36], "metadata": []
            }),
        ),
        Example::returning(
            &log,
            json!({ "level": 3, "message": "servo 5 is hot", "name": "hardware", "file": "servo.rs", "line": 42 }),
            &Log { function: String::new(), ..log.clone() },
        ),
        Example::of(&pose().position, json!({ "x": 1.0, "y": 0.0, "z": -2.5 })),
        Example::of(&pose(), pose_json()),
        Example::of(&pose().orientation, json!({ "x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8 })),
        Example::of(&Vector3 { x: 0.0, y: 7.0, z: 0.0 }, json!({ "x": 0.0, "y": 7.0, "z": 0.0 })),
        Example::of(
            &ColorRGBA { r: 1.0, g: 0.5, b: 0.0, a: 1.0 },
            json!({ "r": 1.0, "g": 0.5, "b": 0.0, "a": 1.0 }),
        ),
    ]
}

fn timestamp() -> Value {
    json!({ "seconds": 1_700_000_000, "nanos": 250_000_000 })
}

/// Lines for `witness.py`: schema and bytes of each example.
fn lines(encoding: Encoding) -> String {
    let mut lines = String::new();
    for example in examples() {
        let codec = encoding.codec(catalog(), &name(example.type_name)).unwrap();
        let bytes = codec.encode(&example.cdr).unwrap_or_else(|error| panic!("{error}"));
        writeln!(lines, "schema\t{}\t{}", codec.schema().name, hex(&codec.schema().data)).unwrap();
        writeln!(lines, "value\t{}", hex(&bytes)).unwrap();
    }
    lines
}

/// Infinity and NaN as null, and the timestamp separately.
fn seen(text: &str) -> (Value, Option<Value>) {
    let text = text.replace("Infinity", "null").replace("NaN", "null");
    let mut value: Value = serde_json::from_str(&text).unwrap();
    let timestamp = value.as_object_mut().and_then(|fields| fields.remove("timestamp"));
    (value, timestamp)
}

fn check_seen(example: &Example, text: &str) {
    let (value, stamp) = seen(text);
    assert_eq!(value, example.json, "{}", example.type_name);
    assert!(stamp.is_none_or(|stamp| stamp == timestamp()), "{}: {text}", example.type_name);
}

#[test]
fn every_type_has_an_example() {
    let examples = examples();
    for (ros, foxglove) in foxglove::types() {
        assert!(examples.iter().any(|example| example.type_name == ros), "{ros}");
        let codec = Encoding::FoxgloveProtobuf.codec(catalog(), &name(ros)).unwrap();
        assert_eq!((codec.schema().name.as_str(), foxglove::schema_name(ros)), (foxglove, Some(foxglove)));
    }
}

#[test]
fn fields_of_foxgloves_schemas_round_trip() {
    for encoding in [Encoding::FoxgloveProtobuf, Encoding::FoxgloveFlatBuffers] {
        for example in examples() {
            let codec = encoding.codec(catalog(), &name(example.type_name)).unwrap();
            let back =
                codec.decode(&codec.encode(&example.cdr).unwrap()).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(hex(&back), hex(&example.back), "{encoding} {}", example.type_name);
        }
    }
}

#[test]
fn our_protobuf_matches_foxgloves_published_schemas_in_both_directions() {
    let Some(answer) = ask("foxglove_protobuf", &lines(Encoding::FoxgloveProtobuf)) else { return };
    let examples = examples();
    assert_eq!(answer.lines().count(), examples.len());
    for (line, example) in answer.lines().zip(&examples) {
        let (message, bytes) = line.rsplit_once(", ").unwrap();
        check_seen(example, &message[1..]);
        let bytes = unhex(bytes.trim_matches(['"', ']']));
        let codec = Encoding::FoxgloveProtobuf.codec(catalog(), &name(example.type_name)).unwrap();
        assert_eq!(codec.decode(&bytes).unwrap(), example.back, "{}", example.type_name);
    }
}

#[test]
fn our_flatbuffers_match_foxgloves_published_schemas() {
    let Some(answer) = ask("foxglove_flatbuffers", &lines(Encoding::FoxgloveFlatBuffers)) else { return };
    let examples = examples();
    assert_eq!(answer.lines().count(), examples.len());
    for (line, example) in answer.lines().zip(&examples) {
        // Protobuf has upper-case names for matrices.
        let line = ["D", "K", "R", "P"].iter().fold(line.to_owned(), |line, name| {
            line.replace(&format!("\"{}\": [", name.to_lowercase()), &format!("\"{name}\": ["))
        });
        check_seen(example, &line);
    }
}

#[test]
fn values_that_foxglove_cannot_represent_are_refused_with_a_reason() {
    let error = |cdr: &[u8], type_name: &str, encoding: Encoding| {
        encoding.codec(catalog(), &name(type_name)).unwrap().encode(cdr).unwrap_err().to_string()
    };
    let image = Image { encoding: "mono16".into(), is_bigendian: 1, ..Image::default() };
    assert_eq!(
        error(&cdr::to_vec(&image), Image::TYPE_NAME, Encoding::FoxgloveProtobuf),
        "sensor_msgs/msg/Image: cannot write foxglove-protobuf, field `is_bigendian`: pixels of encoding mono16 must be \
         little-endian for Foxglove"
    );
    let state = JointState { name: vec!["a".into()], velocity: vec![0.0; 2], ..JointState::default() };
    assert_eq!(
        error(&cdr::to_vec(&state), JointState::TYPE_NAME, Encoding::FoxgloveProtobuf),
        "sensor_msgs/msg/JointState: cannot write foxglove-protobuf, field `velocity`: has 2 elements, but there are 1 names"
    );
    let mut early = transform();
    early.header.stamp.sec = -1;
    assert_eq!(
        error(&cdr::to_vec(&early), TransformStamped::TYPE_NAME, Encoding::FoxgloveFlatBuffers),
        "geometry_msgs/msg/TransformStamped: cannot write foxglove-flatbuffers, field `timestamp`: -1 s cannot be represented by \
         FlatBuffers' Time"
    );
    let short = PointCloud2 {
        height: 2,
        width: 1,
        point_step: 4,
        row_step: 8,
        data: vec![0; 15],
        ..PointCloud2::default()
    };
    let short = error(&cdr::to_vec(&short), PointCloud2::TYPE_NAME, Encoding::FoxgloveProtobuf);
    assert!(
        short
            .ends_with("field `row_step`: 2 rows of 8 bytes with 4 bytes of points do not fit into 15 bytes"),
        "{short}"
    );
}

#[test]
fn a_type_with_the_name_of_a_known_one_is_encoded_by_its_own_definition() {
    let mut other = downbeat_msgs::definitions::Catalog::new();
    other.add_message(name("sensor_msgs/msg/Image"), "uint8[] pixels\n", "Image.msg").unwrap();
    let codec = Encoding::FoxgloveProtobuf.codec(&other, &name("sensor_msgs/msg/Image")).unwrap();
    assert_eq!(codec.schema().name, "sensor_msgs.msg.Image");
}
