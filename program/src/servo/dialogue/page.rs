//! A page in the browser: buttons answer, and the joints are shown all the time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_servos::servo_bus::TurnedJoint;
use downbeat_view::{Ask, Host, PageOptions, ViewOptions, ViewServer};
use parking_lot::Mutex;
use serde_json::{Value, json};

use super::Answer;
use crate::stop::Stop;

/// How long the end is shown to a page that does not ask for it.
const PATIENCE: Duration = Duration::from_secs(5);

pub(super) struct Page {
    state: Arc<State>,
    _server: ViewServer,
}

#[derive(Default)]
struct State(Mutex<Shown>);

/// What the page shows, and the answer that it gave.
#[derive(Default)]
struct Shown {
    /// What it says when it is over.
    done: &'static str,
    lines: Vec<String>,
    /// The question and its number; an answer to another one comes too late.
    question: String,
    number: u64,
    answers: Vec<Answer>,
    joints: Vec<Value>,
    answer: Option<String>,
    /// How it ended: an error, or nothing.
    end: Option<Option<String>>,
    /// Whether the page knows.
    has_seen_end: bool,
}

impl Page {
    pub(super) fn open(port: u16, done: &'static str) -> anyhow::Result<Self> {
        let state = Arc::new(State(Mutex::new(Shown { done, ..Shown::default() })));
        let page = PageOptions {
            port: Some(port),
            start: "calibrate.html",
            host: Some(Arc::clone(&state) as Arc<dyn Host>),
            ..PageOptions::default()
        };
        let options = ViewOptions { foxglove: None, page: Some(page), ..ViewOptions::new("calibrate")? };
        let server = ViewServer::start_page(options)?;
        println!("open in a browser: {}", server.page_url().unwrap_or_default());
        Ok(Self { state, _server: server })
    }

    pub(super) fn say(&self, line: String) {
        self.state.0.lock().lines.push(line);
    }

    pub(super) fn ask(&self, question: &str, answers: &[Answer]) {
        let mut shown = self.state.0.lock();
        question.clone_into(&mut shown.question);
        answers.clone_into(&mut shown.answers);
        shown.number += 1;
    }

    pub(super) fn answer(&self, joints: &[TurnedJoint]) -> Option<String> {
        let mut shown = self.state.0.lock();
        shown.joints = joints.iter().map(of_joint).collect();
        shown.answer.take()
    }

    /// Waits until the page has it.
    pub(super) fn end(&self, result: &anyhow::Result<()>, stop: &Stop) {
        self.state.0.lock().end = Some(result.as_ref().err().map(|error| format!("{error:#}")));
        let until = Instant::now() + PATIENCE;
        while !self.state.0.lock().has_seen_end && Instant::now() < until && !stop.is_due() {
            stop.sleep(Duration::from_millis(20));
        }
    }
}

fn of_joint(joint: &TurnedJoint) -> Value {
    let TurnedJoint { name, id, travel_rad, place, is_silent } = joint;
    json!({ "name": name, "id": id.raw(), "travel": travel_rad.to_degrees(), "place": place, "isSilent": is_silent })
}

impl Host for State {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        match ask.name {
            "calibration" => Some(Ok(self.0.lock().shown())),
            "answer" => Some(ask.check_access().and_then(|()| self.0.lock().take(ask))),
            _ => None,
        }
    }
}

impl Shown {
    fn shown(&mut self) -> Value {
        self.has_seen_end |= self.end.is_some();
        let answers = self.answers.iter().map(|(typed, is)| json!({ "answer": typed, "is": is }));
        json!({
            "done": self.done,
            "lines": self.lines,
            "question": self.question,
            "number": self.number,
            "answers": answers.collect::<Vec<_>>(),
            "joints": self.joints,
            "isOver": self.end.is_some(),
            "error": self.end.as_ref().and_then(Option::as_ref),
        })
    }

    fn take(&mut self, ask: Ask<'_>) -> Result<Value, String> {
        let given = ask.require_text("answer")?;
        if ask.arguments["number"].as_u64() != Some(self.number) {
            return Err("this question has been answered".to_owned());
        }
        if !self.answers.iter().any(|(typed, _)| *typed == given) {
            return Err(format!("{given:?} is no answer to it"));
        }
        self.answer = Some(given.to_owned());
        Ok(Value::Null)
    }
}
