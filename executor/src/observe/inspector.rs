//! Measures the cycles of one core.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::histogram::{TimeHistogram, nanoseconds};
use super::sampler::{Sampler, clock_reading_time};
use super::trace::{TraceCause, TraceEventKind};
use super::{CycleStatistics, CycleTrace, Measuring, ModuleMeter, SharedTiming, Span};
use crate::Time;
use crate::threads::ReceiptSender;

/// Facts about a cycle besides its times.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CycleInfo {
    /// The number of the cycle, from 0.
    pub(crate) cycle: u64,
    /// The delay after the timer for which the cycle began; `None` if the cycle had another reason.
    pub(crate) lateness: Option<Duration>,
    /// True if the core slept before the cycle.
    pub(crate) has_slept: bool,
}

/// Decides what is measured in a cycle, and collects the readings. The calls come in this order:
/// [`begin`](Self::begin), the process phase, [`processed`](Self::processed), the sync phase,
/// [`synced`](Self::synced), [`ran`](Self::ran) for each run, [`end`](Self::end).
pub(crate) struct Inspector {
    is_on: bool,
    timing: Arc<SharedTiming>,
    started: Instant,
    sampler: Sampler,
    meter: CycleMeter,
    clock_reading_time: Duration,
    measuring: Measuring,
    current: Reading,
    trace: Option<Tracing>,
}

struct CycleMeter {
    process: TimeHistogram,
    sync: TimeHistogram,
    lateness: TimeHistogram,
    cost: Duration,
}

#[derive(Clone, Copy)]
struct Reading {
    begin: Instant,
    processed: Instant,
    synced: Instant,
    runs: u32,
}

struct Tracing {
    cycles_left: u32,
    trace: CycleTrace,
    answer: ReceiptSender<CycleTrace>,
}

impl Inspector {
    /// An inspector that measures the cycles chosen by the sampler.
    pub(crate) fn new(timing: Arc<SharedTiming>) -> Self {
        Self { is_on: true, clock_reading_time: clock_reading_time(), ..Self::off(timing) }
    }

    /// An inspector that measures only requested traces.
    pub(crate) fn off(timing: Arc<SharedTiming>) -> Self {
        let now = Instant::now();
        Self {
            is_on: false,
            timing,
            started: now,
            sampler: Sampler::new(),
            meter: CycleMeter {
                process: TimeHistogram::new(),
                sync: TimeHistogram::new(),
                lateness: TimeHistogram::new(),
                cost: Duration::ZERO,
            },
            clock_reading_time: Duration::ZERO,
            measuring: Measuring::Nothing,
            current: Reading { begin: now, processed: now, synced: now, runs: 0 },
            trace: None,
        }
    }

    /// A meter for a new module.
    pub(crate) fn module_meter(&self) -> ModuleMeter {
        if self.is_on { ModuleMeter::with_times() } else { ModuleMeter::default() }
    }

    /// Begins a cycle; returns what is to be measured in it.
    #[inline]
    pub(crate) fn begin(&mut self) -> Measuring {
        self.measuring = match &mut self.trace {
            Some(tracing) if tracing.cycles_left > 0 => {
                tracing.cycles_left -= 1;
                Measuring::Trace
            }
            _ if self.is_on && self.sampler.takes_next() => Measuring::Times,
            _ => Measuring::Nothing,
        };
        if self.measuring.is_on() {
            self.current.runs = 0;
            self.current.begin = Instant::now();
        }
        self.measuring
    }

    /// Marks the end of the process phase.
    #[inline]
    pub(crate) fn processed(&mut self) {
        if self.measuring.is_on() {
            self.current.processed = Instant::now();
        }
    }

    /// Marks the end of the sync phase.
    #[inline]
    pub(crate) fn synced(&mut self) {
        if self.measuring.is_on() {
            self.current.synced = Instant::now();
        }
    }

    /// Records the run of a module; called after the sync phase of a measured cycle.
    pub(crate) fn ran(
        &mut self,
        meter: &mut ModuleMeter,
        module: &Arc<str>,
        cycle: u64,
        span: &Span,
        causes: impl FnOnce() -> Vec<TraceCause>,
    ) {
        self.current.runs += 1;
        meter.took(span.duration());
        if self.measuring == Measuring::Trace {
            self.add_to_trace(TraceEventKind::Run, Some(module), cycle, span, causes());
        }
    }

    /// Records a run of a detached module, with the time `due` if there was one. The run's messages were sent
    /// in `cycle`.
    pub(crate) fn stepped(
        &mut self,
        meter: &mut ModuleMeter,
        module: &Arc<str>,
        cycle: u64,
        span: &Span,
        due: Option<Time>,
        causes: impl FnOnce() -> Vec<TraceCause>,
    ) {
        meter.took(span.duration());
        meter.was_on_processor(span.processor);
        if let Some(time) = due {
            self.timing.looped(module, time, span.duration());
        }
        if self.trace.is_some() {
            self.add_to_trace(TraceEventKind::Step, Some(module), cycle, span, causes());
        }
    }

    /// Ends the cycle.
    #[inline]
    pub(crate) fn end(&mut self, info: CycleInfo) {
        if self.measuring.is_on() {
            self.take_in(info);
            self.measuring = Measuring::Nothing;
        }
        let is_complete = |tracing: &Tracing| tracing.cycles_left == 0 || tracing.trace.is_full();
        if self.trace.as_ref().is_some_and(is_complete) {
            self.finish_trace();
        }
    }

    /// Traces the next cycles, at least one, and then answers. An incomplete earlier trace is answered with
    /// its cycles so far.
    pub(crate) fn trace(&mut self, cycles: u32, answer: ReceiptSender<CycleTrace>) {
        self.finish_trace();
        let trace = CycleTrace::new(self.started);
        self.trace = Some(Tracing { cycles_left: cycles.max(1), trace, answer });
    }

    /// Ends a trace early with its cycles so far, if no more cycles will run soon.
    pub(crate) fn finish_trace(&mut self) {
        if let Some(Tracing { trace, answer, .. }) = self.trace.take() {
            answer.send(trace.finish());
        }
    }

    /// Counts cycles.
    #[inline]
    pub(crate) fn count_cycles(&self, cycles: u64) {
        self.timing.count_cycles(cycles);
    }

    /// A copy of the inspector that measures only requested traces.
    pub(crate) fn turned_off(&self) -> Self {
        Self::off(Arc::clone(&self.timing))
    }

    /// The steady time since construction.
    pub(crate) fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    pub(crate) fn statistics(&self) -> CycleStatistics {
        CycleStatistics {
            process: self.meter.process.statistics(),
            sync: self.meter.sync.statistics(),
            total: self.timing.cycle(),
            lateness: self.meter.lateness.statistics(),
            measuring_ns: nanoseconds(self.meter.cost),
        }
    }

    fn take_in(&mut self, info: CycleInfo) {
        let Reading { begin, processed, synced, runs } = self.current;
        self.meter.process.record(processed - begin);
        self.meter.sync.record(synced - processed);
        self.timing.cycle_took(synced - begin);
        if let Some(lateness) = info.lateness {
            self.meter.lateness.record(lateness);
        }
        if self.measuring == Measuring::Trace {
            let thread = Some(std::thread::current());
            let process = Span { begin, end: processed, thread: thread.clone(), processor: None };
            self.add_to_trace(TraceEventKind::Process, None, info.cycle, &process, Vec::new());
            let sync = Span { begin: processed, end: synced, thread, processor: None };
            self.add_to_trace(TraceEventKind::Sync, None, info.cycle, &sync, Vec::new());
        }
        // The clock was read for each run and each phase inside the cycle. The time to collect the readings
        // is measured.
        let inside = self.clock_reading_time * (runs + 2);
        let cost = inside + self.clock_reading_time * 2 + synced.elapsed();
        self.meter.cost += cost;
        if self.measuring == Measuring::Times {
            // A lower limit on the cycle's duration, in case the readings of the clock are overestimated.
            let busy = (synced - begin).saturating_sub(inside).max((synced - begin) / 10);
            self.sampler.measured(busy, cost, info.has_slept);
        }
    }

    fn add_to_trace(
        &mut self,
        kind: TraceEventKind,
        module: Option<&Arc<str>>,
        cycle: u64,
        span: &Span,
        causes: Vec<TraceCause>,
    ) {
        if let Some(tracing) = &mut self.trace {
            tracing.trace.add(kind, module, cycle, span, causes);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::Stopwatch;
    use super::*;
    use crate::threads::receipt;

    /// Runs a cycle with one run; returns whether it was measured.
    fn cycle(inspector: &mut Inspector, meter: &mut ModuleMeter, number: u64) -> bool {
        let measuring = inspector.begin();
        let mut stopwatch = Stopwatch::start(measuring);
        std::hint::black_box(number);
        let span = stopwatch.lap();
        inspector.processed();
        inspector.synced();
        if let Some(span) = span {
            inspector.ran(meter, &Arc::from("a"), number, &span, Vec::new);
        }
        inspector.end(CycleInfo {
            cycle: number,
            lateness: Some(Duration::from_nanos(number)),
            has_slept: false,
        });
        measuring.is_on()
    }

    #[test]
    fn every_measured_cycle_is_in_the_statistics() {
        let mut inspector = Inspector::new(Arc::new(SharedTiming::new()));
        let mut meter = inspector.module_meter();
        let measured = (0..10_000).filter(|&number| cycle(&mut inspector, &mut meter, number)).count() as u64;
        let statistics = inspector.statistics();
        assert!(measured > 0 && measured < 10_000, "{measured}");
        assert_eq!([statistics.process.count, statistics.sync.count, statistics.total.count], [measured; 3]);
        assert_eq!(statistics.lateness.count, measured);
        assert_eq!(meter.statistics("a", super::super::ModuleState::Active, false).run_time.count, measured);
        assert!(statistics.measuring_ns > 0);
    }

    #[test]
    fn a_trace_holds_the_cycles_that_were_asked_for() {
        let mut inspector = Inspector::off(Arc::new(SharedTiming::new()));
        let mut meter = inspector.module_meter();
        assert!(!cycle(&mut inspector, &mut meter, 0));
        let (answer, trace) = receipt();
        inspector.trace(2, answer);
        assert!(cycle(&mut inspector, &mut meter, 1));
        assert!(trace.try_take().is_none());
        assert!(cycle(&mut inspector, &mut meter, 2));
        assert!(!cycle(&mut inspector, &mut meter, 3));
        let trace = trace.try_take().unwrap();
        let kinds: Vec<_> = trace.events().iter().map(|event| (event.cycle, event.kind)).collect();
        use TraceEventKind::{Process, Run, Sync};
        assert_eq!(kinds, [(1, Process), (1, Run), (1, Sync), (2, Process), (2, Run), (2, Sync)]);
    }

    #[test]
    fn a_trace_that_waits_for_cycles_can_be_ended() {
        let mut inspector = Inspector::new(Arc::new(SharedTiming::new()));
        let mut meter = inspector.module_meter();
        let (answer, trace) = receipt();
        inspector.trace(100, answer);
        cycle(&mut inspector, &mut meter, 0);
        inspector.finish_trace();
        assert_eq!(trace.try_take().unwrap().events().len(), 3);
        let (answer, _trace) = receipt();
        inspector.trace(1, answer);
        let (other_answer, other_trace) = receipt();
        inspector.trace(1, other_answer);
        cycle(&mut inspector, &mut meter, 1);
        assert_eq!(other_trace.try_take().unwrap().events().len(), 3);
    }
}
