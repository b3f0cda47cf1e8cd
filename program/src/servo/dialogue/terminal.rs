//! The terminal: a line answers, and the joints are shown in place.

use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::bail;
use downbeat_servos::servo_bus::TurnedJoint;

use super::Answer;
use crate::input;
use crate::screen::Screen;

/// How often the table on the screen changes.
const REFRESH: Duration = Duration::from_millis(100);

/// The characters between the stops of a joint on the screen.
const BAR: usize = 30;

pub(super) struct Terminal {
    lines: Receiver<String>,
    screen: &'static Screen,
    /// When the table changes next.
    next: Instant,
}

impl Terminal {
    pub(super) fn new() -> anyhow::Result<Self> {
        Ok(Self { lines: input::lines()?, screen: Screen::of_process(), next: Instant::now() })
    }

    pub(super) fn ask(&mut self, question: &str, answers: &[Answer]) {
        let others = answers.iter().filter(|(typed, _)| !typed.is_empty());
        let others: String = others.map(|(typed, is)| format!("; or type \"{typed}\" for {is}")).collect();
        println!("{question}, and press Enter{others}.");
    }

    pub(super) fn answer(&mut self, joints: &[TurnedJoint]) -> anyhow::Result<Option<String>> {
        match self.lines.try_recv() {
            Ok(line) => {
                self.screen.show(Vec::new());
                self.screen.flush();
                return Ok(Some(line.trim().to_owned()));
            }
            Err(TryRecvError::Disconnected) => bail!("standard input has ended; nothing was written"),
            Err(TryRecvError::Empty) => {}
        }
        if Instant::now() >= self.next {
            self.screen.show(joints.iter().map(row).collect());
            self.next = Instant::now() + REFRESH;
        }
        Ok(None)
    }
}

fn row(joint: &TurnedJoint) -> String {
    let TurnedJoint { name, id, travel_rad, place, is_silent } = joint;
    let at = (place * (BAR - 1) as f64).round() as usize;
    let bar: String = (0..BAR).map(|place| if place == at { '|' } else { '-' }).collect();
    let silent = if *is_silent { "  does not answer" } else { "" };
    format!("{name:<20} id {id:>3}  [{bar}] {:>5.1} degrees{silent}", travel_rad.to_degrees())
}
