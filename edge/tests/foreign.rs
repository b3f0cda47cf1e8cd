//! Modules in other languages, here played by closures.
#![allow(clippy::unwrap_used)]

use bytes::Bytes;
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::{
    Declarations, Event, Foreign, ForeignContext, ForeignModule, SavedState, SettingDeclaration,
};
use downbeat_executor::{
    Core, Failure, Inbox, LifecycleState, ManualClock, ModuleOptions, Restart, SettingValue, Time,
};
use downbeat_msgs::std_msgs::msg::Float64;
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use downbeat_msgs::{Message, cdr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

type SetUp = fn(&mut Declarations) -> Result<(), String>;
type Handle = Box<dyn FnMut(Event, &mut ForeignContext<'_, '_>) -> Result<(), Failure> + Send>;

/// A module of two functions.
struct Played {
    set_up: SetUp,
    handle: Handle,
}

impl Foreign for Played {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        (self.set_up)(declarations)
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        (self.handle)(event, context)
    }
}

struct Robot {
    core: Core,
    clock: ManualClock,
}

impl Robot {
    fn new() -> Self {
        let clock = ManualClock::new(Time::ZERO);
        Self { core: Core::new().with_clock(clock.clone()), clock }
    }

    fn add<F: Foreign>(
        &mut self,
        name: &str,
        options: ModuleOptions,
        make: impl Fn() -> F + Send + Sync + 'static,
    ) -> Result<(), String> {
        let make = Arc::new(move || Ok(Box::new(make()) as Box<dyn Foreign>));
        let of_module = options.clone();
        let make = move || ForeignModule::new(make.clone(), Interfaces::carried(), of_module.clone());
        self.core.add_restartable(name, make, options).map_err(|error| error.to_string())
    }

    fn receive(&mut self, topic: &str) -> Receiver<f64> {
        let (sender, receiver) = channel();
        let take = move |message: downbeat_executor::Received<'_, Float64>| _ = sender.send(message.data);
        std::mem::forget(self.core.outlet(topic, Inbox::KeepAll, take).unwrap());
        receiver
    }

    fn cycles(&mut self, count: u32) {
        for _ in 0..count {
            self.core.cycle().unwrap();
            self.clock.advance(Duration::from_millis(10));
        }
    }
}

fn float(value: f64) -> Vec<u8> {
    cdr::to_vec(&Float64 { data: value })
}

fn float_of(cdr: &Bytes) -> f64 {
    cdr::from_slice::<Float64>(cdr).unwrap().data
}

fn gain(default: f64) -> SettingDeclaration {
    SettingDeclaration {
        name: "gain".to_owned(),
        description: "of the output".to_owned(),
        default: default.into(),
        range: Some(0.0..=10.0),
        is_read_only: false,
    }
}

/// Publishes on `out` what it receives on `in`, times its setting `gain`.
fn amplifier() -> Played {
    let set_up = |declarations: &mut Declarations| {
        declarations.publish("out", "std_msgs/msg/Float64", None);
        declarations.subscribe("in", "std_msgs/msg/Float64", Some(Float64::TYPE_HASH));
        declarations.setting(gain(2.0)).map(drop)
    };
    let handle = |event, context: &mut ForeignContext<'_, '_>| {
        let Event::Message { cdr, .. } = event else { return Ok(()) };
        let SettingValue::Double(gain) = context.setting(0)? else { return Err("another kind".into()) };
        let amplified = float(gain * float_of(&cdr));
        Ok(context.publish(0, &amplified)?)
    };
    Played { set_up, handle: Box::new(handle) }
}

#[test]
fn messages_and_settings_reach_it_and_leave_it_as_bytes() {
    let mut robot = Robot::new();
    robot.add("amplifier", ModuleOptions::default(), amplifier).unwrap();
    let out = robot.receive("out");
    let input = robot.core.inlet::<Float64>("in").unwrap();
    input.publish(Float64 { data: 1.5 }).unwrap();
    robot.cycles(3);
    let refused = robot.core.handle().set("amplifier", "gain", 11.0);
    drop(robot.core.handle().set("amplifier", "gain", 4_i64));
    input.publish(Float64 { data: 1.5 }).unwrap();
    robot.cycles(3);
    assert!(refused.try_take().unwrap().unwrap_err().to_string().contains("11 is out of range"));
    assert_eq!(out.try_iter().collect::<Vec<_>>(), [3.0, 6.0]);
}

#[test]
fn services_are_served_and_called() {
    let mut robot = Robot::new();
    let server = || Played {
        set_up: |declarations| {
            declarations.serve("enable", "std_srvs/srv/SetBool", None);
            Ok(())
        },
        handle: Box::new(|event, context| {
            let Event::Request { request, cdr, .. } = event else { return Ok(()) };
            let SetBoolRequest { data } = cdr::from_slice(&cdr).unwrap();
            if !data {
                return Ok(context.reply(request, Err("it stays on".to_owned()))?);
            }
            let response = cdr::to_vec(&SetBoolResponse { success: data, message: "on".to_owned() });
            context.reply(request, Ok(&response))?;
            assert!(context.reply(request, Ok(&response)).is_err(), "it is answered");
            Ok(())
        }),
    };
    let (sender, replies) = channel();
    let client = move || {
        let sender = sender.clone();
        Played {
            set_up: |declarations| {
                declarations.client("enable", "std_srvs/srv/SetBool", None, Duration::from_secs(1));
                declarations.every(Duration::from_millis(20));
                Ok(())
            },
            handle: Box::new(move |event, context| {
                match event {
                    Event::Timer { .. } => {
                        for data in [true, false] {
                            let request = cdr::to_vec(&SetBoolRequest { data });
                            context.call(0, &request)?;
                        }
                    }
                    Event::Reply { call, result, .. } => drop(sender.send((call, result))),
                    other => return Err(format!("{other:?}").into()),
                }
                Ok(())
            }),
        }
    };
    robot.add("server", ModuleOptions::default(), server).unwrap();
    robot.add("client", ModuleOptions::default(), client).unwrap();
    robot.cycles(5);
    let (first, second) = (replies.try_recv().unwrap(), replies.try_recv().unwrap());
    assert_eq!(cdr::from_slice::<SetBoolResponse>(&first.1.unwrap()).unwrap().message, "on");
    assert_eq!((first.0, second.0), (0, 1));
    assert_eq!(second.1.unwrap_err(), "service \"enable\": it stays on");
}

#[test]
fn an_error_ends_the_module_alone_and_its_policy_starts_it_again() {
    let mut robot = Robot::new();
    let made = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&made);
    let restart = Restart::Times { limit: 1, backoff: Duration::from_millis(10) };
    let options = ModuleOptions { restart, ..ModuleOptions::default() };
    let failing = move || {
        count.fetch_add(1, Ordering::Relaxed);
        Played {
            set_up: |declarations| {
                declarations.every(Duration::from_millis(10));
                Ok(())
            },
            handle: Box::new(|_, _| Err("Traceback: line 7".into())),
        }
    };
    robot.add("failing", options, failing).unwrap();
    robot.add("amplifier", ModuleOptions::default(), amplifier).unwrap();
    robot.cycles(10);
    let states: Vec<_> = robot.core.modules().iter().map(|module| (module.state, module.restarts)).collect();
    assert_eq!(states, [(LifecycleState::Finalized, 1), (LifecycleState::Active, 0)]);
    assert_eq!(made.load(Ordering::Relaxed), 2);
}

#[test]
fn what_it_was_not_compiled_for_is_refused_with_the_remedy() {
    let mut robot = Robot::new();
    let mut refusal = |set_up: SetUp| {
        robot.add("module", ModuleOptions::default(), move || Played {
            set_up,
            handle: Box::new(|_, _| Ok(())),
        })
    };
    for (set_up, words) in [
        (
            (|declarations| {
                declarations.publish("out", "std_msgs/msg/Float64", Some("RIHS01_00"));
                Ok(())
            }) as SetUp,
            ["another definition of std_msgs/msg/Float64: RIHS01_00", "compile it again"],
        ),
        (
            |declarations| {
                declarations.subscribe("in", "std_msgs/msg/Flaot64", None);
                Ok(())
            },
            ["std_msgs/msg/Flaot64", "did you mean \"std_msgs/msg/Float64\"?"],
        ),
        (|_| Err("no camera".to_owned()), ["module \"module\"", "no camera"]),
    ] {
        let error = refusal(set_up).unwrap_err();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

/// Counts over its versions: publishes on `count` how many timers it has had, and its version.
struct Versioned {
    version: u32,
    newest: Arc<AtomicU32>,
    ticks: f64,
}

impl Foreign for Versioned {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        if self.version == 3 {
            return Err("version 3 has a mistake".to_owned());
        }
        let message = if self.version == 4 { "std_msgs/msg/Bool" } else { "std_msgs/msg/Float64" };
        declarations.publish("count", message, None);
        declarations.publish("gains", "std_msgs/msg/Float64", None);
        declarations.serve("reset", "std_srvs/srv/Trigger", None);
        declarations.every(Duration::from_millis(10));
        declarations.setting(gain(1.0))?;
        declarations.reload();
        Ok(())
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        if let Event::Timer { .. } = event {
            self.ticks += 1.0;
            let _ = context.publish(0, &float(self.ticks));
            let SettingValue::Double(gain) = context.setting(0)? else {
                return Ok(());
            };
            let gain = float(*gain);
            context.publish(1, &gain)?;
        }
        Ok(())
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        let newest = self.newest.load(Ordering::Relaxed);
        if newest <= self.version {
            return Ok(None);
        }
        // As for a file: each change is tried once.
        self.version = newest;
        if newest == 2 {
            return Err("it cannot be imported".to_owned());
        }
        Ok(Some(Box::new(Self { version: newest, newest: Arc::clone(&self.newest), ticks: 0.0 })))
    }

    fn save(&mut self) -> Result<SavedState, String> {
        Ok(Box::new(self.ticks))
    }

    fn restore(&mut self, state: SavedState) -> Result<(), String> {
        self.ticks = *state.downcast::<f64>().map_err(|_| "no count")?;
        Ok(())
    }
}

#[test]
fn a_newer_version_takes_over_with_state_and_settings_or_the_old_one_goes_on() {
    let mut robot = Robot::new();
    let newest = Arc::new(AtomicU32::new(1));
    let of_module = Arc::clone(&newest);
    let make = move || Versioned { version: 1, newest: Arc::clone(&of_module), ticks: 0.0 };
    robot.add("versioned", ModuleOptions::default(), make).unwrap();
    let (counts, gains) = (robot.receive("count"), robot.receive("gains"));
    robot.cycles(30);
    drop(robot.core.handle().set("versioned", "gain", 7.0));
    // 2 cannot be loaded, 3 fails in its setup, 4 declares a topic of another type, which the core refuses.
    for version in [2, 3, 4, 5] {
        newest.store(version, Ordering::Relaxed);
        robot.cycles(50);
        assert_eq!(robot.core.modules()[0].state, LifecycleState::Active, "version {version}");
    }
    let counts: Vec<f64> = counts.try_iter().collect();
    assert!(counts.len() > 200, "{}", counts.len());
    let is_next = |pair: &[f64]| pair[1] == pair[0] + 1.0;
    assert!(counts.windows(2).all(is_next), "no version lost the count: {counts:?}");
    assert_eq!(gains.try_iter().last(), Some(7.0));
}

/// Serves `enable` and keeps each request; a newer version takes over as soon as it has one.
struct Keeper {
    has_request: Arc<AtomicU32>,
    is_newer: bool,
}

impl Foreign for Keeper {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        declarations.reload();
        declarations.serve("enable", "std_srvs/srv/SetBool", None);
        Ok(())
    }

    fn handle(&mut self, event: Event, _: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        if let Event::Request { .. } = event {
            self.has_request.store(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        let is_due = self.has_request.load(Ordering::Relaxed) == 1 && !self.is_newer;
        let newer = Self { has_request: Arc::clone(&self.has_request), is_newer: true };
        Ok(is_due.then(|| Box::new(newer) as Box<dyn Foreign>))
    }
}

#[test]
fn a_request_is_answered_whatever_the_module_does_with_it() {
    /// Calls `enable`, lets the robot run, and returns the message of the response that a client of ROS 2
    /// has.
    fn answer(robot: &mut Robot) -> String {
        let service = Interfaces::carried().service("std_srvs/srv/SetBool").unwrap();
        let (sender, answer) = channel();
        let caller = service.caller(&mut robot.core, "enable").unwrap();
        let request = cdr::to_vec(&SetBoolRequest { data: true });
        caller.call(&request, Duration::from_secs(3600), move |result| {
            sender.send(result.map(|answer| answer.into_cdr())).unwrap();
        });
        robot.cycles(60);
        let error = answer.try_recv().expect("there is an answer").unwrap_err();
        let refusal = service.refusals().response(&error.to_string());
        let response: SetBoolResponse = cdr::from_slice(&refusal).unwrap();
        assert!(!response.success);
        response.message
    }
    type Does = fn(u64, &mut ForeignContext<'_, '_>) -> Result<(), Failure>;
    let cases: [(Does, &str); 4] = [
        (|request, context| Ok(context.reply(request, Err("I will not".to_owned()))?), "I will not"),
        (
            |request, context| {
                assert!(context.reply(request, Ok(&[0, 1, 0, 0, 9])).is_err());
                Ok(())
            },
            "are no response of std_srvs/srv/SetBool",
        ),
        (|_, _| Err("it has no lamp".into()), "module \"server\" has failed: it has no lamp"),
        (
            // A traceback is for the log.
            |_, _| {
                let report = Some("Traceback:\n  line 7\nKeyError: lamp".to_owned());
                Err(Failure { reason: "KeyError: lamp".to_owned(), report })
            },
            "module \"server\" has failed: KeyError: lamp",
        ),
    ];
    for (does, expected) in cases {
        let mut robot = Robot::new();
        let server = move || Played {
            set_up: |declarations| {
                declarations.serve("enable", "std_srvs/srv/SetBool", None);
                Ok(())
            },
            handle: Box::new(move |event, context| match event {
                Event::Request { request, .. } => does(request, context),
                _ => Ok(()),
            }),
        };
        robot.add("server", ModuleOptions::default(), server).unwrap();
        let message = answer(&mut robot);
        assert!(message.contains(expected), "{message}");
    }

    let mut robot = Robot::new();
    let has_request = Arc::<AtomicU32>::default();
    let make = move || Keeper { has_request: Arc::clone(&has_request), is_newer: false };
    robot.add("keeper", ModuleOptions::default(), make).unwrap();
    let message = answer(&mut robot);
    assert!(
        message.contains("module \"keeper\" does not run and cannot answer"),
        "a newer version: {message}"
    );
}
