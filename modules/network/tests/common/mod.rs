//! What tests of modules with sockets share, those of `downbeat-leagues` too.
#![allow(clippy::unwrap_used, dead_code)]

use std::net::UdpSocket;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::{
    Clock, Core, Inbox, ManualClock, ModuleOptions, OutletInbox, Received, SettingValue, Time,
};

pub fn options<const N: usize>(settings: [(&str, SettingValue); N]) -> ModuleOptions {
    let settings = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

pub fn free_port() -> i64 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().into()
}

/// A core with one module, and what it publishes on one topic.
pub struct Bench {
    pub core: Core,
    pub clock: ManualClock,
}

impl Bench {
    pub fn new() -> Self {
        let clock = ManualClock::new(Time::ZERO);
        Self { core: Core::new().with_clock(clock.clone()), clock }
    }

    pub fn collect<T: Clone + Send + Sync + 'static>(&mut self, topic: &str) -> Arc<Mutex<Vec<T>>> {
        let collected = Arc::new(Mutex::new(Vec::new()));
        let all = Arc::clone(&collected);
        let inbox = OutletInbox::new(topic, Inbox::KeepAll);
        let take = move |received: Received<'_, T>| all.lock().unwrap().push((*received).clone());
        self.core.outlet(topic, &inbox, take).unwrap().keep();
        collected
    }

    pub fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.clock.advance(Duration::from_millis(20));
            self.core.cycle().unwrap();
        }
    }

    /// How many cycles have run.
    pub fn clock_cycles(&self) -> usize {
        (self.clock.now().as_nanos() / 20_000_000) as usize
    }
}
