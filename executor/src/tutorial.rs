//! A small robot, step by step.
//!
//! The robot is a biped that keeps its balance. Every step below runs as a test with a
//! [`ManualClock`](crate::ManualClock), which the test advances, and asserts the result. Units are SI; frames
//! follow REP 103 and REP 105: `base_link` has x forward, y left and z up, so a positive pitch (about y) is
//! nose down; `map` and `odom` are fixed to the world.
//!
//! 1. [A sensor](#1-a-sensor)
//! 2. [A controller](#2-a-controller)
//! 3. [A setting](#3-a-setting)
//! 4. [A service](#4-a-service)
//! 5. [A task](#5-a-task)
//! 6. [A job](#6-a-job)
//! 7. [A detached module](#7-a-detached-module)
//! 8. [Life and restart](#8-life-and-restart)
//! 9. [Modules that come and go](#9-modules-that-come-and-go)
//! 10. [A launcher](#10-a-launcher)
//! 11. [The end](#11-the-end)
//!
//! # 1 A sensor
//!
//! In its `setup`, a module declares what it does. Each declaration returns a *key*, here for publishing. The
//! keys are the module's *ports*: `setup` returns them, and callbacks receive them in the
//! [`Context`](crate::Context), next to the module itself.
//!
//! ```
//! use std::time::Duration;
//! use downbeat_executor::{Core, ManualClock, Module, Publication, Setup, SetupError, Time};
//!
//! /// The attitude of base_link in odom.
//! struct Attitude {
//!     pitch_rad: f64,
//! }
//!
//! #[derive(Default)]
//! struct Imu {
//!     pitch_rad: f64,
//! }
//!
//! struct Ports {
//!     attitude: Publication<Attitude>,
//! }
//!
//! impl Module for Imu {
//!     type Ports = Ports;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
//!         setup.every(Duration::from_millis(8), |imu, ctx| {
//!             imu.pitch_rad += 0.01; // It falls on its nose. A real module reads its device.
//!             ctx.publish(ctx.ports.attitude, Attitude { pitch_rad: imu.pitch_rad });
//!         })?;
//!         Ok(Ports { attitude: setup.publish("attitude")? })
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! core.add("imu", Imu::default())?;
//! core.cycle()?; // The module becomes active; its timer counts from here.
//! clock.advance(Duration::from_millis(8));
//! core.cycle()?;
//! clock.advance(Duration::from_millis(24));
//! core.cycle()?; // Three are due, but the timer fires once: missed calls are not made up for.
//!
//! let attitude = core.topics().find(|topic| &*topic.name == "attitude").unwrap();
//! assert_eq!(attitude.counter.messages(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 2 A controller
//!
//! The controller subscribes and publishes. It refers to the sensor only by the name of its topic. A message
//! published in one cycle is received in the next: **each hop costs a cycle**. A hop is not the period of a
//! timer: under [`Core::run`](crate::Core::run), cycles follow each other without pause while there is
//! something to do, and a hop takes as long as the other modules in these cycles compute. In return, neither
//! the order in which modules run nor the threads affect the result.
//!
//! In a module as small as this, closures may instead capture the keys that they use. Its ports are then
//! `()`.
//!
//! ```
//! use std::sync::mpsc::{Sender, channel};
//! use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
//!
//! struct Attitude {
//!     pitch_rad: f64,
//! }
//!
//! /// Torque of both ankles about y, N·m, against the fall.
//! struct Balance;
//!
//! impl Module for Balance {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let torque = setup.publish::<f64>("ankle_torque")?;
//!         setup.subscribe::<Attitude, _>("attitude", move |_, attitude, ctx| {
//!             ctx.publish(torque, -40.0 * attitude.pitch_rad);
//!         })
//!     }
//! }
//!
//! /// Forwards the messages that it receives: for tests.
//! struct Ear(Sender<f64>);
//!
//! impl Module for Ear {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.subscribe::<f64, _>("ankle_torque", |ear, torque, _| drop(ear.0.send(*torque)))
//!     }
//! }
//!
//! let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
//! let (sender, heard) = channel();
//! core.add("ear", Ear(sender))?; // Before its publisher; the order makes no difference.
//! core.add("balance", Balance)?;
//!
//! core.inlet("attitude")?.publish(Attitude { pitch_rad: 0.1 })?; // From outside, as if from the sensor.
//! core.cycle()?; // The attitude enters the core.
//! core.cycle()?; // Balance receives it.
//! assert!(heard.try_recv().is_err());
//! core.cycle()?; // The ear receives the torque.
//! assert_eq!(heard.try_recv(), Ok(-4.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 3 A setting
//!
//! A number that users will want to change is a setting, with a range and a unit. Its value is constant
//! during a cycle. [`Setup::on_change`](crate::Setup::on_change) registers a callback that computes values
//! derived from the setting; [`Setup::accept_if`](crate::Setup::accept_if) registers a condition that a range
//! cannot express.
//!
//! ```
//! # use downbeat_executor::{
//! #     Context, Core, ManualClock, Module, Publication, Received, Setting, Setup, SetupError, Time,
//! # };
//! #[derive(Default)]
//! struct Balance {
//!     integral: f64,
//! }
//!
//! struct Ports {
//!     gain: Setting<f64>,
//!     torque: Publication<f64>,
//! }
//!
//! impl Balance {
//!     fn on_pitch(&mut self, pitch: Received<'_, f64>, ctx: &mut Context<'_, Ports>) {
//!         self.integral += *pitch;
//!         let gain = *ctx.get(ctx.ports.gain);
//!         ctx.publish(ctx.ports.torque, -gain * (*pitch + 0.1 * self.integral));
//!     }
//! }
//!
//! impl Module for Balance {
//!     type Ports = Ports;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
//!         let gain = setup.setting_in("gain", 40.0, 0.0..=200.0, "torque by pitch, N·m/rad")?;
//!         setup.on_change(gain, |balance, _| balance.integral = 0.0);
//!         setup.subscribe("pitch", Self::on_pitch)?;
//!         Ok(Ports { gain, torque: setup.publish("ankle_torque")? })
//!     }
//! }
//!
//! let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
//! core.add("balance", Balance::default())?;
//! core.cycle()?;
//!
//! let (good, bad) = (core.handle().set("balance", "gain", 55.0), core.handle().set("balance", "gain", 900.0));
//! core.cycle()?; // Its sync phase sets the value.
//! assert!(good.try_take().unwrap().is_ok());
//! let refused = bad.try_take().unwrap().unwrap_err();
//! assert!(refused.to_string().contains("900 is out of range, 0 to 200 is allowed"), "{refused}");
//! assert_eq!(core.settings("balance").unwrap()[0].value, 55.0.into());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 4 A service
//!
//! A service is for requests with a response, such as "stand up". The server responds with a value or with an
//! error as text. **A call takes two cycles**: one until the server has the request, one until the client has
//! the response; if the server calls a third module, it takes four. For each call of a module that stays
//! active, the callback runs exactly once, after the time-out at the latest.
//!
//! ```
//! # use std::sync::mpsc::{Sender, channel};
//! # use std::time::Duration;
//! # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
//! #[derive(Clone, Copy, Debug, PartialEq)]
//! enum Posture {
//!     Sitting,
//!     Standing,
//! }
//!
//! struct Legs(Posture);
//!
//! impl Module for Legs {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.serve::<Posture, Posture, _>("take_posture", |legs, &posture, _| {
//!             if legs.0 == posture {
//!                 return Err(format!("already {posture:?}"));
//!             }
//!             legs.0 = posture;
//!             Ok(posture)
//!         })
//!     }
//! }
//!
//! struct Operator(Sender<String>);
//!
//! impl Module for Operator {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let timeout = Duration::from_millis(500);
//!         let legs = setup.client::<Posture, Posture, _>("take_posture", timeout, |operator, reply, _| {
//!             let said = match reply.result {
//!                 Ok(posture) => format!("{posture:?}"),
//!                 Err(error) => error.to_string(),
//!             };
//!             drop(operator.0.send(said));
//!         })?;
//!         setup.subscribe::<Posture, _>("button", move |_, posture, ctx| {
//!             ctx.call(legs, *posture);
//!         })
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! let (sender, said) = channel();
//! core.add("operator", Operator(sender))?;
//! core.add("legs", Legs(Posture::Sitting))?;
//! let button = core.inlet("button")?;
//!
//! button.publish(Posture::Standing)?;
//! button.publish(Posture::Standing)?;
//! for _ in 0..4 {
//!     core.cycle()?; // The button joins, the operator calls, the legs answer, the operator is answered.
//! }
//! assert_eq!(said.try_recv()?, "Standing");
//! assert_eq!(said.try_recv()?, "service \"take_posture\": already Standing");
//!
//! core.handle().pause_module("legs");
//! button.publish(Posture::Sitting)?;
//! (0..3).try_for_each(|_| core.cycle())?;
//! clock.advance(Duration::from_millis(500));
//! core.cycle()?;
//! assert_eq!(said.try_recv()?, "service \"take_posture\": no answer in 500ms");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 5 A task
//!
//! A task runs once, at a time that the module chooses while it runs. Here, the motors go limp if no attitude
//! arrives for 50 ms. Scheduling adds a time, so the previous one is cancelled first.
//!
//! ```
//! # use std::time::Duration;
//! # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
//! struct Guard;
//!
//! impl Module for Guard {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let limp = setup.publish::<()>("limp")?;
//!         let lost = setup.task(move |_, ctx| ctx.publish(limp, ()));
//!         setup.subscribe::<f64, _>("pitch", move |_, _, ctx| {
//!             ctx.cancel(lost);
//!             ctx.schedule_after(lost, Duration::from_millis(50));
//!         })
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! core.add("guard", Guard)?;
//! let pitch = core.inlet("pitch")?;
//! let limp = core.topics().find(|topic| &*topic.name == "limp").unwrap().counter.clone();
//! for _ in 0..10 {
//!     pitch.publish(0.0)?;
//!     core.cycle()?;
//!     clock.advance(Duration::from_millis(40));
//! }
//! core.cycle()?;
//! assert_eq!(limp.messages(), 0);
//! clock.advance(Duration::from_millis(50));
//! core.cycle()?;
//! assert_eq!(limp.messages(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 6 A job
//!
//! A run delays its cycle, and with it all modules. Reading files and long computations therefore belong in
//! jobs, which run outside the cycle: [`Context::spawn`](crate::Context::spawn) runs a job on another thread,
//! [`Context::spawn_async`](crate::Context::spawn_async) on the thread for async work. A job cannot access
//! the module: it owns its input, and its result is passed to the callback of the job.
//!
//! ```
//! # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
//! /// A point in map, m.
//! #[derive(Clone, Copy)]
//! struct Point {
//!     x: f64,
//!     y: f64,
//! }
//!
//! /// Steps of 5 cm, straight there. A real planner takes its time.
//! fn plan(goal: Point) -> Vec<Point> {
//!     let count = (goal.x.hypot(goal.y) / 0.05).ceil();
//!     let step = |n: f64| Point { x: goal.x * n / count, y: goal.y * n / count };
//!     (1..=count as u32).map(|n| step(f64::from(n))).collect()
//! }
//!
//! struct Planner;
//!
//! impl Module for Planner {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let footsteps = setup.publish::<Point>("footsteps")?;
//!         let planning = setup.job::<Vec<Point>, _>(move |_, steps, ctx| match steps {
//!             Ok(steps) => ctx.publish_all(footsteps, steps),
//!             Err(lost) => eprintln!("no plan: {lost}"), // It panicked.
//!         });
//!         setup.subscribe::<Point, _>("goal", move |_, goal, ctx| {
//!             let goal = *goal;
//!             ctx.spawn(planning, move || plan(goal));
//!         })
//!     }
//! }
//!
//! let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
//! core.add("planner", Planner)?;
//! core.inlet("goal")?.publish(Point { x: 0.3, y: 0.4 })?;
//! core.cycle()?; // The goal enters the core.
//! core.cycle()?; // The planner spawns the job. With this clock, it runs in the sync phase.
//! core.cycle()?; // The planner receives the result.
//! let footsteps = core.topics().find(|topic| &*topic.name == "footsteps").unwrap();
//! assert_eq!(footsteps.counter.messages(), 10);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! With a running clock, results arrive *in the order in which the jobs end*, in the sync phase that follows.
//! This is the only effect here that depends on the speed of threads. With a manual clock (in tests), a job
//! runs in the sync phase of the cycle that spawned it, in the order of spawning. The topic `executor/events`
//! reports the cycle in which each result arrived, and a replay holds the results back until then.
//!
//! # 7 A detached module
//!
//! A slow module (vision, a serial port) can run on its own thread; this is an option, and the module itself
//! does not change. While it is busy, batches wait in its inbox: all of them or, if the inbox is bounded, the
//! latest of each topic.
//!
//! ```
//! # use std::num::NonZeroUsize;
//! # use downbeat_executor::{Core, Inbox, ManualClock, Module, ModuleOptions, Setup, SetupError, Synchrony, Time};
//! /// Brightness by pixel.
//! struct Image(Vec<u8>);
//!
//! struct Vision;
//!
//! impl Module for Vision {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let ball = setup.publish::<usize>("ball_pixel")?;
//!         setup.subscribe::<Image, _>("image", move |_, image, ctx| {
//!             if let Some(brightest) = (0..image.0.len()).max_by_key(|&pixel| image.0[pixel]) {
//!                 ctx.publish(ball, brightest);
//!             }
//!         })
//!     }
//! }
//!
//! let latest = Synchrony::Detached(Inbox::KeepLast(NonZeroUsize::MIN));
//! let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
//! core.add_with("vision", Vision, ModuleOptions { synchrony: latest, ..ModuleOptions::default() })?;
//! core.inlet("image")?.publish(Image(vec![3, 200, 7]))?;
//! core.cycle()?;
//! core.cycle()?; // With a manual clock, detached modules run inside the cycle.
//! assert_eq!(core.topics().find(|topic| &*topic.name == "ball_pixel").unwrap().counter.messages(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The costs: a hop to the module and back wakes two threads, which the system schedules, and its messages
//! arrive when its run ends, in a cycle that cannot be predicted. The topic
//! [`DetachedStep::TOPIC`](crate::DetachedStep) reports each of its runs, which a replay repeats from a
//! recording; [`SettingsChange::TOPIC`](crate::SettingsChange) reports settings that change meanwhile. The
//! limits: a detached module cannot use a mechanism that was added to the core, because others change it
//! while the module runs ([`Setup::mechanism`](crate::Setup::mechanism) returns an error, with every clock);
//! and a core that stops waits until the run ends, because a thread cannot be ended from outside.
//!
//! # 8 Life and restart
//!
//! A module becomes active immediately, unless [`ModuleOptions::initial_state`](crate::ModuleOptions) says
//! otherwise; then it can be configured and activated later, like a managed node of ROS 2. Only active
//! modules run callbacks. A panic ends only its own module, and discards the outputs and requests of that
//! run. A module that is added with a closure that creates it can be restarted.
//!
//! ```
//! # use std::time::Duration;
//! # use downbeat_executor::{
//! #     Context, Core, LifecycleState, ManualClock, Module, ModuleOptions, Restart, Setup, SetupError, Time,
//! #     Transition, TransitionError,
//! # };
//! /// A motor that knows its position only after its activation.
//! #[derive(Default)]
//! struct Motor {
//!     position_rad: Option<f64>,
//! }
//!
//! impl Module for Motor {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.subscribe::<f64, _>("torque", |motor, torque, _| {
//!             assert!(torque.is_finite(), "a torque of {} N·m", *torque);
//!             motor.position_rad = motor.position_rad.map(|position| position + 0.001 * *torque);
//!         })
//!     }
//!
//!     fn activate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
//!         self.position_rad = Some(0.0);
//!         Ok(())
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! let options = ModuleOptions {
//!     initial_state: LifecycleState::Inactive,
//!     restart: Restart::Times { limit: 3, backoff: Duration::from_millis(100) },
//!     ..ModuleOptions::default()
//! };
//! core.add_restartable("motor", Motor::default, options)?;
//! core.cycle()?;
//! assert_eq!(core.modules()[0].state, LifecycleState::Inactive);
//!
//! let activated = core.handle().transition("motor", Transition::Activate);
//! (0..2).try_for_each(|_| core.cycle())?; // The first takes the request, the second makes the transition.
//! assert_eq!(activated.try_take().unwrap()?, LifecycleState::Active);
//!
//! core.inlet("torque")?.publish(f64::NAN)?;
//! (0..2).try_for_each(|_| core.cycle())?;
//! assert_eq!(core.modules()[0].state, LifecycleState::Finalized);
//! clock.advance(Duration::from_millis(100));
//! (0..2).try_for_each(|_| core.cycle())?; // The first creates the module again, the second runs it.
//! let motor = &core.modules()[0];
//! assert_eq!((motor.state, motor.restarts), (LifecycleState::Inactive, 1)); // It is in its initial state again.
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 9 Modules that come and go
//!
//! [`CoreHandle`](crate::CoreHandle) adds and removes modules of a running core from any thread, and a module
//! does so from a callback, with [`Context::add`](crate::Context::add) and
//! [`Context::remove`](crate::Context::remove). Both take effect in the sync phase. The `setup` of an added
//! module and the `shutdown` of a removed one run there, so long work in them delays the cycle: put it into a
//! job, or make the module detached. Modules that are added later come later in the order of registration.
//!
//! ```
//! # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
//! struct Gait {
//!     period_s: f64,
//! }
//!
//! impl Module for Gait {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         self.period_s = 0.6;
//!         setup.serve::<(), f64, _>("gait_period", |gait, _, _| Ok(gait.period_s))
//!     }
//! }
//!
//! let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
//! core.cycle()?;
//! let handle = core.handle();
//!
//! let added = handle.add("gait", Gait { period_s: 0.0 }, ModuleOptions::default());
//! let again = handle.add("gait", Gait { period_s: 0.0 }, ModuleOptions::default());
//! core.cycle()?;
//! assert!(added.try_take().unwrap().is_ok());
//! assert!(matches!(again.try_take().unwrap(), Err(SetupError::DuplicateModule(_))));
//!
//! // Removals come first, so the new gait takes over the name and the service in the same sync phase.
//! let other = handle.add("gait", Gait { period_s: 0.0 }, ModuleOptions::default());
//! let removed = handle.remove("gait");
//! core.cycle()?;
//! assert_eq!(removed.try_take().unwrap(), Ok(()));
//! assert!(other.try_take().unwrap().is_ok());
//! assert_eq!(core.modules().len(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 10 A launcher
//!
//! The launcher decides on which threads the process phase runs. It does not change the result:
//! running modules share no state, and the sync phase collects their requests in the order of registration.
//!
//! | launcher | for |
//! | --- | --- |
//! | [`Linear`](crate::Linear), the default | nearly every robot: modules with short runs |
//! | [`Pool`](crate::Pool) | cycles in which several modules compute for much longer than it takes to wake a thread |
//! | [`Threads`](crate::Threads) | libraries that must always be called from the same thread |
//! | [`Scheduled`](crate::Scheduled) | the core's thread on a chosen CPU, at a real-time priority |
//!
//! ```
//! # use std::sync::mpsc::{Sender, channel};
//! # use downbeat_executor::{
//! #     Core, Launcher, Linear, ManualClock, Module, Pool, Setup, SetupError, Threads, Time,
//! # };
//! /// A joint that moves towards its neighbours.
//! struct Joint(f64, Sender<f64>);
//!
//! impl Module for Joint {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         let position = setup.publish::<f64>("position")?;
//!         setup.subscribe::<f64, _>("position", |joint, other, _| joint.0 = 0.9 * joint.0 + 0.1 * *other)?;
//!         setup.subscribe::<(), _>("beat", move |joint, _, ctx| {
//!             drop(joint.1.send(joint.0));
//!             ctx.publish(position, joint.0);
//!         })
//!     }
//! }
//!
//! fn last_position(launcher: impl Launcher + 'static) -> Result<f64, Box<dyn std::error::Error>> {
//!     let mut core = Core::new().with_launcher(launcher).with_clock(ManualClock::new(Time::ZERO));
//!     let last = {
//!         let (sender, positions) = channel();
//!         for (name, begin) in [("hip", 0.1), ("knee", 0.7), ("ankle", -0.3)] {
//!             // Only the position of the ankle is compared.
//!             let sender = if name == "ankle" { sender.clone() } else { channel().0 };
//!             core.add(name, Joint(begin, sender))?;
//!         }
//!         let beat = core.inlet("beat")?;
//!         for _ in 0..100 {
//!             beat.publish(())?;
//!             core.cycle()?;
//!         }
//!         positions.try_iter().last()
//!     };
//!     last.ok_or_else(|| "the ankle never ran".into())
//! }
//!
//! let expected = last_position(Linear)?;
//! // To the last bit: the sums are in the same order.
//! assert_eq!(last_position(Pool::new(2)?)?.to_bits(), expected.to_bits());
//! assert_eq!(last_position(Threads::new())?.to_bits(), expected.to_bits());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # 11 The end
//!
//! [`CoreHandle::stop`](crate::CoreHandle::stop) ends [`Core::run`](crate::Core::run), which then calls the
//! [`shutdown`](crate::Module::shutdown) of each module, in the reverse order of registration. An
//! [outlet](crate::Core::outlet), through which messages leave the core for a file, a network or a test, is
//! closed after all modules have stopped, so it receives their last messages.
//!
//! ```
//! # use std::sync::mpsc::channel;
//! # use downbeat_executor::{Context, Core, Inbox, Module, Publication, Received, Setup, SetupError};
//! struct Motor;
//!
//! struct Ports {
//!     torque: Publication<f64>,
//! }
//!
//! impl Module for Motor {
//!     type Ports = Ports;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
//!         Ok(Ports { torque: setup.publish("torque")? })
//!     }
//!
//!     fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
//!         ctx.publish(ctx.ports.torque, 0.0);
//!     }
//! }
//!
//! let (sender, recorded) = channel();
//! let mut core = Core::new(); // With the system's clock, as on a robot.
//! let record = move |torque: Received<'_, f64>| drop(sender.send(*torque)); // Runs on its own thread.
//! let _recorder = core.outlet("torque", Inbox::KeepAll, record)?;
//! core.add("motor", Motor)?;
//! core.cycle()?;
//! let handle = core.handle();
//! std::thread::spawn(move || handle.stop()); // As a signal would.
//! core.run()?;
//! assert_eq!(recorded.try_recv(), Ok(0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
