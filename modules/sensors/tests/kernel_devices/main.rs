//! The modules for devices of the kernel, on emulated devices, on devices that are tests, and on recordings of them.
#![allow(clippy::unwrap_used)]

mod camera;
mod can;
mod gpio;
mod joystick;
mod teleop;

use std::time::Duration;

use downbeat_executor::{Heard, ModuleOptions, Probe, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;

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
