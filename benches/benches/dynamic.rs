//! Reading messages whose type is known only at run time, compared with rosbags' `deserialize_cdr` in the
//! same run if `DOWNBEAT_PYTHON` names an interpreter with rosbags. A table of the best times and their
//! ratios follows criterion's figures.
//!
//! rosbags does not copy arrays of numbers, which stay in the input as a `memoryview`. A `DynamicView` does
//! the same; a `DynamicMessage` owns its values.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, DynamicView};
use downbeat_msgs::{Message, cdr, geometry_msgs, rcl_interfaces, sensor_msgs, std_msgs, tf2_msgs};

const WHOLE: &str = "downbeat, DynamicMessage";
const VIEW: &str = "downbeat, DynamicView of each field";
const ROSBAGS: &str = "rosbags, deserialize_cdr";

struct Sample {
    label: &'static str,
    of: DynamicType,
    definition: &'static str,
    bytes: Vec<u8>,
}

impl Sample {
    fn new<T: Message>(label: &'static str, message: &T) -> Self {
        let of = DynamicType::of::<T>().unwrap_or_else(|error| panic!("{label}: {error}"));
        Self { label, of, definition: T::DEFINITION, bytes: cdr::to_vec(message) }
    }
}

fn samples() -> Vec<Sample> {
    let header = std_msgs::msg::Header { frame_id: "base_link".into(), ..Default::default() };
    let transform = geometry_msgs::msg::TransformStamped {
        header: header.clone(),
        child_frame_id: "left_foot".into(),
        ..Default::default()
    };
    vec![
        Sample::new(
            "JointState of 20",
            &sensor_msgs::msg::JointState {
                header: header.clone(),
                name: (0..20).map(|index| format!("joint_{index}")).collect(),
                position: vec![0.5; 20],
                velocity: vec![0.25; 20],
                effort: vec![0.125; 20],
            },
        ),
        Sample::new("Imu", &sensor_msgs::msg::Imu { header: header.clone(), ..Default::default() }),
        Sample::new(
            "Log",
            &rcl_interfaces::msg::Log {
                name: "walk".into(),
                msg: "step taken, left foot first".into(),
                file: "src/walk.rs".into(),
                function: "step".into(),
                ..Default::default()
            },
        ),
        Sample::new("TFMessage of 50", &tf2_msgs::msg::TFMessage { transforms: vec![transform; 50] }),
        Sample::new(
            "Image of 1 MB",
            &sensor_msgs::msg::Image { header: header.clone(), data: vec![7; 1 << 20], ..Default::default() },
        ),
        Sample::new(
            "PointCloud2 of 1 MB",
            &sensor_msgs::msg::PointCloud2 {
                header,
                fields: vec![sensor_msgs::msg::PointField { name: "x".into(), ..Default::default() }; 4],
                data: vec![7; 1 << 20],
                ..Default::default()
            },
        ),
    ]
}

fn reading(criterion: &mut Criterion) {
    let samples = samples();
    let mut peer = Peer::start(&samples);
    if peer.is_none() {
        println!("DOWNBEAT_PYTHON is not set: rosbags is left out");
    }
    let best: RefCell<BTreeMap<(usize, &str), f64>> = RefCell::default();
    let note = |index: usize, what: &'static str, elapsed: Duration, count: u64| {
        let time = elapsed.as_nanos() as f64 / count as f64;
        best.borrow_mut().entry((index, what)).and_modify(|least| *least = least.min(time)).or_insert(time);
        elapsed
    };
    for (index, Sample { label, of, bytes, .. }) in samples.iter().enumerate() {
        let mut group = criterion.benchmark_group(*label);
        group.bench_function(WHOLE, |bencher| {
            bencher.iter_custom(|count| {
                let begin = Instant::now();
                for _ in 0..count {
                    let _ = black_box(DynamicMessage::from_cdr(black_box(of), black_box(bytes)));
                }
                note(index, WHOLE, begin.elapsed(), count)
            });
        });
        let fields: Vec<&str> = of.fields().map(|field| field.name).collect();
        group.bench_function(VIEW, |bencher| {
            bencher.iter_custom(|count| {
                let begin = Instant::now();
                for _ in 0..count {
                    if let Ok(view) = DynamicView::new(black_box(of), black_box(bytes)) {
                        for field in &fields {
                            let _ = black_box(view.get(field));
                        }
                    }
                }
                note(index, VIEW, begin.elapsed(), count)
            });
        });
        if let Some(peer) = &mut peer {
            group.bench_function(ROSBAGS, |bencher| {
                bencher.iter_custom(|count| note(index, ROSBAGS, peer.read(index, count), count));
            });
        }
        group.finish();
    }
    print_table(&samples, &best.into_inner());
}

fn print_table(samples: &[Sample], best: &BTreeMap<(usize, &str), f64>) {
    println!("\nbest time per message in µs, and that of rosbags as a multiple of it");
    println!("{:<20} {:>18} {:>18} {:>10}", "", "DynamicMessage", "DynamicView", "rosbags");
    for (index, sample) in samples.iter().enumerate() {
        let Some(whole) = best.get(&(index, WHOLE)) else { continue }; // Filtered out.
        let view = best.get(&(index, VIEW)).copied().unwrap_or(f64::NAN);
        let rosbags = best.get(&(index, ROSBAGS)).copied().unwrap_or(f64::NAN);
        println!(
            "{:<20} {:>10.3} {:>6.1}x {:>10.3} {:>6.1}x {:>10.3}",
            sample.label,
            whole / 1e3,
            rosbags / whole,
            view / 1e3,
            rosbags / view,
            rosbags / 1e3
        );
    }
}

/// A Python process that reads messages and measures the time.
struct Peer {
    child: Child,
    requests: Option<ChildStdin>,
    answers: Option<BufReader<ChildStdout>>,
}

/// Receives names, definitions and bytes; then indices of messages and repetition counts.
const SCRIPT: &str = "
import sys, time
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
samples = []
for line in sys.stdin:
    if line == '\\n':
        break
    name, definition, data = line.split()
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(bytes.fromhex(definition).decode(), name))
    samples.append((store.deserialize_cdr, memoryview(bytes.fromhex(data)), name))
for line in sys.stdin:
    index, count = map(int, line.split())
    deserialize, data, name = samples[index]
    begin = time.perf_counter_ns()
    for _ in range(count):
        deserialize(data, name)
    print(time.perf_counter_ns() - begin, flush=True)
";

impl Peer {
    fn start(samples: &[Sample]) -> Option<Self> {
        let python = std::env::var_os("DOWNBEAT_PYTHON")?;
        let mut command = Command::new(python);
        command.args(["-c", SCRIPT]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let mut peer = Self { child, requests: None, answers: None };
        (peer.requests, peer.answers) =
            (peer.child.stdin.take(), peer.child.stdout.take().map(BufReader::new));
        for sample in samples {
            let (definition, bytes) = (hex(sample.definition.as_bytes()), hex(&sample.bytes));
            peer.say(&format!("{} {definition} {bytes}", sample.of.name()));
        }
        peer.say("");
        Some(peer)
    }

    fn say(&mut self, line: &str) {
        let said = self.requests.as_mut().map(|requests| writeln!(requests, "{line}"));
        assert!(matches!(said, Some(Ok(()))), "the Python peer does not listen: {said:?}");
    }

    fn read(&mut self, index: usize, count: u64) -> Duration {
        self.say(&format!("{index} {count}"));
        let mut line = String::new();
        let answered = self.answers.as_mut().map(|answers| answers.read_line(&mut line));
        match (answered, line.trim().parse()) {
            (Some(Ok(_)), Ok(nanoseconds)) => Duration::from_nanos(nanoseconds),
            (answered, _) => panic!("the Python peer answers `{line}`: {answered:?}"),
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

criterion_group!(benches, reading);
criterion_main!(benches);
