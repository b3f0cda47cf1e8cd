//! Questions and their answers while joints are turned by hand, on the terminal or in a page.

#[cfg(feature = "view")]
mod page;
mod terminal;

use std::time::Duration;

use anyhow::bail;
use downbeat_servos::servo_bus::{Calibrator, ServoError, Tuner, TurnedJoint};

use crate::stop::Stop;
#[cfg(feature = "view")]
use page::Page;
use terminal::Terminal;

/// An answer: what is typed, and what it stands for.
pub(super) type Answer = (&'static str, &'static str);

/// What was asked for is done.
pub(super) const DONE: Answer = ("", "done");

/// Joints that are shown while a question waits.
pub(super) trait Joints {
    /// Reads them.
    fn look(&mut self) -> Result<(), ServoError>;

    fn shown(&self) -> Vec<TurnedJoint>;
}

impl Joints for Calibrator {
    fn look(&mut self) -> Result<(), ServoError> {
        self.look()
    }

    fn shown(&self) -> Vec<TurnedJoint> {
        self.joints().collect()
    }
}

impl Joints for Tuner {
    fn look(&mut self) -> Result<(), ServoError> {
        self.look()
    }

    fn shown(&self) -> Vec<TurnedJoint> {
        self.joints().collect()
    }
}

/// Asks a person.
pub(super) struct Dialogue {
    stop: Stop,
    front: Front,
}

enum Front {
    Terminal(Terminal),
    #[cfg(feature = "view")]
    Page(Page),
}

impl Dialogue {
    /// On the terminal, or in a page at this port, which says `done` when it is over.
    #[cfg_attr(not(feature = "view"), allow(unused_variables))]
    pub(super) fn new(page: Option<u16>, done: &'static str) -> anyhow::Result<Self> {
        let stop = Stop::new()?;
        let front = match page {
            None => Front::Terminal(Terminal::new()?),
            #[cfg(feature = "view")]
            Some(port) => Front::Page(Page::open(port, done)?),
            #[cfg(not(feature = "view"))]
            Some(_) => return crate::not_built("view", "without --page the terminal asks"),
        };
        Ok(Self { stop, front })
    }

    pub(super) fn say(&mut self, line: String) {
        println!("{line}");
        match &self.front {
            Front::Terminal(_) => {}
            #[cfg(feature = "view")]
            Front::Page(page) => page.say(line),
        }
    }

    /// Whether nobody has asked to stop.
    pub(super) fn goes_on(&self) -> bool {
        !self.stop.is_due()
    }

    /// Waits for an answer, which is one of these, and shows the joints of the bus meanwhile.
    pub(super) fn ask(
        &mut self,
        question: &str,
        answers: &[Answer],
        mut bus: Option<&mut dyn Joints>,
    ) -> anyhow::Result<String> {
        match &mut self.front {
            Front::Terminal(terminal) => terminal.ask(question, answers),
            #[cfg(feature = "view")]
            Front::Page(page) => page.ask(question, answers),
        }
        loop {
            if self.stop.is_due() {
                bail!("stopped; nothing was written");
            }
            let mut look = || -> anyhow::Result<Vec<_>> {
                let Some(bus) = &mut bus else { return Ok(Vec::new()) };
                bus.look()?;
                Ok(bus.shown())
            };
            let joints = look()?;
            let answer = match &mut self.front {
                Front::Terminal(terminal) => terminal.answer(&joints)?,
                #[cfg(feature = "view")]
                Front::Page(page) => page.answer(&joints),
            };
            if let Some(answer) = &answer
                && !answers.iter().any(|(typed, _)| typed == answer)
            {
                self.say(format!("{answer:?} is no answer to: {question}"));
                continue;
            }
            if let Some(answer) = answer {
                // What is there now counts.
                look()?;
                return Ok(answer);
            }
            self.stop.sleep(Duration::from_millis(1));
        }
    }

    /// Shows how it ended.
    pub(super) fn end(self, result: anyhow::Result<()>) -> anyhow::Result<()> {
        match self.front {
            Front::Terminal(_) => {}
            #[cfg(feature = "view")]
            Front::Page(page) => page.end(&result, &self.stop),
        }
        result
    }
}
