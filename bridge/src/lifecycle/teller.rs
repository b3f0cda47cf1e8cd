//! The thread that tells transitions: modules run on threads that must not write to DDS.

use super::node::Followed;
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use downbeat_executor::LifeStep;
use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;

enum Event {
    /// A module made a step.
    Step(Arc<Followed>, LifeStep),
    /// Somebody waits until all before it is told.
    Wait(Sender<()>),
}

/// A running thread. When it is dropped the last events are told, once nobody has [`Events`] any more.
pub(super) struct Teller {
    events: Option<Events>,
    thread: Option<JoinHandle<()>>,
}

/// Where transitions are told.
#[derive(Clone)]
pub(super) struct Events(Sender<Event>);

impl Teller {
    pub(super) fn start() -> io::Result<Self> {
        // As many as modules make; requests for transitions are bounded where they come in.
        let (sender, events) = unbounded();
        let thread = std::thread::Builder::new().name("downbeat-life".into()).spawn(move || run(&events))?;
        Ok(Self { events: Some(Events(sender)), thread: Some(thread) })
    }

    pub(super) fn events(&self) -> Events {
        // It is there until the drop.
        self.events.clone().unwrap_or_else(|| Events(unbounded().0))
    }
}

impl Events {
    pub(super) fn tell(&self, module: Arc<Followed>, step: LifeStep) {
        // Fails only when the thread has ended.
        let _ = self.0.send(Event::Step(module, step));
    }

    /// Waits until what was told before is told to ROS 2.
    pub(super) fn wait(&self) {
        let (sender, told) = bounded(1);
        if self.0.send(Event::Wait(sender)).is_ok() {
            // Fails when the thread has ended.
            let _ = told.recv();
        }
    }
}

impl Drop for Teller {
    fn drop(&mut self) {
        self.events = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that tells the transitions of modules panicked");
        }
    }
}

fn run(events: &Receiver<Event>) {
    for event in events {
        match event {
            Event::Step(module, step) => module.follow(step),
            // Who waited may have given up.
            Event::Wait(sender) => drop(sender.send(())),
        }
    }
}
