//! Messages to CDR and back, compared with other Rust libraries in the same run, and with Fast CDR behind
//! rclpy if the environment variable `DOWNBEAT_PYTHON` names an interpreter with rclpy.
#![allow(missing_docs, clippy::unwrap_used)]

use std::env;
use std::hint::black_box;
use std::process::Command;

use byteorder::LittleEndian;
use criterion::{Criterion, Throughput};
use downbeat_msgs::cdr::{self, Cdr, FromReader};
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::sensor_msgs::msg::{Image, Imu, JointState, PointCloud2, PointField, view};
use downbeat_msgs::std_msgs::msg::Header;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The size of pixels and of points in bytes.
const LARGE: usize = 1 << 20;

/// Writes and reads a message, with the view type `view`, by each of the libraries.
macro_rules! compare {
    ($criterion:expr, $name:literal, $message:expr, $owned:ty, $view:ty) => {{
        let message: $owned = $message;
        let bytes = cdr::to_vec(&message);
        let mut group = $criterion.benchmark_group(concat!("encode ", $name));
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        encode(&mut group, &message, &bytes);
        group.finish();
        let mut group = $criterion.benchmark_group(concat!("decode ", $name));
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        decode::<$owned>(&mut group, &bytes);
        group.bench_function("downbeat, view", |bencher| {
            bencher.iter(|| cdr::from_slice::<$view>(black_box(&bytes)).unwrap());
        });
        group.finish();
    }};
}

type Group<'a> = criterion::BenchmarkGroup<'a, criterion::measurement::WallTime>;

fn encode<T: Cdr + Serialize>(group: &mut Group<'_>, message: &T, bytes: &[u8]) {
    group.bench_function("downbeat", |bencher| bencher.iter(|| cdr::to_vec(black_box(message))));
    let mut buffer = Vec::new();
    group.bench_function("downbeat, memory used again", |bencher| {
        bencher.iter(|| cdr::to_buffer(black_box(message), &mut buffer));
    });
    assert_eq!(cdr_encoding::to_vec::<T, LittleEndian>(message).unwrap(), bytes[cdr::HEADER_SIZE..]);
    group.bench_function("cdr-encoding", |bencher| {
        bencher.iter(|| cdr_encoding::to_vec::<T, LittleEndian>(black_box(message)).unwrap());
    });
    let theirs = ::cdr::serialize::<_, _, ::cdr::CdrLe>(message, ::cdr::Infinite);
    assert_eq!(theirs.unwrap(), bytes);
    group.bench_function("cdr", |bencher| {
        bencher.iter(|| ::cdr::serialize::<_, _, ::cdr::CdrLe>(black_box(message), ::cdr::Infinite).unwrap());
    });
    // The lower limit for a message that consists mostly of bytes.
    group.bench_function("memcpy", |bencher| bencher.iter(|| black_box(bytes).to_vec()));
}

fn decode<T: Clone + for<'a> FromReader<'a> + DeserializeOwned>(group: &mut Group<'_>, bytes: &[u8]) {
    group.bench_function("downbeat", |bencher| {
        bencher.iter(|| cdr::from_slice::<T>(black_box(bytes)).unwrap());
    });
    let body = &bytes[cdr::HEADER_SIZE..];
    group.bench_function("cdr-encoding", |bencher| {
        bencher.iter(|| cdr_encoding::from_bytes::<T, LittleEndian>(black_box(body)).unwrap().0);
    });
    group.bench_function("cdr", |bencher| {
        bencher.iter(|| ::cdr::deserialize::<T>(black_box(bytes)).unwrap());
    });
    group.bench_function("memcpy", |bencher| bencher.iter(|| black_box(bytes).to_vec()));
    // The cost of allocating the message, which every reader pays.
    let message: T = cdr::from_slice(bytes).unwrap();
    group.bench_function("clone of the message", |bencher| bencher.iter(|| black_box(&message).clone()));
}

fn header() -> Header {
    Header { frame_id: "base_link".into(), ..Header::default() }
}

fn joint_state() -> JointState {
    let numbers: Vec<f64> = (0..20).map(|index| f64::from(index) / 10.0).collect();
    JointState {
        header: header(),
        name: (0..20).map(|index| format!("joint_{index:02}")).collect(),
        position: numbers.clone(),
        velocity: numbers.clone(),
        effort: numbers,
    }
}

fn point_cloud() -> PointCloud2 {
    let field = |name: &str, offset| PointField {
        name: name.into(),
        offset,
        datatype: PointField::FLOAT32,
        count: 1,
    };
    PointCloud2 {
        header: header(),
        height: 1,
        width: (LARGE / 16) as u32,
        fields: vec![field("x", 0), field("y", 4), field("z", 8), field("intensity", 12)],
        point_step: 16,
        row_step: LARGE as u32,
        data: vec![7; LARGE],
        is_dense: true,
        ..PointCloud2::default()
    }
}

fn image() -> Image {
    Image {
        header: header(),
        height: 512,
        width: 1024,
        encoding: "yuv422".into(),
        step: 2048,
        data: vec![7; LARGE],
        ..Image::default()
    }
}

/// The same bytes as a `tf2_msgs/msg/TFMessage`, which has only this field.
fn transforms() -> Vec<TransformStamped> {
    let transform = |index| TransformStamped {
        header: header(),
        child_frame_id: format!("link_{index:02}"),
        ..TransformStamped::default()
    };
    (0..50).map(transform).collect()
}

fn log() -> Log {
    Log {
        level: Log::WARN,
        name: "controller_manager".into(),
        msg: "Overrun detected! The controller manager missed its desired rate of 100 Hz.".into(),
        file: "./src/ros2_control_node.cpp".into(),
        function: "operator()".into(),
        line: 126,
        ..Log::default()
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    compare!(criterion, "JointState of 20", joint_state(), JointState, view::JointState);
    compare!(criterion, "Imu", Imu { header: header(), ..Imu::default() }, Imu, view::Imu);
    compare!(criterion, "PointCloud2 of 1 MB", point_cloud(), PointCloud2, view::PointCloud2);
    compare!(criterion, "Image of 1 MB", image(), Image, view::Image);
    compare!(
        criterion,
        "TFMessage of 50",
        transforms(),
        Vec<TransformStamped>,
        cdr::Sequence<downbeat_msgs::geometry_msgs::msg::view::TransformStamped>
    );
    compare!(criterion, "Log", log(), Log, downbeat_msgs::rcl_interfaces::msg::view::Log);
    criterion.final_summary();
    rclpy();
}

/// Runs rclpy on the same messages.
fn rclpy() {
    let Ok(python) = env::var("DOWNBEAT_PYTHON") else {
        println!("Fast CDR behind rclpy: not measured, DOWNBEAT_PYTHON is not set");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/cdr_rclpy.py");
    match Command::new(&python).arg(script).status() {
        Ok(status) if status.success() => {}
        Ok(status) => println!("Fast CDR behind rclpy: {python} {script} ended with {status}"),
        Err(error) => println!("Fast CDR behind rclpy: cannot run {python}: {error}"),
    }
}
