//! The core of a library, with its one module.

use crate::host::Robot;
use crate::last_panic;
use bytes::Bytes;
use downbeat_edge::{
    CoreAccess, EncodedCallError, EncodedCaller, EncodedInlet, Interfaces, RemoteCall, RemoteServices,
};
use downbeat_executor::{
    CallError, Core, GraphEdge, Inbox, LifecycleState, ManualClock, Module, ModuleOptions, OutletInbox,
    SettingInfo, SettingValue, Time, Transition,
};
use downbeat_library_abi::{EventV1, event, transition};
use parking_lot::Mutex;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

/// Longer than any call: calls end when the client's own time is up.
const TIMEOUT: Duration = Duration::from_secs(86_400 * 365);
/// How many cycles one run may take before the rest waits for the next.
const MOST_CYCLES: u32 = 64;

pub(crate) struct Inner {
    core: Core,
    clock: ManualClock,
    name: String,
    inlets: Vec<EncodedInlet>,
    callers: Vec<EncodedCaller>,
    settings: Vec<String>,
    leaving: Leaving,
    /// Calls of the module that the robot has not answered.
    calls: HashMap<u64, OnAnswer>,
    /// Wakes the library when its core has something to do.
    task: u32,
    scheduled: Option<Time>,
    has_ended: bool,
}

/// What leaves the core, in order.
type Leaving = Arc<Mutex<Vec<Out>>>;
type OnAnswer = Box<dyn FnOnce(Result<Bytes, String>) + Send>;

enum Out {
    Message { publisher: u32, cdr: Bytes },
    Call { client: u32, request: Bytes, on_answer: OnAnswer },
    Answer { request: u64, result: Result<Vec<u8>, String> },
}

/// Takes the calls of a service outside the library.
struct Calls {
    client: u32,
    leaving: Leaving,
}

impl RemoteCall for Calls {
    fn call(&mut self, request: Box<dyn FnOnce() -> Bytes + Send>, on_answer: OnAnswer) {
        self.leaving.lock().push(Out::Call { client: self.client, request: request(), on_answer });
    }
}

impl Inner {
    /// Sets a module up, and declares to the robot what it declares.
    pub(crate) fn new<M: Module>(
        robot: &Robot,
        make: impl Fn() -> M,
        interfaces: Interfaces,
    ) -> Result<Self, String> {
        let name = robot.name();
        let clock = ManualClock::new(Time::ZERO);
        let build = |settings| {
            let mut core = Core::new().with_clock(clock.clone()).without_times();
            let initial_state = LifecycleState::Unconfigured;
            let options = ModuleOptions { initial_state, settings, ..ModuleOptions::default() };
            core.add_with(&name, make(), options).map(|()| core).map_err(|error| error.to_string())
        };
        let declared: Vec<SettingInfo> = build(BTreeMap::new())?.settings(&name).unwrap_or_default();
        let mut given = BTreeMap::new();
        for setting in &declared {
            given.insert(setting.name.clone(), robot.setting(setting)?);
        }
        let mut inner = Self {
            core: build(given)?,
            clock: clock.clone(),
            name: name.clone(),
            inlets: Vec::new(),
            callers: Vec::new(),
            settings: declared.into_iter().map(|setting| setting.name).collect(),
            leaving: Leaving::default(),
            calls: HashMap::new(),
            task: robot.task()?,
            scheduled: None,
            has_ended: false,
        };
        robot.each_run()?;
        inner.join(robot, &interfaces)?;
        Ok(inner)
    }

    /// Connects the ports of the module with the robot.
    fn join(&mut self, robot: &Robot, interfaces: &Interfaces) -> Result<(), String> {
        let core = &mut self.core;
        // Every robot knows what this crate carries.
        let is_part = |name: &str| name.rsplit('/').next().is_some_and(|last| last.contains('_'));
        for described in interfaces.registered().filter(|described| !is_part(described.type_name)) {
            robot.define(described.type_name, described.definition)?;
        }
        let graph = core.graph();
        let both_ways = |what: &str, name: &str| {
            Err(format!("it has both ends of the {what} \"{name}\", which a module of a library cannot"))
        };
        let topics: Vec<_> = core.topics().cloned().collect();
        let inbox = OutletInbox::new("library", Inbox::KeepAll);
        let mut publishers = 0_u32;
        for topic in &topics {
            let is_topic = |index: usize| graph.topics[index].name == *topic.name;
            let publishes = graph
                .edges
                .iter()
                .any(|edge| matches!(edge, GraphEdge::Publishes { topic, .. } if is_topic(*topic)));
            let subscribes = graph
                .edges
                .iter()
                .any(|edge| matches!(edge, GraphEdge::Subscribes { topic, .. } if is_topic(*topic)));
            if publishes && subscribes {
                return both_ways("topic", &topic.name);
            }
            if !publishes && !subscribes {
                continue;
            }
            let of = interfaces.message_in(topic).ok_or_else(|| {
                format!(
                    "topic \"{}\" carries {}, which is no ROS 2 message that `export_module!` was given",
                    topic.name, topic.message_type
                )
            })?;
            if publishes {
                robot.publisher(&topic.name, of.name(), of.hash())?;
                let (leaving, publisher) = (Arc::clone(&self.leaving), publishers);
                let sink = move |_: Time, cdr: Bytes| leaving.lock().push(Out::Message { publisher, cdr });
                let outlet = of.outlet(&mut CoreAccess::Idle(core), &topic.name, &inbox, sink);
                outlet.map_err(|error| error.to_string())?.keep();
                publishers += 1;
            } else {
                robot.subscription(&topic.name, of.name(), of.hash())?;
                self.inlets.push(of.inlet(core, &topic.name).map_err(|error| error.to_string())?);
            }
        }
        let services: Vec<_> = core.services().cloned().collect();
        let mut remote = Vec::new();
        for service in &services {
            let is_service = |index: usize| graph.services[index].name == *service.name;
            let is_called = graph
                .edges
                .iter()
                .any(|edge| matches!(edge, GraphEdge::Calls { service, .. } if is_service(*service)));
            let of = interfaces.service_in(core, &service.name).ok_or_else(|| {
                format!(
                    "service \"{}\" has requests of the type {}, which is of no ROS 2 service that `export_module!` was given",
                    service.name, service.request_type
                )
            })?;
            match (service.server.is_some(), is_called) {
                (true, true) => return both_ways("service", &service.name),
                (true, false) => {
                    robot.server(&service.name, of.name(), of.hash())?;
                    self.callers.push(of.caller(core, &service.name).map_err(|error| error.to_string())?);
                }
                (false, _) => {
                    robot.client(&service.name, of.name(), of.hash(), TIMEOUT)?;
                    let calls = Calls { client: remote.len() as u32, leaving: Arc::clone(&self.leaving) };
                    remote.push(of.remote(core, &service.name, calls).map_err(|error| error.to_string())?);
                }
            }
        }
        RemoteServices::add_to(core, &format!("{}_calls", self.name), remote)
            .map_err(|error| error.to_string())
    }

    pub(crate) fn handle(&mut self, robot: &Robot, event: &EventV1, data: &[u8]) -> Result<(), String> {
        self.set_clock(robot);
        let port = event.port as usize;
        match event.kind {
            event::MESSAGE => {
                if let Some(inlet) = self.inlets.get(port) {
                    inlet.publish(data).map_err(|error| error.to_string())?;
                }
            }
            event::REQUEST => {
                if let Some(caller) = self.callers.get(port) {
                    let (leaving, request) = (Arc::clone(&self.leaving), event.id);
                    caller.call(data, TIMEOUT, move |answer| {
                        let result = answer.map(|answer| answer.into_cdr()).map_err(|error| match error {
                            EncodedCallError::Call(CallError::Refused { reason, .. }) => reason,
                            error => error.to_string(),
                        });
                        leaving.lock().push(Out::Answer { request, result });
                    });
                }
            }
            event::REPLY => {
                if let Some(on_answer) = self.calls.remove(&event.id) {
                    on_answer(match event.is_error {
                        0 => Ok(Bytes::copy_from_slice(data)),
                        _ => Err(String::from_utf8_lossy(data).into_owned()),
                    });
                }
            }
            // The value was set when it was checked.
            event::SETTING | event::TIMER => {}
            event::TASK => self.scheduled = None,
            // The whole run at once, in the order of a module that is compiled in.
            _ => self.run(robot)?,
        }
        Ok(())
    }

    pub(crate) fn transition(&mut self, robot: &Robot, number: u32) -> Result<(), String> {
        self.set_clock(robot);
        let transition = match number {
            transition::CONFIGURE => Transition::Configure,
            transition::CLEANUP => Transition::Cleanup,
            transition::ACTIVATE => Transition::Activate,
            transition::DEACTIVATE => Transition::Deactivate,
            _ => Transition::Shutdown,
        };
        self.has_ended |= transition == Transition::Shutdown;
        // The robot has forgotten what was scheduled.
        self.scheduled = None;
        let made = self.core.handle().transition(&self.name, transition);
        self.run(robot)?;
        match made.try_take() {
            Some(Err(refused)) => Err(refused.to_string()),
            _ => Ok(()),
        }
    }

    /// Gives a setting a value, if the module accepts it. The module learns of it in its next run.
    pub(crate) fn accept(&mut self, setting: u32, value: SettingValue) -> Result<(), String> {
        let Some(name) = self.settings.get(setting as usize) else { return Ok(()) };
        let set = self.core.handle().set(&self.name, name, value);
        self.core.cycle().map_err(|error| error.to_string())?;
        match set.try_take() {
            Some(Err(refused)) => Err(refused.to_string()),
            _ => Ok(()),
        }
    }

    /// The module as it describes itself.
    pub(crate) fn debug(&self) -> Option<String> {
        self.core.debug(&self.name)
    }

    fn set_clock(&mut self, robot: &Robot) {
        self.clock.set(robot.now());
    }

    /// Runs cycles until nothing is left to do now, and hands the robot what came out.
    fn run(&mut self, robot: &Robot) -> Result<(), String> {
        let now = robot.now();
        let mut next = None;
        for _ in 0..MOST_CYCLES {
            self.core.cycle().map_err(|error| error.to_string())?;
            next = self.core.next_event();
            if next.is_none_or(|time| time > now) {
                break;
            }
        }
        let leaving = std::mem::take(&mut *self.leaving.lock());
        for out in leaving {
            match out {
                Out::Message { publisher, cdr } => robot.publish(publisher, &cdr)?,
                Out::Answer { request, result } => robot.reply(request, &result)?,
                Out::Call { client, request, on_answer } => {
                    self.calls.insert(robot.call(client, &request)?, on_answer);
                }
            }
        }
        let module = self.core.modules().into_iter().find(|module| *module.name == *self.name);
        match module.map(|module| module.state) {
            None => return robot.remove(&self.name),
            Some(LifecycleState::Finalized) if !self.has_ended => {
                return Err(last_panic().unwrap_or_else(|| "it panicked".to_owned()));
            }
            Some(_) => {}
        }
        if next != self.scheduled
            && let Some(time) = next
        {
            robot.schedule_after(self.task, time.saturating_since(now))?;
        }
        self.scheduled = next;
        Ok(())
    }
}
