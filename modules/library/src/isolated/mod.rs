//! Libraries in child processes.
//!
//! The program starts itself with the hidden command `library-child`, whose standard input and output are
//! pipes. Both sides take turns: a frame of the robot makes one call of the library; the frames of the child
//! hold what the library requests, up to a question or to the end of the call. What a library has requested
//! in a call takes effect when the call has ended or asks something.

mod child;
mod function;
mod process;
mod wire;

pub use child::child;
pub use process::set_child_command;

use crate::LibraryOptions;
use crate::call::{LogLine, Requests, log_line, number_of, transition_of};
use crate::instance::event_in_c;
use crate::module::state_of;
use crate::variables::Shown;
use crate::watch::Watch;
use downbeat_edge::foreign::{Declarations, Event, Foreign, ForeignContext, SavedState, SettingDeclaration};
use downbeat_executor::{Failure, SettingValue, Transition};
use function::{Declared, Function, Names};
use process::{PATIENCE, Process};
use std::cell::RefCell;
use std::fmt;
use std::time::Duration;
use wire::{Fields, Frame, Garbled, answer, ask, end, say};

/// A module of a library that a child process has loaded.
pub(crate) struct IsolatedModule {
    /// Lent for the time of a call.
    process: RefCell<Process>,
    options: LibraryOptions,
    /// Of a library that is reloaded.
    watch: Option<Watch>,
    names: Names,
    shown: Shown,
}

/// Takes one thing that a child says in a call. The answer to a question is written to the frame.
type Take<'a> = dyn FnMut(u8, &mut Fields<'_>, &mut Frame) -> Result<(), Problem> + 'a;

enum Problem {
    /// The request is refused. The call goes on, and fails at its end.
    Refused(String),
    /// The frame cannot be read.
    Garbled(Garbled),
}

impl From<Garbled> for Problem {
    fn from(garbled: Garbled) -> Self {
        Self::Garbled(garbled)
    }
}

impl From<String> for Problem {
    fn from(reason: String) -> Self {
        Self::Refused(reason)
    }
}

/// Starts a child process and lets it load the library.
pub(crate) fn start(options: &LibraryOptions) -> Result<Box<dyn Foreign>, String> {
    Ok(Box::new(IsolatedModule::start(options)?))
}

impl IsolatedModule {
    fn start(options: &LibraryOptions) -> Result<Self, String> {
        let watch = options.is_reloaded.then(|| Watch::new(&options.path));
        let process = Process::start(&options.path)?;
        let id = process.id();
        let started = Self {
            process: RefCell::new(process),
            options: options.clone(),
            watch,
            names: Names::new(),
            shown: Shown::default(),
        };
        let path = std::path::absolute(&options.path).unwrap_or_else(|_| options.path.clone());
        started.call(
            Function::Create,
            PATIENCE,
            |frame| {
                frame.tag(ask::START);
                frame.text(&path.to_string_lossy());
                frame.flag(options.is_reloaded);
                frame.text(&options.module);
            },
            &mut |_, _, _| Err(Garbled.into()),
        )?;
        let module = &options.module;
        tracing::debug!(module, "child process {id} loaded {}", path.display());
        Ok(started)
    }

    /// Makes one call of the library, which may take until `limit`, and returns its bytes: what it saved, or
    /// the text of its variables.
    fn call(
        &self,
        function: Function,
        limit: Duration,
        write: impl FnOnce(&mut Frame),
        take: &mut Take<'_>,
    ) -> Result<Vec<u8>, String> {
        let Ok(mut process) = self.process.try_borrow_mut() else {
            return Err("another call of the library is under way".to_owned());
        };
        process.begin(limit);
        let result = self.exchange(&mut process, function, limit, write, take);
        process.pause();
        result
    }

    fn exchange(
        &self,
        process: &mut Process,
        function: Function,
        limit: Duration,
        write: impl FnOnce(&mut Frame),
        take: &mut Take<'_>,
    ) -> Result<Vec<u8>, String> {
        let module = &self.options.module;
        let channel = &mut process.channel;
        write(channel.frame());
        let mut refusal = None;
        loop {
            let sent = channel.send();
            let fields = sent.and_then(|()| channel.receive());
            let mut fields = match fields {
                Ok(fields) => fields,
                Err(_) => return Err(process.end(&function.words(&self.names), limit)),
            };
            let mut answer = Frame::default();
            let result = loop {
                let tag = match fields.tag() {
                    Ok(tag) => tag,
                    // All is said up to a question, which is answered.
                    Err(_) if !answer.is_empty() => break None,
                    Err(garbled) => return Err(garbled.to_string()),
                };
                match tag {
                    end::OK => {
                        break Some(Ok(fields.bytes().map_err(|garbled| garbled.to_string())?.to_vec()));
                    }
                    end::FAILED => {
                        break Some(Err(fields.text().map_err(|garbled| garbled.to_string())?.to_owned()));
                    }
                    say::LOG => {
                        let line = logged(&mut fields).map_err(|garbled| garbled.to_string())?;
                        log_line(module, &line);
                    }
                    tag => match take(tag, &mut fields, &mut answer) {
                        Ok(()) => {}
                        Err(Problem::Refused(reason)) => {
                            if tag >= ask::FIRST {
                                answer.clear();
                                answer.tag(answer::REFUSED);
                                answer.text(&reason);
                            } else {
                                refusal.get_or_insert(reason);
                            }
                        }
                        Err(Problem::Garbled(garbled)) => return Err(garbled.to_string()),
                    },
                }
            };
            match (result, refusal.take()) {
                (Some(Ok(_)), Some(reason)) => return Err(reason),
                (Some(result), _) => return result,
                (None, kept) => refusal = kept,
            }
            *channel.frame() = answer;
        }
    }
}

impl Foreign for IsolatedModule {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        if self.watch.is_some() {
            declarations.reload();
        }
        let write = |frame: &mut Frame| frame.tag(ask::SETUP);
        let mut names = Names::new();
        self.call(Function::Setup, PATIENCE, write, &mut |tag, fields, answer| {
            declare(tag, fields, answer, declarations, &mut names)
        })?;
        self.names = names;
        Ok(())
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        let in_c = event_in_c(&event);
        let data: &[u8] = match &event {
            Event::Message { cdr, .. } | Event::Request { cdr, .. } => cdr,
            Event::Reply { result: Ok(cdr), .. } => cdr,
            Event::Reply { result: Err(reason), .. } => reason.as_bytes(),
            _ => &[],
        };
        let now = Requests::now(context).as_nanos();
        let (function, limit) = (Function::handling(&event), self.options.time_limit);
        let write = |frame: &mut Frame| {
            frame.tag(ask::HANDLE);
            frame.number(now as u64);
            frame.event(&in_c, data);
        };
        self.call(function, limit, write, &mut |tag, fields, answer| request(tag, fields, answer, context))?;
        Ok(())
    }

    fn transition(
        &mut self,
        transition: Transition,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        let now = Requests::now(context).as_nanos();
        let write = |frame: &mut Frame| {
            frame.tag(ask::TRANSITION);
            frame.number(now as u64);
            frame.number(number_of(transition).into());
        };
        // While it shuts down, the robot waits for it to end.
        let limit = if transition == Transition::Shutdown { self.options.time_limit } else { PATIENCE };
        self.call(Function::Transition(transition), limit, write, &mut |tag, fields, answer| {
            request(tag, fields, answer, context)
        })?;
        Ok(())
    }

    fn accept(&mut self, setting: u32, value: &SettingValue) -> Result<(), String> {
        let write = |frame: &mut Frame| {
            frame.tag(ask::ACCEPT);
            frame.number(setting.into());
            frame.value(value);
        };
        self.call(Function::Accept(setting), self.options.time_limit, write, &mut |_, _, _| {
            Err(Garbled.into())
        })?;
        Ok(())
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        if !self.watch.as_mut().is_some_and(Watch::has_changed) {
            return Ok(None);
        }
        Ok(Some(Box::new(Self::start(&self.options)?)))
    }

    fn save(&mut self) -> Result<SavedState, String> {
        let write = |frame: &mut Frame| frame.tag(ask::SAVE);
        let saved = self.call(Function::Save, PATIENCE, write, &mut |_, _, _| Err(Garbled.into()))?;
        Ok(Box::new(saved))
    }

    fn restore(&mut self, state: SavedState) -> Result<(), String> {
        let state = state_of(state)?;
        let write = |frame: &mut Frame| {
            frame.tag(ask::RESTORE);
            frame.bytes(&state);
        };
        self.call(Function::Restore, PATIENCE, write, &mut |_, _, _| Err(Garbled.into()))?;
        Ok(())
    }

    fn debug(&self) -> Option<&dyn fmt::Debug> {
        let write = |frame: &mut Frame| frame.tag(ask::VARIABLES);
        let limit = self.options.time_limit;
        let text = self.call(Function::Variables, limit, write, &mut |_, _, _| Err(Garbled.into()));
        self.shown.keep(match text {
            Ok(text) if text.is_empty() => None,
            Ok(text) => Some(String::from_utf8_lossy(&text).into_owned()),
            Err(reason) => Some(format!("its variables cannot be shown: {reason}")),
        })
    }
}

/// Reads a line of the log.
fn logged<'a>(fields: &mut Fields<'a>) -> Result<LogLine<'a>, Garbled> {
    let (severity, line) = (fields.number()? as i32, fields.number()? as u32);
    Ok(LogLine { severity, line, text: fields.text()?, file: fields.text()?, function: fields.text()? })
}

/// Passes a declaration on.
fn declare(
    tag: u8,
    fields: &mut Fields<'_>,
    answer: &mut Frame,
    declarations: &mut Declarations,
    names: &mut Names,
) -> Result<(), Problem> {
    let declared = Declared::of(tag);
    // The name is the first field of all that have one.
    let name = declared.map(|_| fields.clone().text().map(str::to_owned)).transpose()?;
    let number = match tag {
        ask::PUBLISHER => declarations.publish(fields.text()?, fields.text()?, fields.optional_text()?),
        ask::SUBSCRIPTION => declarations.subscribe(fields.text()?, fields.text()?, fields.optional_text()?),
        ask::SERVER => declarations.serve(fields.text()?, fields.text()?, fields.optional_text()?),
        ask::CLIENT => declarations.client(
            fields.text()?,
            fields.text()?,
            fields.optional_text()?,
            Duration::from_nanos(fields.number()?),
        ),
        ask::DEFINE => {
            declarations.define(fields.text()?, fields.text()?)?;
            0
        }
        ask::TIMER => declarations.every(Duration::from_nanos(fields.number()?)),
        ask::TASK => declarations.task(),
        ask::EACH_RUN => {
            declarations.each_run();
            0
        }
        ask::SETTING => {
            let setting = SettingDeclaration {
                name: fields.text()?.to_owned(),
                description: fields.text()?.to_owned(),
                default: fields.value()?,
                range: match fields.flag()? {
                    true => Some(f64::from_bits(fields.number()?)..=f64::from_bits(fields.number()?)),
                    false => None,
                },
                is_read_only: fields.flag()?,
            };
            let (number, value) = declarations.setting(setting)?;
            answer.tag(answer::OK);
            answer.number(number.into());
            answer.value(&value);
            names.extend(name.map(|name| ((Declared::Setting, number), name)));
            return Ok(());
        }
        _ => return Err(Garbled.into()),
    };
    answer.tag(answer::OK);
    answer.number(number.into());
    names.extend(declared.zip(name).map(|(declared, name)| ((declared, number), name)));
    Ok(())
}

/// Passes a request on.
fn request(
    tag: u8,
    fields: &mut Fields<'_>,
    answer: &mut Frame,
    requests: &mut dyn Requests,
) -> Result<(), Problem> {
    match tag {
        say::PUBLISH => requests.publish(fields.number()? as u32, fields.bytes()?)?,
        say::REPLY => {
            let (request, is_error) = (fields.number()?, fields.flag()?);
            match is_error {
                false => requests.reply(request, Ok(fields.bytes()?))?,
                true => requests.reply(request, Err(fields.text()?.to_owned()))?,
            }
        }
        say::SET => {
            let (module, setting) = (fields.text()?, fields.text()?);
            requests.set(module, setting, fields.value()?);
        }
        say::SCHEDULE => {
            requests.schedule_after(fields.number()? as u32, Duration::from_nanos(fields.number()?))?;
        }
        say::CANCEL => requests.cancel(fields.number()? as u32)?,
        say::TRANSITION => {
            let module = fields.text()?;
            requests.transition(module, transition_of(fields.number()? as u32)?);
        }
        say::REMOVE => requests.remove(fields.text()?),
        ask::CALL => {
            let id = requests.call(fields.number()? as u32, fields.bytes()?)?;
            answer.tag(answer::OK);
            answer.number(id);
        }
        ask::GET => {
            let value = requests.setting(fields.number()? as u32)?;
            answer.tag(answer::OK);
            answer.value(&value);
        }
        _ => return Err(Garbled.into()),
    }
    Ok(())
}
