//! The child process, seen from its library.

use super::process::FAREWELL;
use super::wire::{Channel, Fields, Frame, Garbled, answer, ask, end, say};
use crate::call::{Declare, Requests, number_of, transition_of};
use crate::instance::Instance;
use crate::library::Library;
use crate::parent;
use downbeat_edge::foreign::SettingDeclaration;
use downbeat_executor::{SettingValue, Time, Transition};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, PipeReader, PipeWriter};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

/// The main function of a child process: loads the library that the robot names on standard input, and ends
/// with the robot.
#[must_use]
pub fn child() -> ExitCode {
    match serve() {
        // The robot has closed its end.
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("downbeat: this command is started by robots, for modules with `isolate`: {error}");
            ExitCode::FAILURE
        }
        Ok(never) => match never {},
    }
}

/// The connection to the robot, which is also used while the library is called.
type Shared = Arc<Mutex<Channel>>;

fn serve() -> io::Result<std::convert::Infallible> {
    let reader = PipeReader::from(io::stdin().as_fd().try_clone_to_owned()?);
    let writer = PipeWriter::from(io::stdout().as_fd().try_clone_to_owned()?);
    // What a library reads from standard input or prints must not disturb the connection.
    rustix::stdio::dup2_stdin(File::open("/dev/null")?)?;
    rustix::stdio::dup2_stdout(io::stderr())?;
    parent::end_with_it(reader.as_fd().try_clone_to_owned()?, FAREWELL)?;
    let shared: Shared = Arc::new(Mutex::new(Channel::new(reader, writer)));
    // The robot waits for it.
    shared.lock().send()?;
    let mut module = None;
    let mut values = BTreeMap::new();
    loop {
        let frame = shared.lock().receive()?.to_vec();
        let result = call(&mut Fields::of(&frame), &shared, &mut module, &mut values);
        let mut channel = shared.lock();
        match result {
            Ok(saved) => {
                channel.frame().tag(end::OK);
                channel.frame().bytes(&saved);
            }
            Err(reason) => {
                channel.frame().tag(end::FAILED);
                channel.frame().text(&reason);
            }
        }
        channel.send()?;
    }
}

/// Makes one call of the library.
fn call(
    fields: &mut Fields<'_>,
    shared: &Shared,
    module: &mut Option<Instance>,
    values: &mut BTreeMap<u32, SettingValue>,
) -> Result<Vec<u8>, String> {
    let garbled = |garbled: Garbled| garbled.to_string();
    let tag = fields.tag().map_err(garbled)?;
    if tag == ask::START {
        let path = Path::new(fields.text().map_err(garbled)?);
        let library = match fields.flag().map_err(garbled)? {
            true => Library::load_copy(path),
            false => Library::load(path),
        };
        let name = fields.text().map_err(garbled)?;
        let library = library.map_err(|error| error.to_string())?;
        *module = Some(Instance::with_log(library, name, log(shared))?);
        return Ok(Vec::new());
    }
    let Some(module) = module else { return Err("no library is loaded".to_owned()) };
    match tag {
        ask::SETUP => module.setup(&mut Robot { shared, values, now: Time::ZERO })?,
        ask::HANDLE => {
            let now = Time::from_nanos(fields.number().map_err(garbled)? as i64);
            let (event, data) = fields.event().map_err(garbled)?;
            if event.kind == downbeat_library_abi::event::SETTING {
                values.clear();
            }
            let event = crate::instance::with_data(event, data);
            module.handle(&event, &mut Robot { shared, values, now })?;
        }
        ask::TRANSITION => {
            let now = Time::from_nanos(fields.number().map_err(garbled)? as i64);
            let transition = transition_of(fields.number().map_err(garbled)? as u32)?;
            values.clear();
            module.transition(transition, &mut Robot { shared, values, now })?;
        }
        ask::ACCEPT => {
            let setting = fields.number().map_err(garbled)? as u32;
            module.accept(setting, fields.value().map_err(garbled)?)?;
        }
        ask::SAVE => return module.save(),
        ask::VARIABLES => return Ok(module.variables().unwrap_or_default().into_bytes()),
        ask::RESTORE => module.restore(fields.bytes().map_err(garbled)?)?,
        _ => return Err(Garbled.to_string()),
    }
    Ok(Vec::new())
}

/// Sends lines of the log with what is said next.
fn log(shared: &Shared) -> crate::instance::Log {
    let shared = Arc::clone(shared);
    Box::new(move |line| {
        let mut channel = shared.lock();
        let frame = channel.frame();
        frame.tag(say::LOG);
        frame.number(line.severity as u64);
        frame.number(line.line.into());
        [line.text, line.file, line.function].into_iter().for_each(|text| frame.text(text));
    })
}

/// The robot, during a call of the library.
struct Robot<'a> {
    shared: &'a Shared,
    /// Settings that were asked for since the last change.
    values: &'a mut BTreeMap<u32, SettingValue>,
    now: Time,
}

impl Robot<'_> {
    /// Says something that the robot does not answer.
    fn say(&mut self, tag: u8, write: impl FnOnce(&mut Frame)) {
        let mut channel = self.shared.lock();
        channel.frame().tag(tag);
        write(channel.frame());
    }

    /// Asks the robot, and reads its answer.
    fn ask<T>(
        &mut self,
        tag: u8,
        write: impl FnOnce(&mut Frame),
        read: impl FnOnce(&mut Fields<'_>) -> Result<T, Garbled>,
    ) -> Result<T, String> {
        let mut channel = self.shared.lock();
        channel.frame().tag(tag);
        write(channel.frame());
        let received = channel.send().and_then(|()| channel.receive());
        let mut fields = received.map_err(|error| format!("the robot does not answer: {error}"))?;
        let result = match fields.tag() {
            Ok(answer::OK) => return read(&mut fields).map_err(|garbled| garbled.to_string()),
            Ok(answer::REFUSED) => fields.text().map(str::to_owned),
            _ => Err(Garbled),
        };
        Err(result.unwrap_or_else(|garbled| garbled.to_string()))
    }

    /// Declares something. There is no way to report that the robot has gone, which ends this process soon.
    fn declare(&mut self, tag: u8, write: impl FnOnce(&mut Frame)) -> u32 {
        self.ask(tag, write, |fields| fields.number()).map_or(u32::MAX, |number| number as u32)
    }
}

impl Requests for Robot<'_> {
    fn now(&self) -> Time {
        self.now
    }

    fn publish(&mut self, publisher: u32, cdr: &[u8]) -> Result<(), String> {
        self.say(say::PUBLISH, |frame| {
            frame.number(publisher.into());
            frame.bytes(cdr);
        });
        Ok(())
    }

    fn call(&mut self, client: u32, cdr: &[u8]) -> Result<u64, String> {
        let write = |frame: &mut Frame| {
            frame.number(client.into());
            frame.bytes(cdr);
        };
        self.ask(ask::CALL, write, |fields| fields.number())
    }

    fn reply(&mut self, request: u64, result: Result<&[u8], String>) -> Result<(), String> {
        self.say(say::REPLY, |frame| {
            frame.number(request);
            frame.flag(result.is_err());
            match &result {
                Ok(cdr) => frame.bytes(cdr),
                Err(reason) => frame.text(reason),
            }
        });
        Ok(())
    }

    fn setting(&mut self, setting: u32) -> Result<SettingValue, String> {
        if let Some(value) = self.values.get(&setting) {
            return Ok(value.clone());
        }
        let value = self.ask(ask::GET, |frame| frame.number(setting.into()), |fields| fields.value())?;
        self.values.insert(setting, value.clone());
        Ok(value)
    }

    fn set(&mut self, module: &str, setting: &str, value: SettingValue) {
        self.say(say::SET, |frame| {
            frame.text(module);
            frame.text(setting);
            frame.value(&value);
        });
    }

    fn schedule_after(&mut self, task: u32, delay: Duration) -> Result<(), String> {
        self.say(say::SCHEDULE, |frame| {
            frame.number(task.into());
            frame.number(delay.as_nanos() as u64);
        });
        Ok(())
    }

    fn cancel(&mut self, task: u32) -> Result<(), String> {
        self.say(say::CANCEL, |frame| frame.number(task.into()));
        Ok(())
    }

    fn transition(&mut self, module: &str, transition: Transition) {
        self.say(say::TRANSITION, |frame| {
            frame.text(module);
            frame.number(number_of(transition).into());
        });
    }

    fn remove(&mut self, module: &str) {
        self.say(say::REMOVE, |frame| frame.text(module));
    }
}

impl Declare for Robot<'_> {
    fn define(&mut self, name: &str, text: &str) -> Result<(), String> {
        let write = |frame: &mut Frame| {
            frame.text(name);
            frame.text(text);
        };
        self.ask(ask::DEFINE, write, |fields| fields.number()).map(drop)
    }

    fn publish(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        self.declare(ask::PUBLISHER, |frame| frame.named(topic, message, hash))
    }

    fn subscribe(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        self.declare(ask::SUBSCRIPTION, |frame| frame.named(topic, message, hash))
    }

    fn serve(&mut self, service: &str, of: &str, hash: Option<&str>) -> u32 {
        self.declare(ask::SERVER, |frame| frame.named(service, of, hash))
    }

    fn client(&mut self, service: &str, of: &str, hash: Option<&str>, timeout: Duration) -> u32 {
        self.declare(ask::CLIENT, |frame| {
            frame.named(service, of, hash);
            frame.number(timeout.as_nanos() as u64);
        })
    }

    fn every(&mut self, period: Duration) -> u32 {
        self.declare(ask::TIMER, |frame| frame.number(period.as_nanos() as u64))
    }

    fn task(&mut self) -> u32 {
        self.declare(ask::TASK, |_| {})
    }

    fn setting(&mut self, setting: SettingDeclaration) -> Result<(u32, SettingValue), String> {
        let write = |frame: &mut Frame| {
            frame.text(&setting.name);
            frame.text(&setting.description);
            frame.value(&setting.default);
            frame.flag(setting.range.is_some());
            if let Some(range) = &setting.range {
                frame.number(range.start().to_bits());
                frame.number(range.end().to_bits());
            }
            frame.flag(setting.is_read_only);
        };
        self.ask(ask::SETTING, write, |fields| Ok((fields.number()? as u32, fields.value()?)))
    }

    fn each_run(&mut self) {
        self.declare(ask::EACH_RUN, |_| {});
    }
}
