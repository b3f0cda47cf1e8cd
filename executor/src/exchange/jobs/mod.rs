//! The mechanism "jobs": work outside the cycle. Work that blocks or waits runs on other threads, and its
//! result is delivered in a sync phase.

mod workers;

use std::any::Any;
use std::future::Future;
use std::marker::PhantomData;
use std::pin::Pin;
use std::sync::Arc;

use workers::Workers;

use super::events::{ModuleEventKind, note_event_of};
use crate::module::{Causes, JOBS, Link};
use crate::{
    Context, Core, CoreHandle, Mechanism, Module, ModuleChange, ModuleId, Port, Setup, Step, SyncPhase,
    Version,
};

/// Starts the jobs of modules, and delivers their results in the order in which the jobs ended, before the
/// messages of the cycle.
#[derive(Default)]
pub(crate) struct Jobs {
    workers: Workers,
    /// Jobs of detached modules.
    work: Vec<Work>,
    results: Vec<JobResult>,
    /// Results that are held until their release, in a replay.
    held: Option<HeldResults>,
}

impl Mechanism for Jobs {
    type View = ();
    type Port = JobsPort;

    const NAME: &'static str = "jobs";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        phase.each_asker(JOBS, |cell, _| {
            if let Some(port) = cell.port::<JobsPort>(JOBS) {
                self.work.append(&mut port.work);
            }
        });
        let works_inside = !phase.state.clock.runs_by_itself();
        let has_worked = works_inside && !self.work.is_empty();
        for work in std::mem::take(&mut self.work) {
            if works_inside {
                Workers::run(work);
            } else {
                self.workers.start(work);
            }
        }
        if has_worked {
            phase.join_again(JOBS, self);
        }
        let mut results = std::mem::take(&mut self.results);
        if let Some(held) = &mut self.held {
            results = held.release(phase, results);
        }
        for result in results {
            deliver(phase, result);
        }
    }

    fn join(&mut self, _: Step, part: Box<dyn Any + Send>) {
        if let Ok(mut work) = part.downcast::<Vec<Work>>() {
            self.work.append(&mut work);
        }
    }
}

/// A module's part of the mechanism "jobs".
#[derive(Default)]
pub(crate) struct JobsPort {
    /// In the order of declaration.
    jobs: Vec<Box<dyn AnyJob>>,
    work: Vec<Work>,
}

impl Port for JobsPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.work.clear();
        }
        false
    }

    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        Some(Box::new(std::mem::take(&mut self.work)))
    }
}

impl JobsPort {
    fn take_results<T: Send + 'static>(&mut self, job: Job<T>) -> Vec<Result<T, JobError>> {
        let job = self.jobs.get_mut(job.port as usize).map(|job| &mut **job as &mut dyn Any);
        job.and_then(|job| job.downcast_mut::<JobState<T>>())
            .map(|job| std::mem::take(&mut job.results))
            .unwrap_or_default()
    }
}

struct JobResult {
    module: ModuleId,
    port: u32,
    /// The number of the result among those of the job.
    number: u64,
    /// An `Option<Result<T, JobError>>`.
    result: Box<dyn Any + Send>,
}

/// Results that have not been released, and releases whose results have not arrived.
#[derive(Default)]
struct HeldResults {
    results: Vec<JobResult>,
    /// Each release gives the name of the module, the job and the number of the result.
    releases: Vec<(Arc<str>, u32, u64)>,
}

impl HeldResults {
    /// Adds new results; returns those that are released, in the order of the releases.
    fn release(&mut self, phase: &SyncPhase<'_>, new: Vec<JobResult>) -> Vec<JobResult> {
        self.results.extend(new);
        let Self { results, releases } = self;
        let mut released = Vec::new();
        releases.retain(|(module, port, number)| {
            let found = results.iter().position(|result| {
                (result.port, result.number) == (*port, *number)
                    && phase.module_name(result.module) == Some(&**module)
            });
            released.extend(found.map(|position| results.remove(position)));
            found.is_none()
        });
        released
    }
}

fn deliver(phase: &mut SyncPhase<'_>, JobResult { module, port, number, result }: JobResult) {
    note_event_of(phase, module, |name| ModuleEventKind::JobResult { module: name, job: port, number });
    phase.change(module, Causes::RESULTS, 1, move |cell| {
        let jobs = cell.port::<JobsPort>(JOBS);
        if let Some(job) = jobs.and_then(|jobs| jobs.jobs.get_mut(port as usize)) {
            job.accept(result);
        }
    });
}

/// A module's key to a callback for the results of a job, from [`Setup::job`](crate::Setup::job).
pub struct Job<T> {
    pub(crate) port: u32,
    result: PhantomData<fn(T)>,
}

impl<T> Job<T> {
    pub(crate) fn new(port: u32) -> Self {
        Self { port, result: PhantomData }
    }
}

impl<T> Clone for Job<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Job<T> {}

/// The reason why a job has no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JobError {
    /// The job panicked, or its [`Completion`] was dropped.
    #[error("the job ended without a result: it panicked or was dropped")]
    Lost,
}

/// Returns the result of a job to its module, from any thread or async task; from
/// [`Context::completion`](crate::Context::completion).
///
/// Dropping a completion without a result sends [`JobError::Lost`], so that the module does not wait forever.
#[must_use = "a completion that is dropped ends the job without a result"]
pub struct Completion<T: Send + 'static> {
    link: Option<Arc<Link>>,
    module: ModuleId,
    port: u32,
    number: u64,
    result: PhantomData<fn(T)>,
}

impl<T: Send + 'static> Completion<T> {
    pub(crate) fn new(link: Arc<Link>, module: ModuleId, job: Job<T>, number: u64) -> Self {
        Self { link: Some(link), module, port: job.port, number, result: PhantomData }
    }

    /// Sends the result, which is delivered in the next sync phase.
    pub fn finish(mut self, result: T) {
        self.send(Ok(result));
    }

    fn send(&mut self, result: Result<T, JobError>) {
        if let Some(link) = self.link.take() {
            let Self { module, port, number, .. } = *self;
            let result = JobResult { module, port, number, result: Box::new(Some(result)) };
            link.post(JOBS, |jobs: &mut Jobs| jobs.results.push(result));
        }
    }
}

impl<T: Send + 'static> Drop for Completion<T> {
    fn drop(&mut self) {
        self.send(Err(JobError::Lost));
    }
}

/// A job that the sync phase starts.
enum Work {
    /// A closure that may block its thread.
    Blocking(Box<dyn FnOnce() + Send>),
    /// A future, which must not block its thread.
    Async(Pin<Box<dyn Future<Output = ()> + Send>>),
}

/// The results of one job that the module has not received yet.
struct JobState<T> {
    results: Vec<Result<T, JobError>>,
    next: u64,
}

/// A [`JobState`] with its type erased.
trait AnyJob: Any + Send {
    /// The number for the next result of the job.
    fn next_number(&mut self) -> u64;
    /// Takes an `Option<Result<T, JobError>>`.
    fn accept(&mut self, result: Box<dyn Any + Send>);
}

impl<T: Send + 'static> AnyJob for JobState<T> {
    fn next_number(&mut self) -> u64 {
        let number = self.next;
        self.next += 1;
        number
    }

    fn accept(&mut self, result: Box<dyn Any + Send>) {
        if let Ok(result) = result.downcast::<Option<Result<T, JobError>>>() {
            self.results.extend(*result);
        }
    }
}

impl<M: Module> Setup<'_, M> {
    /// Declares a job and the callback for its results; the key is for [`Context::spawn`].
    pub fn job<T, F>(&mut self, mut on_result: F) -> Job<T>
    where
        T: Send + 'static,
        F: FnMut(&mut M, Result<T, JobError>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let jobs = &mut self.io.open_own::<JobsPort>(JOBS).jobs;
        let job = Job::new(u32::try_from(jobs.len()).unwrap_or(u32::MAX));
        jobs.push(Box::new(JobState::<T> { results: Vec::new(), next: 0 }));
        self.steps.add(Causes::RESULTS, move |module, ctx| {
            let results = ctx.io().port::<JobsPort>(JOBS).map(|port| port.take_results(job));
            for result in results.into_iter().flatten() {
                on_result(module, result, ctx);
            }
        });
        job
    }
}

impl<P> Context<'_, P> {
    /// Runs `work` on another thread, where it may block. Its result is passed to the callback of the job.
    ///
    /// Under a clock that does not run by itself, `work` runs inside the next sync phase.
    pub fn spawn<T: Send + 'static>(&mut self, job: Job<T>, work: impl FnOnce() -> T + Send + 'static) {
        let completion = self.completion(job);
        self.work(Work::Blocking(Box::new(move || completion.finish(work()))));
    }

    /// Runs `work` outside the cycle, on one thread for the async jobs of all modules. Its result is passed
    /// to the callback of the job.
    ///
    /// Under a clock that does not run by itself, `work` runs to its end inside the next sync phase. Futures
    /// that need a particular runtime, such as tokio's, are spawned on that runtime with a
    /// [`completion`](Self::completion).
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// struct Weather;
    ///
    /// impl Module for Weather {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let wind = setup.publish::<f64>("wind")?;
    ///         let asking = setup.job::<f64, _>(move |_, answer, ctx| {
    ///             if let Ok(metres_per_second) = answer {
    ///                 ctx.publish(wind, metres_per_second);
    ///             }
    ///         });
    ///         setup.subscribe::<(), _>("ask", move |_, _, ctx| {
    ///             ctx.spawn_async(asking, async { 4.2 }); // A real one would await a socket.
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("weather", Weather)?;
    /// core.inlet("ask")?.publish(())?;
    /// (0..3).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "wind").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn spawn_async<T: Send + 'static>(
        &mut self,
        job: Job<T>,
        work: impl Future<Output = T> + Send + 'static,
    ) {
        let completion = self.completion(job);
        self.work(Work::Async(Box::pin(async move { completion.finish(work.await) })));
    }

    /// A handle that passes one result to the callback of the job, from any thread or runtime.
    ///
    /// ```
    /// # use downbeat_executor::{Completion, Core, ManualClock, Module, Setup, SetupError, Time};
    /// # use std::sync::mpsc::{Sender, channel};
    /// /// Hands positions to a library that answers on a thread of its own.
    /// struct Localisation(Sender<Completion<f64>>);
    ///
    /// impl Module for Localisation {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let found = setup.publish::<f64>("heading")?;
    ///         let answer = setup.job::<f64, _>(move |_, heading, ctx| {
    ///             if let Ok(radians) = heading {
    ///                 ctx.publish(found, radians);
    ///             }
    ///         });
    ///         setup.subscribe::<(), _>("look", move |module, _, ctx| {
    ///             let completion = ctx.completion(answer);
    ///             drop(module.0.send(completion));
    ///         })
    ///     }
    /// }
    ///
    /// let (sender, library) = channel();
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("localisation", Localisation(sender))?;
    /// core.inlet("look")?.publish(())?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// let work = std::thread::spawn(move || library.recv().map(|completion| completion.finish(1.57)));
    /// work.join().unwrap()?;
    /// core.cycle()?; // The result joins.
    /// core.cycle()?; // The module has it.
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "heading").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn completion<T: Send + 'static>(&mut self, job: Job<T>) -> Completion<T> {
        let port = self.io().port::<JobsPort>(JOBS).and_then(|jobs| jobs.jobs.get_mut(job.port as usize));
        let Some(port) = port else { self.foreign("asked for work with") };
        let number = port.next_number();
        Completion::new(Arc::clone(&self.io().link), self.io().id, job, number)
    }

    fn work(&mut self, work: Work) {
        self.io().ask(JOBS);
        if let Some(jobs) = self.io().port::<JobsPort>(JOBS) {
            jobs.work.push(work);
        }
    }
}

impl Core {
    /// Holds the results of jobs until each is released by [`CoreHandle::release_result`]. This is for a
    /// replay, in which the jobs run again and their results are delivered in the recorded cycles.
    pub fn hold_results(&mut self) {
        if let Some(jobs) = self.mechanisms.get_mut::<Jobs>(JOBS) {
            jobs.held.get_or_insert_default();
        }
    }
}

impl CoreHandle {
    /// Delivers the result of a job in the next sync phase, or as soon as it is there; see
    /// [`Core::hold_results`](crate::Core::hold_results). `job` is the index of the job in the order of
    /// declaration by the module, `number` the number of the result.
    pub fn release_result(&self, module: &str, job: u32, number: u64) {
        let module = module.into();
        self.link.post(JOBS, move |jobs: &mut Jobs| {
            if let Some(held) = &mut jobs.held {
                held.releases.push((module, job, number));
            }
        });
    }
}
