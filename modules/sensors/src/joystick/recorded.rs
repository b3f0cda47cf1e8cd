//! An emulated joystick: a gamepad that a file of events moves.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;
use std::time::Duration;

use downbeat_executor::Time;
use downbeat_files::FileKind;

use super::events::{ABSOLUTE, Axis, Button, Event, KEY, LENGTH, Layout, Receiver};
use super::source::Source;
use crate::kernel;

/// The largest file, in bytes: half an hour of a stick that never rests.
const MOST_BYTES: u64 = 64 << 20;
/// The most bytes of a pipe that one request reads.
const MOST_AT_ONCE: usize = 256 * LENGTH;

/// An emulated gamepad with the axes and buttons of an Xbox 360 controller, moved by the events of a file:
/// what `cat /dev/input/event5 > drive.events` wrote while somebody held a gamepad. They come at the times of
/// their stamps. Those of a pipe (`mkfifo`) come when they are written. Without a file nobody touches it.
#[derive(Default)]
pub struct RecordedEvents {
    open: Option<Open>,
}

struct Open {
    from: Origin,
    layout: Layout,
    state: Receiver,
}

enum Origin {
    Nothing,
    Pipe(File),
    Events { all: Vec<Event>, next: usize, start: Option<Time>, path: String },
}

impl Source for RecordedEvents {
    fn open(&mut self, device: &str) -> Result<(), String> {
        self.close();
        let failed = |error: std::io::Error| format!("opening the events {device}: {error}");
        let from = if device.is_empty() {
            Origin::Nothing
        } else if FileKind::of(&std::fs::metadata(device).map_err(failed)?) == FileKind::Pipe {
            Origin::Pipe(kernel::open_without_waiting(Path::new(device), true).map_err(failed)?)
        } else {
            let mut bytes = Vec::new();
            File::open(device).map_err(failed)?.take(MOST_BYTES).read_to_end(&mut bytes).map_err(failed)?;
            let all = Receiver::default().push(&bytes);
            if all.is_empty() {
                return Err(format!(
                    "{device} has no events; they are {LENGTH} bytes each, as a joystick sends them"
                ));
            }
            Origin::Events { all, next: 0, start: None, path: device.to_owned() }
        };
        self.open = Some(Open { from, layout: gamepad(), state: Receiver::default() });
        Ok(())
    }

    fn layout(&mut self) -> Result<Layout, String> {
        self.open
            .as_ref()
            .map(|open| open.layout.clone())
            .ok_or_else(|| "the joystick is not open".to_owned())
    }

    fn read(&mut self, now: Time, _most: Duration) -> Result<Vec<u8>, String> {
        let open = self.open.as_mut().ok_or("the joystick is not open")?;
        let bytes = match &mut open.from {
            Origin::Nothing => Vec::new(),
            Origin::Pipe(pipe) => {
                let mut bytes = vec![0; MOST_AT_ONCE];
                match pipe.read(&mut bytes) {
                    Ok(length) => bytes.truncate(length),
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                        bytes.clear();
                    }
                    Err(error) => return Err(format!("reading events: {error}")),
                }
                bytes
            }
            Origin::Events { all, next, start, path } => {
                if !Path::new(path).exists() {
                    return Err(format!("the events {path} are gone"));
                }
                let since = now.saturating_since(*start.get_or_insert(now));
                let first = all.first().map_or(0, |event| event.time_us);
                let due = all
                    .iter()
                    .skip(*next)
                    .take_while(|event| Duration::from_micros(event.time_us.saturating_sub(first)) <= since);
                let bytes: Vec<u8> = due.flat_map(Event::emit).collect();
                *next += bytes.len() / LENGTH;
                bytes
            }
        };
        for event in open.state.push(&bytes) {
            let axis =
                open.layout.axes.iter_mut().find(|axis| (event.kind, event.code) == (ABSOLUTE, axis.code));
            if let Some(axis) = axis {
                axis.value = event.value;
            }
            let button =
                open.layout.buttons.iter_mut().find(|button| (event.kind, event.code) == (KEY, button.code));
            if let Some(button) = button {
                button.is_pressed = event.value != 0;
            }
        }
        Ok(bytes)
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// What the driver of Linux says of an Xbox 360 controller (`drivers/input/joystick/xpad.c`).
fn gamepad() -> Layout {
    let stick = |code| Axis { code, minimum: -32_768, maximum: 32_767, value: 0 };
    let trigger = |code| Axis { code, minimum: 0, maximum: 255, value: 0 };
    let hat = |code| Axis { code, minimum: -1, maximum: 1, value: 0 };
    let buttons = [0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x13a, 0x13b, 0x13c, 0x13d, 0x13e];
    Layout {
        name: "emulated gamepad".to_owned(),
        axes: vec![stick(0), stick(1), trigger(2), stick(3), stick(4), trigger(5), hat(16), hat(17)],
        buttons: buttons.map(|code| Button { code, is_pressed: false }).to_vec(),
    }
}
