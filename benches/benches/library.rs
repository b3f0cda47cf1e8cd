//! A `JointState` of 20 joints to and from a module in C, compared with a compiled-in module; and to a module
//! in a child process, compared with a bare hop between two processes through an `eventfd`, in the same run.
//!
//! One iteration is a cycle in which one module publishes and the other receives the message of the previous
//! cycle. Needs `cc`.
#![allow(missing_docs, clippy::unwrap_used, unsafe_code)]

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{FromRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use criterion::Criterion;
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::ForeignModule;
use downbeat_executor::{
    Core, ManualClock, Module, ModuleOptions, Publication, Setup, SetupError, Synchrony, Time,
};
use downbeat_library_host::messages::{Language, generate};
use downbeat_library_host::{LibraryOptions, child, load, set_child_command};
use downbeat_msgs::sensor_msgs::msg::JointState;

/// Publishes a message in each run, or sums up the received positions.
const SOURCE: &str = r#"
#include "sensor_msgs/msg/joint_state.h"

typedef struct module {
    sensor_msgs__msg__JointState message;
    downbeat_writer writer;
    double sum;
} module;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    module *self = (module *)calloc(1, sizeof(module));
    sensor_msgs__msg__JointState *message = &self->message;
    sensor_msgs__msg__JointState__init(message);
    downbeat_string_sequence_resize(&message->name, 20);
    downbeat_float64_sequence_resize(&message->position, 20);
    downbeat_float64_sequence_resize(&message->velocity, 20);
    downbeat_float64_sequence_resize(&message->effort, 20);
    for (size_t joint = 0; joint < 20; joint++) {
        downbeat_string_assign(&message->name.data[joint], "l_shoulder_pitch");
    }
    return self;
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    (void)self;
    const char *type = sensor_msgs__msg__JointState__TYPE, *hash = sensor_msgs__msg__JointState__HASH;
#ifdef PUBLISH
    return host->publisher(host, "joint_states", type, hash, NULL) || host->each_run(host);
#else
    return host->subscription(host, "joint_states", type, hash, NULL);
#endif
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    module *of = (module *)self;
#ifdef PUBLISH
    (void)event;
    of->message.position.data[3] += 0.01;
    return sensor_msgs__msg__JointState__publish(host, 0, &of->message, &of->writer);
#else
    if (sensor_msgs__msg__JointState__take(host, event, &of->message) != 0) {
        return -1;
    }
    for (size_t joint = 0; joint < of->message.position.size; joint++) {
        of->sum += of->message.position.data[joint];
    }
    return 0;
#endif
}

static void destroy(void *self) { free(self); }

const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 table = {DOWNBEAT_ABI_VERSION, sizeof table, "bench", create, setup, handle, destroy,
                                             NULL, NULL, NULL, NULL, NULL};
    return &table;
}
"#;

struct Source {
    message: JointState,
}

impl Source {
    fn new() -> Self {
        let message = JointState {
            name: vec!["l_shoulder_pitch".to_owned(); 20],
            position: vec![0.0; 20],
            velocity: vec![0.0; 20],
            effort: vec![0.0; 20],
            ..JointState::default()
        };
        Self { message }
    }
}

impl Module for Source {
    type Ports = Publication<JointState>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<JointState>, SetupError> {
        setup.each_run(|source, ctx| {
            source.message.position[3] += 0.01;
            let out = *ctx.ports;
            ctx.publish(out, source.message.clone());
        });
        setup.publish("joint_states")
    }
}

struct Sink {
    sum: f64,
}

impl Module for Sink {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe::<JointState, _>("joint_states", |sink, message, _| {
            sink.sum += message.position.iter().sum::<f64>();
        })
    }
}

fn core() -> Core {
    Core::new().with_clock(ManualClock::new(Time::ZERO)).without_times()
}

fn every_cycle() -> ModuleOptions {
    ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() }
}

fn add_library(core: &mut Core, path: &Path, is_isolated: bool, options: ModuleOptions) {
    let library = LibraryOptions {
        module: "library".into(),
        path: path.into(),
        is_isolated,
        ..LibraryOptions::default()
    };
    let of_module = options.clone();
    let make = Arc::new(move || load(&library));
    let module = ForeignModule::new(make, Interfaces::carried(), of_module);
    core.add_with("library", module, options).unwrap();
}

fn build(folder: &Path, name: &str, defines: &[&str]) -> PathBuf {
    let names = ["sensor_msgs/msg/JointState".parse().unwrap()];
    for header in generate(downbeat_msgs::carried(), &names, Language::C).unwrap() {
        let path = folder.join(&header.path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, header.text).unwrap();
    }
    let (source, library) = (folder.join("bench.c"), folder.join(name));
    std::fs::write(&source, SOURCE).unwrap();
    let status = Command::new("cc")
        .args(["-std=c11", "-O2", "-shared", "-fPIC", "-I"])
        .arg(folder)
        .args(defines)
        .arg(source)
        .arg("-o")
        .arg(&library)
        .status();
    assert!(status.unwrap().success());
    library
}

fn in_process(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let mut group = criterion.benchmark_group("JointState of 20, one way");
    let mut measure = |name: &str, mut core: Core| {
        (0..10).for_each(|_| core.cycle().unwrap());
        group.bench_function(name, |bencher| bencher.iter(|| core.cycle().unwrap()));
    };
    let mut compiled_in = core();
    compiled_in.add_with("source", Source::new(), every_cycle()).unwrap();
    compiled_in.add("sink", Sink { sum: 0.0 }).unwrap();
    measure("compiled in to compiled in", compiled_in);
    let mut to_library = core();
    to_library.add_with("source", Source::new(), every_cycle()).unwrap();
    add_library(&mut to_library, &build(folder.path(), "sink.so", &[]), false, ModuleOptions::default());
    measure("compiled in to C", to_library);
    let mut from_library = core();
    add_library(&mut from_library, &build(folder.path(), "source.so", &["-DPUBLISH"]), false, every_cycle());
    from_library.add("sink", Sink { sum: 0.0 }).unwrap();
    measure("C to compiled in", from_library);
    group.finish();
}

fn in_child(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let mut group = criterion.benchmark_group("there and back between two processes");
    let [mut there, back] = [(); 2]
        .map(|()| {
            // SAFETY: a new file descriptor, which only this value owns.
            unsafe { OwnedFd::from_raw_fd(libc::eventfd(0, libc::EFD_CLOEXEC)) }
        })
        .map(File::from);
    let mut peer = Command::new(std::env::current_exe().unwrap())
        .arg("eventfd-peer")
        .stdin(Stdio::from(there.try_clone().unwrap()))
        .stdout(Stdio::from(back.try_clone().unwrap()))
        .spawn()
        .unwrap();
    let mut hop = |count: u64| {
        there.write_all(&count.to_ne_bytes()).unwrap();
        let mut answer = [0; 8];
        (&back).read_exact(&mut answer).unwrap();
    };
    group.bench_function("eventfd", |bencher| bencher.iter(|| hop(1)));
    let mut core = core();
    core.add_with("source", Source::new(), every_cycle()).unwrap();
    add_library(&mut core, &build(folder.path(), "sink.so", &[]), true, ModuleOptions::default());
    (0..10).for_each(|_| core.cycle().unwrap());
    group.bench_function("JointState of 20 to C in a child process", |bencher| {
        bencher.iter(|| core.cycle().unwrap());
    });
    group.bench_function("eventfd, again", |bencher| bencher.iter(|| hop(1)));
    group.finish();
    hop(2);
    peer.wait().unwrap();
}

/// Answers until it receives a 2.
fn answer_eventfd() {
    let (mut input, mut output) = (std::io::stdin().lock(), std::io::stdout().lock());
    let mut count = [0; 8];
    while u64::from_ne_bytes(count) != 2 {
        input.read_exact(&mut count).unwrap();
        output.write_all(&count).unwrap();
        output.flush().unwrap();
    }
}

fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("library-child") => drop(child()),
        Some("eventfd-peer") => answer_eventfd(),
        _ => {
            let program = std::env::current_exe().unwrap().into_os_string();
            set_child_command([program, "library-child".into()]);
            let mut criterion = Criterion::default().configure_from_args();
            in_process(&mut criterion);
            in_child(&mut criterion);
            criterion.final_summary();
        }
    }
}
