//! The kinds of the package `downbeat-sensors`.

use super::Kind;

pub(super) fn kinds() -> impl Iterator<Item = Kind> {
    of_protocols().into_iter().chain(of_the_kernel())
}

/// Sensors whose protocols are spoken here, on a serial port or a bus.
fn of_protocols() -> Vec<Kind> {
    Vec::new()
}

/// Sensors and buses that Linux serves as devices of a class.
fn of_the_kernel() -> Vec<Kind> {
    Vec::new()
}
