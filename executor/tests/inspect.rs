//! Observation of a running core: counters, times, traces and the graph.
#![allow(clippy::unwrap_used, missing_docs)]

use std::time::Duration;

use downbeat_executor::queue::{Locked, Overflow};
use downbeat_executor::{
    Context, Core, CoreHandle, CycleTrace, GraphEdge, Inbox, Launcher, Linear, Module, ModuleOptions,
    ModuleState, Pool, Publication, Received, Setup, SetupError, Snapshot, Synchrony, Threads,
    TraceEventKind,
};

/// Long enough for a busy machine.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Publishes two numbers in each run.
#[derive(Default)]
struct Source {
    out: Option<Publication<u32>>,
}

impl Module for Source {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("number")?);
        setup.every(Duration::from_millis(1), |source: &mut Self, ctx: &mut Context<'_>| {
            for number in 0..2 {
                ctx.publish(source.out.unwrap(), number);
            }
        })
    }
}

struct Sink;

impl Module for Sink {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("number", |_: &mut Self, _: Received<'_, u32>, _: &mut Context<'_>| {})
    }
}

struct Bomb;

impl Module for Bomb {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup
            .subscribe("number", |_: &mut Self, _: Received<'_, u32>, _: &mut Context<'_>| panic!("intended"))
    }
}

fn core(launcher: impl Launcher + 'static) -> Core {
    let mut core = Core::new().with_launcher(launcher);
    core.add("source", Source::default()).unwrap();
    core.add("sink", Sink).unwrap();
    let synchrony = Synchrony::Detached(Inbox::KeepAll);
    core.add_with("apart", Sink, ModuleOptions { synchrony, ..ModuleOptions::default() }).unwrap();
    core
}

/// Runs the core on a separate thread, calls `look`, and stops the core.
fn while_running<T>(mut core: Core, look: impl FnOnce(&CoreHandle) -> T) -> T {
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run());
    let seen = look(&handle);
    handle.stop();
    thread.join().unwrap().unwrap();
    seen
}

fn snapshot_when(handle: &CoreHandle, condition: impl Fn(&Snapshot) -> bool) -> Snapshot {
    let begin = std::time::Instant::now();
    loop {
        let snapshot = handle.snapshot().wait(WATCHDOG).unwrap();
        if condition(&snapshot) {
            return snapshot;
        }
        assert!(begin.elapsed() < WATCHDOG, "gave up on {snapshot:#?}");
        std::thread::yield_now();
    }
}

fn check_counts(launcher: impl Launcher + 'static) {
    let is_late_enough = |snapshot: &Snapshot| snapshot.topics[0].messages >= 40;
    let seen = while_running(core(launcher), |handle| snapshot_when(handle, is_late_enough));
    let [source, sink, apart] = &seen.modules[..] else { panic!("{seen:#?}") };
    let topic = &seen.topics[0];
    assert_eq!((topic.name.as_str(), topic.subscribers), ("number", 2));
    assert_eq!((topic.last_batch, topic.largest_batch, topic.messages), (2, 2, 2 * topic.batches));
    assert_eq!(source.published, topic.messages);
    // The last batch has been published and not received.
    assert!(sink.received == topic.messages || sink.received + 2 == topic.messages, "{seen:#?}");
    assert_eq!(sink.runs - 1, sink.received / 2);
    assert!(apart.is_detached && apart.received <= topic.messages, "{seen:#?}");
    assert!(source.run_time.count > 0 && source.run_time.count <= source.runs, "{seen:#?}");
    assert!(seen.cycles.total.count > 0 && seen.cycles.total.count <= seen.cycle, "{seen:#?}");
    assert!(seen.modules.iter().all(|module| module.state == ModuleState::Active));
}

#[test]
fn counts_are_exact_under_every_launcher() {
    check_counts(Linear);
    check_counts(Pool::new(2).unwrap());
    check_counts(Threads::new());
}

#[test]
fn what_the_queue_of_an_inlet_drops_is_counted_with_its_topic() {
    let mut core = Core::new();
    core.add("sink", Sink).unwrap();
    let two = std::num::NonZeroUsize::new(2).unwrap();
    let inlet = core.inlet_with("number", Locked::bounded(two, Overflow::DropOldest)).unwrap();
    (0..5_u32).for_each(|number| inlet.publish(number).unwrap());
    while_running(core, |handle| {
        let seen = snapshot_when(handle, |snapshot| snapshot.topics[0].messages > 0);
        assert_eq!((seen.topics[0].messages, seen.topics[0].dropped), (2, 3));
    });
}

#[test]
fn a_core_without_times_counts_and_can_be_traced() {
    let mut core = Core::new().without_times();
    core.add("source", Source::default()).unwrap();
    core.add("sink", Sink).unwrap();
    while_running(core, |handle| {
        let seen = snapshot_when(handle, |snapshot| snapshot.topics[0].messages >= 40);
        assert!(seen.modules.iter().all(|module| module.runs > 0 && module.run_time.count == 0), "{seen:#?}");
        assert_eq!(seen.cycles.total.count, 0);
        let trace = handle.trace(3).wait(WATCHDOG).unwrap();
        assert_eq!(trace.events().iter().filter(|event| event.kind == TraceEventKind::Process).count(), 3);
    });
}

#[test]
fn a_module_that_panicked_has_failed() {
    let mut core = core(Linear);
    core.add("bomb", Bomb).unwrap();
    let has_failed = |snapshot: &Snapshot| snapshot.modules[3].state == ModuleState::Failed;
    let seen = while_running(core, |handle| snapshot_when(handle, has_failed));
    assert_eq!(seen.modules[3].panics, 1);
}

fn check_trace(launcher: impl Launcher + 'static) -> CycleTrace {
    let trace = while_running(core(launcher), |handle| handle.trace(20).wait(WATCHDOG).unwrap());
    let of = |kind| trace.events().iter().filter(move |event| event.kind == kind).collect::<Vec<_>>();
    let (process, sync) = (of(TraceEventKind::Process), of(TraceEventKind::Sync));
    assert_eq!((process.len(), sync.len()), (20, 20));
    let runs = of(TraceEventKind::Run);
    assert!(runs.iter().any(|run| run.module.as_deref() == Some("source")));
    for run in runs {
        let phase = process.iter().find(|phase| phase.cycle == run.cycle).unwrap();
        assert!(phase.begin_ns <= run.begin_ns && run.end_ns <= phase.end_ns, "{run:?} in {phase:?}");
    }
    trace
}

#[test]
fn a_trace_shows_each_run_inside_its_process_phase() {
    assert!(check_trace(Linear).threads().len() <= 2);
    check_trace(Pool::new(2).unwrap());
    check_trace(Threads::new());
}

#[test]
fn a_trace_of_a_paused_core_can_be_ended() {
    let trace = while_running(core(Linear), |handle| {
        handle.pause();
        snapshot_when(handle, |snapshot| snapshot.is_paused);
        let trace = handle.trace(5);
        handle.finish_trace();
        trace.wait(WATCHDOG).unwrap()
    });
    assert!(trace.events().is_empty());
}

#[test]
fn the_graph_is_the_same_before_and_while_the_core_runs() {
    let core = core(Linear);
    let before = core.graph();
    let names: Vec<_> =
        before.modules.iter().map(|module| (module.name.as_str(), module.is_detached)).collect();
    assert_eq!(names, [("source", false), ("sink", false), ("apart", true)]);
    assert_eq!(
        before.edges,
        [
            GraphEdge::Publishes { module: 0, topic: 0 },
            GraphEdge::Subscribes { module: 1, topic: 0 },
            GraphEdge::Subscribes { module: 2, topic: 0 },
        ]
    );
    let during = while_running(core, |handle| handle.graph().wait(WATCHDOG).unwrap());
    assert_eq!((&during.modules, &during.edges), (&before.modules, &before.edges));
}
