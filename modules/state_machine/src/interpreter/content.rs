//! Executable content: actions, and the data of a chart.

use super::{Delayed, Effect, Event, EventKind, Failure, Interpreter, MOST_WAITING, PROCESSOR, Target};
use crate::chart::{ASSIGNED, Action, Data, Given, Payload, Send, duration};
use crate::expressions::{Problem, Program};
use rhai::{Dynamic, Map};
use std::time::Duration;

impl Interpreter {
    pub(super) fn initialise(&mut self, state: usize, data: &[Data]) {
        if !self.initialised.insert(state) {
            return;
        }
        for data in data {
            let Some(value) = &data.value else { continue };
            match self.evaluator.value(value, &mut self.scope) {
                Ok(value) => _ = self.scope.set_value(data.id.clone(), value),
                Err(problem) => self.note(Err(Problem { line: data.line, ..problem }.into())),
            }
        }
    }

    /// Executes a block; an error ends it and becomes an event.
    pub(super) fn execute(&mut self, block: &[Action]) {
        let result = self.try_execute(block);
        self.note(result);
    }

    pub(super) fn note(&mut self, result: Result<(), Failure>) {
        if let Err(Failure { event, problem, send_id }) = result {
            let data = Map::from([
                ("line".into(), i64::from(problem.line).into()),
                ("text".into(), problem.text.clone().into()),
            ]);
            let event = Event { kind: EventKind::Platform, ..Event::internal(event, data.into()) };
            self.raise(event.of(send_id));
            self.effects.push(Effect::Fault(problem));
        }
    }

    fn try_execute(&mut self, block: &[Action]) -> Result<(), Failure> {
        for action in block {
            match action {
                Action::Raise { event } => self.raise(Event::internal(event, Dynamic::UNIT)),
                Action::Send(send) => self.try_send(send)?,
                Action::Cancel { id, line } => {
                    let id = self.text(id, *line)?;
                    self.delayed.retain(|delayed| delayed.id.as_deref() != Some(id.as_str()));
                }
                Action::Log { label, value, line } => {
                    let value = value
                        .as_ref()
                        .map(|value| self.evaluator.value(value, &mut self.scope))
                        .transpose()?;
                    let text = value.map_or_else(String::new, |value| value.to_string());
                    self.effects.push(Effect::Log { label: label.clone(), text, line: *line });
                }
                Action::Assign { location, value } => {
                    let value = self.evaluator.value(value, &mut self.scope)?;
                    self.assign(location, value)?;
                }
                Action::Script(script) => self.evaluator.run(script, &mut self.scope)?,
                Action::If { branches } => {
                    for (condition, actions) in branches {
                        let holds = match condition {
                            None => true,
                            // A condition that fails is false, and the rest of the block goes on.
                            Some(condition) => match self.evaluator.holds(condition, &mut self.scope) {
                                Ok(holds) => holds,
                                Err(problem) => {
                                    self.note(Err(problem.into()));
                                    false
                                }
                            },
                        };
                        if holds {
                            self.try_execute(actions)?;
                            break;
                        }
                    }
                }
                Action::ForEach(each) => {
                    let array = self.evaluator.value(&each.array, &mut self.scope)?;
                    let array = array.into_array().map_err(|found| Problem {
                        line: each.array.line,
                        text: format!("`{}` is of type {found}; <foreach> needs an array", each.array.text),
                    })?;
                    for name in each
                        .names
                        .iter()
                        .flatten()
                        .filter(|name| !self.scope.contains(name))
                        .collect::<Vec<_>>()
                    {
                        self.scope.push_dynamic(name.clone(), Dynamic::UNIT);
                    }
                    for (index, item) in array.into_iter().enumerate() {
                        self.assign(&each.item, item)?;
                        if let Some(location) = &each.index {
                            self.assign(location, Dynamic::from_int(index as i64))?;
                        }
                        self.try_execute(&each.body)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn assign(&mut self, location: &Program, value: Dynamic) -> Result<(), Problem> {
        let variable = variable_of(&location.text);
        let is_received = self.chart.interface.subscriptions.iter().any(|port| port.name == variable);
        if is_received || variable == "setting" || variable.starts_with('_') {
            let text = format!("`{}` cannot be assigned: only variables of <data> can", location.text);
            return Err(Problem { line: location.line, text });
        }
        let variables = self.scope.len();
        self.scope.push_constant_dynamic(ASSIGNED, value);
        let result = self.evaluator.run(location, &mut self.scope);
        self.scope.rewind(variables);
        result
    }

    fn text(&mut self, given: &Given, line: u32) -> Result<String, Problem> {
        match given {
            Given::Text(text) => Ok(text.clone()),
            Given::Computed(program) => {
                let value = self.evaluator.value(program, &mut self.scope)?;
                value.into_string().map_err(|found| Problem {
                    line,
                    text: format!("`{}` is of type {found}; a text is needed", program.text),
                })
            }
        }
    }

    /// The data of an event, and the first error in them; fields with errors are left out.
    pub(super) fn payload(&mut self, payload: &Payload) -> (Dynamic, Result<(), Failure>) {
        let mut result = Ok(());
        let data = match payload {
            Payload::None => Dynamic::UNIT,
            Payload::Content(Given::Text(text)) => self.evaluator.read(text),
            Payload::Content(Given::Computed(value)) => {
                let value = self.evaluator.value(value, &mut self.scope);
                value.unwrap_or_else(|problem| {
                    result = Err(problem.into());
                    Dynamic::UNIT
                })
            }
            Payload::Parameters(parameters) => {
                let mut map = Map::new();
                for (name, value) in parameters {
                    match self.evaluator.value(value, &mut self.scope) {
                        Ok(value) => _ = map.insert(name.as_str().into(), value),
                        Err(problem) if result.is_ok() => result = Err(problem.into()),
                        Err(_) => {}
                    }
                }
                if map.is_empty() { Dynamic::UNIT } else { map.into() }
            }
        };
        (data, result)
    }

    fn try_send(&mut self, send: &Send) -> Result<(), Failure> {
        let id = match (&send.id, &send.id_location) {
            (Some(id), _) => Some(id.clone()),
            (None, Some(location)) => {
                self.made_up += 1;
                let id = format!("send.{}", self.made_up);
                self.assign(location, id.clone().into())?;
                Some(id)
            }
            (None, None) => None,
        };
        let fail =
            |event, text| Failure { event, problem: Problem { line: send.line, text }, send_id: id.clone() };
        let kind = send.kind.as_ref().map(|kind| self.text(kind, send.line)).transpose()?;
        if let Some(kind) = kind.filter(|kind| {
            !["scxml", PROCESSOR, "http://www.w3.org/TR/scxml/"].contains(&kind.trim_end_matches('#'))
        }) {
            return Err(fail(
                "error.execution",
                format!("`type` of <send> is \"scxml\" or missing, not \"{kind}\""),
            ));
        }
        let name =
            send.event.as_ref().map(|event| self.text(event, send.line)).transpose()?.unwrap_or_default();
        let target = send.target.as_ref().map(|target| self.text(target, send.line)).transpose()?;
        let target = match target.as_deref() {
            None => Target::Own,
            Some("#_internal") => Target::Internal,
            Some(own) if own.strip_prefix("#_scxml_") == Some(self.session.as_str()) => Target::Own,
            Some("#_scxml_self") => Target::Own,
            Some(session) if session.starts_with("#_") => {
                return Err(fail("error.communication", format!("<send> cannot reach \"{session}\"")));
            }
            Some(port) => {
                let interface = &self.chart.interface;
                let mut ports =
                    [&interface.publishers, &interface.services, &interface.actions].into_iter().flatten();
                if !ports.any(|known| known.name == port) {
                    let text = format!("<send> has the target \"{port}\", which the chart does not declare");
                    return Err(fail("error.execution", text));
                }
                Target::Port(port.to_owned())
            }
        };
        let delay = match &send.delay {
            None => Duration::ZERO,
            Some(delay) => {
                let text = self.text(delay, send.line)?;
                duration(&text).ok_or_else(|| {
                    fail("error.execution", format!("\"{text}\" is no delay such as \"1.5s\""))
                })?
            }
        };
        if delay > Duration::ZERO && matches!(target, Target::Internal) {
            return Err(fail("error.execution", "an event for \"#_internal\" has no delay".to_owned()));
        }
        let (data, result) = self.payload(&send.payload);
        result?;
        let kind = if matches!(target, Target::Internal) { EventKind::Internal } else { EventKind::External };
        let event = Event { name, data, kind, send_id: send.id.clone().or_else(|| id.clone()), is_own: true };
        if delay == Duration::ZERO {
            self.deliver(target, event, id, send.line);
        } else if self.delayed.len() < MOST_WAITING {
            let due = self.evaluator.world.read().now.saturating_add(delay);
            self.delayed.push(Delayed { due, id, target, event, line: send.line });
        } else {
            let text = format!("more than {MOST_WAITING} delayed events wait");
            return Err(fail("error.execution", text));
        }
        Ok(())
    }
}

/// The variable that a location is, or is in.
fn variable_of(location: &str) -> &str {
    let end = location.find(|c: char| c != '_' && !c.is_ascii_alphanumeric()).unwrap_or(location.len());
    &location[..end]
}
