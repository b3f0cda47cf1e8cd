//! Requests of other threads to a running core as a whole.

use crate::cycle::Pause;
use crate::threads::receipt;
use crate::{CoreHandle, CycleTrace, Graph, LifeEvent, Listening, Receipt, Snapshot, Timing};

impl CoreHandle {
    /// Asks the core to stop after the current cycle. May be called from a signal-handling thread, and more
    /// than once.
    pub fn stop(&self) {
        self.link.request_stop();
    }

    /// True if the core has been asked to stop.
    #[must_use]
    pub fn stop_is_requested(&self) -> bool {
        self.link.stop_is_requested()
    }

    /// Makes the core and its detached modules read their clock again, after an external source has moved it.
    /// Otherwise they may sleep as long as the machine's clock would have taken to reach the next event.
    ///
    /// ```
    /// use downbeat_executor::{Clock, Core, Module, Setup, SetupError, Time};
    /// use std::sync::Arc;
    /// use std::sync::atomic::{AtomicI64, Ordering};
    /// use std::sync::mpsc::{Sender, channel};
    /// use std::time::Duration;
    ///
    /// #[derive(Clone, Default)]
    /// struct OfSimulator(Arc<AtomicI64>);
    ///
    /// impl Clock for OfSimulator {
    ///     fn now(&self) -> Time {
    ///         Time::from_nanos(self.0.load(Ordering::SeqCst))
    ///     }
    ///
    ///     fn runs_by_itself(&self) -> bool {
    ///         true
    ///     }
    /// }
    ///
    /// struct Hourly(Sender<Time>);
    ///
    /// impl Module for Hourly {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.every(Duration::from_secs(3600), |hourly: &mut Self, ctx| {
    ///             let _ = hourly.0.send(ctx.now());
    ///         })
    ///     }
    /// }
    ///
    /// let clock = OfSimulator::default();
    /// let (sender, times) = channel();
    /// let mut core = Core::new().with_clock(clock.clone());
    /// core.add("hourly", Hourly(sender))?;
    /// let handle = core.handle();
    /// let running = std::thread::spawn(move || core.run());
    /// let mut seconds = 0;
    /// while times.try_recv().is_err() {
    ///     seconds += 60;
    ///     clock.0.store(seconds * 1_000_000_000, Ordering::SeqCst);
    ///     handle.clock_moved();
    /// }
    /// handle.stop();
    /// running.join().unwrap()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn clock_moved(&self) {
        self.link.announce_clock();
    }

    /// Pauses the whole core, including detached modules: no cycle runs until it is resumed. Time goes on,
    /// and timers skip the ticks that they miss. Only [`Core::run`](crate::Core::run) obeys it.
    pub fn pause(&self) {
        self.set_pause(Pause::Paused { steps: 0 });
    }

    /// Resumes a paused core.
    pub fn resume(&self) {
        self.set_pause(Pause::Running);
    }

    /// Makes a paused core run one cycle; detached modules stay paused.
    pub fn step(&self) {
        self.look(|phase| {
            if let Pause::Paused { steps } = &mut phase.state.pause {
                *steps += 1;
            }
        });
    }

    /// True if the core is paused.
    #[must_use = "the answer is in the receipt"]
    pub fn is_paused(&self) -> Receipt<bool> {
        self.ask(|phase| phase.state.pause != Pause::Running)
    }

    /// Calls `listener` for each lifecycle step of each module until the returned value is dropped. The
    /// listener runs on the thread of the module, so it must hand over the event and return. Its effects must
    /// reach modules only as messages, requests or settings.
    ///
    /// ```
    /// use downbeat_executor::{Core, LifeStep, LifecycleState, ManualClock, Module, Setup, SetupError, Time, Transition};
    /// use std::sync::mpsc::channel;
    ///
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("camera", Camera)?;
    /// let (sender, events) = channel();
    /// let _listening = core.handle().on_transition(move |event| drop(sender.send(event.clone())));
    /// core.cycle()?;
    /// let steps: Vec<_> = events.try_iter().map(|event| event.step).collect();
    /// let (transition, from) = (Transition::Configure, LifecycleState::Unconfigured);
    /// assert_eq!(steps[0], LifeStep::Begins { transition, from });
    /// assert_eq!(steps[3], LifeStep::Made { transition: Transition::Activate, to: LifecycleState::Active });
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn on_transition(&self, listener: impl Fn(&LifeEvent) + Send + Sync + 'static) -> Listening {
        self.link.listeners.add(listener)
    }

    /// The counters and measurements of the core, taken between two cycles.
    #[must_use = "the answer is in the receipt"]
    pub fn snapshot(&self) -> Receipt<Snapshot> {
        self.ask(Snapshot::of)
    }

    /// Traces the next cycles, at least one. The receipt is answered when they have run; see
    /// [`finish_trace`](Self::finish_trace).
    #[must_use = "the answer is in the receipt"]
    pub fn trace(&self, cycles: u32) -> Receipt<CycleTrace> {
        let (answer, trace) = receipt();
        self.look(move |phase| phase.state.inspector.trace(cycles, answer));
        trace
    }

    /// Ends a trace early, with the cycles so far; for a core that may run no further cycle soon.
    pub fn finish_trace(&self) {
        self.look(|phase| phase.state.inspector.finish_trace());
    }

    /// The graph of modules with their publications, subscriptions, servers and clients.
    #[must_use = "the answer is in the receipt"]
    pub fn graph(&self) -> Receipt<Graph> {
        self.ask(|phase| Graph::of(phase.stage, phase.state, phase.mechanisms))
    }

    /// The durations of cycles so far, and the regularity of detached modules. Neither waits for the core nor
    /// wakes it, and also works after the core has stopped.
    ///
    /// ```
    /// use downbeat_executor::{Core, ManualClock, Time};
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// let handle = core.handle();
    /// (0..3).try_for_each(|_| core.cycle())?;
    /// let timing = handle.timing();
    /// assert_eq!(timing.cycles, 3);
    /// println!("the longest of those measured took {} ns", timing.cycle.max_ns);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn timing(&self) -> Timing {
        self.link.timing.timing()
    }

    fn set_pause(&self, pause: Pause) {
        self.look(move |phase| {
            phase.state.pause = pause;
            let is_held = pause != Pause::Running;
            phase.state.detached.iter().flatten().for_each(|module| module.hold(is_held));
        });
    }
}
