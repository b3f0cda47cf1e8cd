//! The modules for devices of the kernel, on emulated devices, on devices that are tests, and on recordings
//! of them.
#![allow(clippy::unwrap_used)]

mod camera;
mod can;
mod gpio;
mod joystick;
mod teleop;

use std::ops::Deref;
use std::time::Duration;

use downbeat_executor::{Heard, Module, ModuleOptions, Probe, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

/// A module of a device, with what is heard of it: what all have, and topics of its own.
struct Bench<T> {
    probe: Probe,
    exchanges: Heard<BusExchange>,
    diagnostics: Heard<DiagnosticArray>,
    topics: T,
}

/// Puts a module on a bench. `exchanges` is the topic of the exchanges with its device.
fn bench_of<M: Module, T>(
    (name, module): (&str, M),
    options: ModuleOptions,
    exchanges: &str,
    listen: impl FnOnce(&mut Probe) -> T,
) -> Bench<T> {
    let mut probe = Probe::new();
    probe.add_with(name, module, options).unwrap();
    let topics = listen(&mut probe);
    Bench {
        topics,
        exchanges: probe.listen(exchanges).unwrap(),
        diagnostics: probe.listen("diagnostics").unwrap(),
        probe,
    }
}

impl<T> Deref for Bench<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.topics
    }
}

fn options<const N: usize>(settings: [(&str, SettingValue); N]) -> ModuleOptions {
    let settings = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

fn texts<const N: usize>(texts: [&str; N]) -> SettingValue {
    SettingValue::Texts(texts.map(str::to_owned).to_vec())
}

fn text(text: impl ToString) -> SettingValue {
    text.to_string().into()
}

/// Lets time pass in small steps.
fn pass(probe: &mut Probe, ms: u64) {
    for _ in 0..ms {
        probe.advance(Duration::from_millis(1)).unwrap();
    }
}

/// Level and message of the last report.
fn last_status(diagnostics: &Heard<DiagnosticArray>) -> (u8, String) {
    let last = diagnostics.take_last().unwrap();
    (last.status[0].level, last.status[0].message.clone())
}

/// A value of the last report.
fn last_value(diagnostics: &Heard<DiagnosticArray>, key: &str) -> String {
    let last = diagnostics.take_last().unwrap();
    last.status[0].values.iter().find(|value| value.key == key).unwrap().value.clone()
}
