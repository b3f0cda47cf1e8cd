//! Events of input devices, and what a device has.
//!
//! # References
//! `linux/input.h` and `linux/input-event-codes.h`; "Linux Input Subsystem userspace API", chapter "Event
//! codes".

use std::fmt::Write;

use crate::kernel::{i32_at, u64_at};

/// The length of an event.
pub const LENGTH: usize = 24;

pub(super) const SYNCHRONISATION: u16 = 0;
pub(super) const KEY: u16 = 1;
pub(super) const ABSOLUTE: u16 = 3;
/// Codes of [`SYNCHRONISATION`]: all events of a moment have come, and events were lost.
pub(super) const REPORT: u16 = 0;
pub(super) const DROPPED: u16 = 3;

/// The most axes and buttons that a device can have.
const MOST_AXES: usize = 64;
const MOST_BUTTONS: usize = 768;

/// An event (`struct input_event`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// Microseconds of the clock of the device.
    pub time_us: u64,
    /// What it is about, such as an axis.
    pub kind: u16,
    /// Which one.
    pub code: u16,
    /// Its value.
    pub value: i32,
}

impl Event {
    /// Reads an event.
    #[must_use]
    pub fn parse(bytes: &[u8; LENGTH]) -> Self {
        let [.., k1, k2, c1, c2, _, _, _, _] = *bytes;
        Self {
            time_us: u64_at(bytes, 0).saturating_mul(1_000_000).saturating_add(u64_at(bytes, 8)),
            kind: u16::from_ne_bytes([k1, k2]),
            code: u16::from_ne_bytes([c1, c2]),
            value: i32_at(bytes, 20),
        }
    }

    /// The bytes of an event.
    #[must_use]
    pub fn emit(&self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        let parts: [(usize, &[u8]); 5] = [
            (0, &(self.time_us / 1_000_000).to_ne_bytes()),
            (8, &(self.time_us % 1_000_000).to_ne_bytes()),
            (16, &self.kind.to_ne_bytes()),
            (18, &self.code.to_ne_bytes()),
            (20, &self.value.to_ne_bytes()),
        ];
        for (offset, part) in parts {
            crate::kernel::put(&mut bytes, offset, part);
        }
        bytes
    }
}

/// Puts events together from bytes that come in any pieces.
#[derive(Debug, Default)]
pub(super) struct Receiver {
    rest: Vec<u8>,
}

impl Receiver {
    pub(super) fn push(&mut self, bytes: &[u8]) -> Vec<Event> {
        self.rest.extend(bytes);
        let chunks = self.rest.chunks_exact(LENGTH);
        let rest = chunks.remainder().to_vec();
        let events = chunks.filter_map(|chunk| chunk.first_chunk()).map(Event::parse).collect();
        self.rest = rest;
        events
    }
}

/// What a device has, and where everything stands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// The name of the device.
    pub name: String,
    /// In the order of `joy`.
    pub axes: Vec<Axis>,
    /// Likewise.
    pub buttons: Vec<Button>,
}

/// An axis of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Its number in `linux/input-event-codes.h`.
    pub code: u16,
    /// The least value.
    pub minimum: i32,
    /// The largest value.
    pub maximum: i32,
    /// Where it stands.
    pub value: i32,
}

/// A button of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Button {
    /// Its number in `linux/input-event-codes.h`.
    pub code: u16,
    /// Whether it is pressed.
    pub is_pressed: bool,
}

impl Axis {
    /// From -1 at the right or the bottom to 1 at the left or the top, as in `joy`. A range that is none
    /// gives 0.
    pub(super) fn position(&self) -> f64 {
        let (minimum, maximum, value) =
            (f64::from(self.minimum), f64::from(self.maximum), f64::from(self.value));
        match maximum > minimum {
            true => (1.0 - 2.0 * (value - minimum) / (maximum - minimum)).clamp(-1.0, 1.0),
            false => 0.0,
        }
    }
}

impl Layout {
    /// Sorts axes and buttons as the joystick driver of Linux numbers them (`drivers/input/joydev.c`), and so
    /// `joy_linux` and most configurations: axes by their codes, buttons from `BTN_JOYSTICK` (0x120) on
    /// before those below.
    pub(super) fn sort(&mut self) {
        self.axes.sort_by_key(|axis| axis.code);
        self.buttons.sort_by_key(|button| (button.code < 0x120, button.code));
    }

    /// As a text, in the recording of a joystick.
    pub(super) fn to_text(&self) -> String {
        let mut text = self.name.replace('\n', " ");
        // Writing to a string does not fail.
        for Axis { code, minimum, maximum, value } in &self.axes {
            let _ = write!(text, "\naxis {code} {minimum} {maximum} {value}");
        }
        for Button { code, is_pressed } in &self.buttons {
            let _ = write!(text, "\nbutton {code} {}", u8::from(*is_pressed));
        }
        text
    }

    /// Reads such a text, which may be of a damaged recording.
    pub(super) fn from_text(text: &str) -> Option<Self> {
        let mut lines = text.lines();
        let mut layout = Self { name: lines.next().unwrap_or_default().to_owned(), ..Self::default() };
        for line in lines {
            let words: Vec<&str> = line.split(' ').collect();
            match *words {
                ["axis", code, minimum, maximum, value] if layout.axes.len() < MOST_AXES => {
                    layout.axes.push(Axis {
                        code: code.parse().ok()?,
                        minimum: minimum.parse().ok()?,
                        maximum: maximum.parse().ok()?,
                        value: value.parse().ok()?,
                    });
                }
                ["button", code, is_pressed] if layout.buttons.len() < MOST_BUTTONS => {
                    layout.buttons.push(Button { code: code.parse().ok()?, is_pressed: is_pressed == "1" });
                }
                _ => return None,
            }
        }
        Some(layout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// From `cat /dev/input/event5` by the layout of `struct input_event` on x86-64: `BTN_SOUTH` (0x130)
    /// pressed at 1 s and 2 us.
    const PRESSED: [u8; LENGTH] =
        [1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0x30, 0x01, 1, 0, 0, 0];

    #[cfg(target_endian = "little")]
    #[test]
    fn an_event_has_the_layout_of_the_header() {
        let event = Event { time_us: 1_000_002, kind: KEY, code: 0x130, value: 1 };
        assert_eq!(Event::parse(&PRESSED), event);
        assert_eq!(event.emit(), PRESSED);
    }

    #[test]
    fn axes_are_positive_at_the_left_and_at_the_top() {
        let axis = |value| Axis { code: 0, minimum: -32_768, maximum: 32_767, value };
        assert_eq!((axis(-32_768).position(), axis(32_767).position()), (1.0, -1.0));
        assert!(axis(0).position().abs() < 1e-4);
        assert_eq!(Axis { code: 2, minimum: 0, maximum: 255, value: 0 }.position(), 1.0, "a trigger at rest");
        assert_eq!(Axis { code: 2, minimum: 5, maximum: 5, value: 0 }.position(), 0.0);
        assert_eq!(axis(i32::MAX).position(), -1.0);
    }

    proptest! {
        #[test]
        fn events_come_through_in_any_pieces(
            values in prop::collection::vec((any::<u16>(), any::<u16>(), any::<i32>()), 0..20), piece in 1..50_usize
        ) {
            let events: Vec<Event> =
                values.into_iter().map(|(kind, code, value)| Event { time_us: 7, kind, code, value }).collect();
            let bytes: Vec<u8> = events.iter().flat_map(Event::emit).collect();
            let mut receiver = Receiver::default();
            let received: Vec<Event> = bytes.chunks(piece).flat_map(|piece| receiver.push(piece)).collect();
            prop_assert_eq!(received, events);
            prop_assert!(receiver.rest.is_empty());
        }

        #[test]
        fn a_layout_survives_being_recorded(
            name in "[^\r\n]{0,20}", axes in prop::collection::vec(any::<(u16, i32, i32, i32)>(), 0..64),
            buttons in prop::collection::vec(any::<(u16, bool)>(), 0..30),
        ) {
            let axis = |(code, minimum, maximum, value)| Axis { code, minimum, maximum, value };
            let button = |(code, is_pressed)| Button { code, is_pressed };
            let layout = Layout {
                name,
                axes: axes.into_iter().map(axis).collect(),
                buttons: buttons.into_iter().map(button).collect(),
            };
            prop_assert_eq!(Layout::from_text(&layout.to_text()), Some(layout));
        }

        #[test]
        fn any_text_is_a_layout_or_none(text in "\\PC*(\n(axis|button)[ 0-9-]{0,20}){0,70}") {
            let layout = Layout::from_text(&text);
            prop_assert!(layout.is_none_or(|layout| layout.axes.len() <= MOST_AXES));
        }
    }
}
