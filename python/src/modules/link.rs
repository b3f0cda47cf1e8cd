//! What a module in Python holds of its core: in `setup` it declares through it, in callbacks it asks through
//! it.

use super::values;
use crate::messages::{self, MessageType};
use downbeat::edge::foreign::{Declarations, ForeignContext, SettingDeclaration};
use downbeat::executor::{Failure, SettingValue, Transition};
use parking_lot::Mutex;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

/// The link of one module to its core.
#[pyclass(frozen, module = "downbeat._core")]
#[derive(Default)]
pub(crate) struct Link(Mutex<State>);

#[derive(Default)]
struct State {
    module_name: String,
    now: i64,
    /// During `setup`.
    declarations: Option<Declarations>,
    callbacks: Callbacks,
    settings: Vec<SettingValue>,
    setting_numbers: HashMap<String, usize>,
    /// True while a callback runs.
    is_running: bool,
    asked: Vec<Asked>,
    /// How many calls each client has made.
    calls: Vec<u64>,
}

/// The functions of a module, by the numbers of its declarations.
#[derive(Default)]
pub(super) struct Callbacks {
    pub(super) subscriptions: Vec<(Arc<MessageType>, Py<PyAny>)>,
    pub(super) servers: Vec<Server>,
    /// The type of responses.
    pub(super) clients: Vec<Arc<MessageType>>,
    pub(super) timers: Vec<Py<PyAny>>,
    pub(super) tasks: Vec<Py<PyAny>>,
    pub(super) each_run: Vec<Py<PyAny>>,
    /// By number of the setting.
    pub(super) on_change: Vec<(usize, Py<PyAny>)>,
    /// The functions that take the responses of calls.
    pub(super) replies: HashMap<(u32, u64), Py<PyAny>>,
}

/// A service that a module serves.
pub(super) struct Server {
    pub(super) request: Arc<MessageType>,
    pub(super) response: Arc<MessageType>,
    pub(super) callback: Py<PyAny>,
}

/// What a callback has asked for.
enum Asked {
    Publish { publisher: u32, cdr: Vec<u8> },
    Call { client: u32, cdr: Vec<u8> },
    Reply { request: u64, result: Result<Vec<u8>, String> },
    Set { module: String, setting: String, value: SettingValue },
    Schedule { task: u32, delay: Duration },
    Cancel { task: u32 },
    Transition { module: String, transition: Transition },
    Remove { module: String },
}

impl Link {
    /// Runs `setup` with declarations to fill, and returns what it returns with them.
    pub(super) fn declaring<T>(&self, declarations: &mut Declarations, setup: impl FnOnce() -> T) -> T {
        {
            let mut state = self.0.lock();
            state.module_name = declarations.module_name().to_owned();
            state.declarations = Some(std::mem::take(declarations));
        }
        let result = setup();
        if let Some(declared) = self.0.lock().declarations.take() {
            *declarations = declared;
        }
        result
    }

    /// Runs a callback, then asks the core for what the callback has asked for. After an error it asks for
    /// nothing.
    pub(super) fn running(
        &self,
        context: &mut ForeignContext<'_, '_>,
        callback: impl FnOnce() -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        {
            let mut state = self.0.lock();
            state.now = context.now().as_nanos();
            state.is_running = true;
        }
        let result = callback();
        let asked = {
            let mut state = self.0.lock();
            state.is_running = false;
            std::mem::take(&mut state.asked)
        };
        result?;
        asked.into_iter().try_for_each(|asked| apply(context, asked))
    }

    /// Takes over the value that a setting has now.
    pub(super) fn refresh(&self, setting: u32, context: &ForeignContext<'_, '_>) {
        if let Ok(value) = context.setting(setting) {
            let mut state = self.0.lock();
            if let Some(known) = state.settings.get_mut(setting as usize) {
                *known = value.clone();
            }
        }
    }

    pub(super) fn setting_name(&self, setting: u32) -> Option<String> {
        let state = self.0.lock();
        let found = state.setting_numbers.iter().find(|(_, number)| **number == setting as usize);
        found.map(|(name, _)| name.clone())
    }

    pub(super) fn callbacks<T>(&self, look: impl FnOnce(&mut Callbacks) -> T) -> T {
        look(&mut self.0.lock().callbacks)
    }

    fn declare<T>(
        &self,
        what: &str,
        declare: impl FnOnce(&mut Declarations, &mut State) -> T,
    ) -> PyResult<T> {
        let mut state = self.0.lock();
        let Some(mut declarations) = state.declarations.take() else {
            return Err(PyRuntimeError::new_err(format!(
                "{what} is for setup(): a module's ports do not change later"
            )));
        };
        let result = declare(&mut declarations, &mut state);
        state.declarations = Some(declarations);
        Ok(result)
    }

    /// The message type of that name, or of that part of a service or action, which the robot knows from now
    /// on. What this package does not know, the robot may.
    fn message_type(&self, py: Python<'_>, name: &str) -> PyResult<Arc<MessageType>> {
        if messages::interface(name).is_none()
            && let Ok(Ok((whole, text))) =
                self.declare("a port", |declarations, _| declarations.definition_text(name))
        {
            messages::learn(&whole, &text)?;
        }
        let found = messages::message_type(py, name)?;
        if let Some((whole, text, _)) = messages::interface(name) {
            let defined = self.declare("a port", |declarations, _| declarations.define(&whole, &text))?;
            defined.map_err(PyValueError::new_err)?;
        }
        Ok(found)
    }

    fn ask(&self, what: &str, asked: impl FnOnce(&mut State) -> Asked) -> PyResult<()> {
        let mut state = self.0.lock();
        if !state.is_running {
            let when = match state.declarations {
                Some(_) => "setup() runs before the module does",
                None => "it was used on another thread, or after the callback has returned",
            };
            return Err(PyRuntimeError::new_err(format!("{what} is for callbacks: {when}")));
        }
        let asked = asked(&mut state);
        state.asked.push(asked);
        Ok(())
    }
}

/// The hash of a service, which was found.
fn hash_of(service: &str) -> Option<String> {
    messages::interface(service).map(|(_, _, hash)| hash)
}

fn apply(context: &mut ForeignContext<'_, '_>, asked: Asked) -> Result<(), Failure> {
    let refused = match asked {
        Asked::Publish { publisher, cdr } => context.publish_shared(publisher, &cdr.into()).err(),
        Asked::Call { client, cdr } => context.call(client, &cdr).err(),
        Asked::Reply { request, result } => {
            context.reply(request, result.as_deref().map_err(String::clone)).err()
        }
        Asked::Schedule { task, delay } => context.schedule_after(task, delay).err(),
        Asked::Cancel { task } => context.cancel(task).err(),
        Asked::Set { module, setting, value } => {
            context.set(&module, &setting, value);
            None
        }
        Asked::Transition { module, transition } => {
            context.transition(&module, transition);
            None
        }
        Asked::Remove { module } => {
            context.remove(&module);
            None
        }
    };
    refused.map_or(Ok(()), |error| Err(error.into()))
}

#[pymethods]
impl Link {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    #[getter]
    fn module_name(&self) -> String {
        self.0.lock().module_name.clone()
    }

    /// The time of the cycle in nanoseconds.
    #[getter]
    fn now(&self) -> i64 {
        self.0.lock().now
    }

    fn publish(slf: Py<Self>, py: Python<'_>, topic: &str, type_name: &str) -> PyResult<Publisher> {
        let link = slf.get();
        let message = link.message_type(py, type_name)?;
        let number = link.declare("publish()", |declarations, _| {
            declarations.publish(topic, &message.name, Some(&message.hash))
        })?;
        Ok(Publisher { link: slf, number, topic: topic.to_owned(), message })
    }

    fn subscribe(&self, py: Python<'_>, topic: &str, type_name: &str, callback: Py<PyAny>) -> PyResult<()> {
        let message = self.message_type(py, type_name)?;
        self.declare("subscribe()", |declarations, state| {
            declarations.subscribe(topic, &message.name, Some(&message.hash));
            state.callbacks.subscriptions.push((message, callback));
        })
    }

    fn serve(&self, py: Python<'_>, service: &str, type_name: &str, callback: Py<PyAny>) -> PyResult<()> {
        let request = self.message_type(py, &format!("{type_name}_Request"))?;
        let response = self.message_type(py, &format!("{type_name}_Response"))?;
        self.declare("serve()", |declarations, state| {
            declarations.serve(service, type_name, hash_of(type_name).as_deref());
            state.callbacks.servers.push(Server { request, response, callback });
        })
    }

    fn client(
        slf: Py<Self>,
        py: Python<'_>,
        service: &str,
        type_name: &str,
        timeout: f64,
    ) -> PyResult<Client> {
        let link = slf.get();
        let request = link.message_type(py, &format!("{type_name}_Request"))?;
        let response = link.message_type(py, &format!("{type_name}_Response"))?;
        let timeout = seconds(timeout)?;
        let number = link.declare("client()", |declarations, state| {
            state.callbacks.clients.push(response);
            state.calls.push(0);
            declarations.client(service, type_name, hash_of(type_name).as_deref(), timeout)
        })?;
        Ok(Client { link: slf, number, service: service.to_owned(), request })
    }

    fn every(&self, period: f64, callback: Py<PyAny>) -> PyResult<()> {
        let period = seconds(period)?;
        self.declare("every()", |declarations, state| {
            declarations.every(period);
            state.callbacks.timers.push(callback);
        })
    }

    fn task(&self, callback: Py<PyAny>) -> PyResult<u32> {
        self.declare("task()", |declarations, state| {
            state.callbacks.tasks.push(callback);
            declarations.task()
        })
    }

    fn each_run(&self, callback: Py<PyAny>) -> PyResult<()> {
        self.declare("each_run()", |declarations, state| {
            state.callbacks.each_run.push(callback);
            declarations.each_run();
        })
    }

    #[pyo3(signature = (name, default, description, range=None, read_only=false))]
    fn declare_setting(
        &self,
        name: &str,
        default: &Bound<'_, PyAny>,
        description: &str,
        range: Option<(f64, f64)>,
        read_only: bool,
    ) -> PyResult<()> {
        let setting = SettingDeclaration {
            name: name.to_owned(),
            description: description.to_owned(),
            default: values::from_python(default)?,
            range: range.map(|(start, end)| start..=end),
            is_read_only: read_only,
        };
        let declared = self.declare("a setting", |declarations, state| {
            let (number, value) = declarations.setting(setting)?;
            state.settings.push(value);
            state.setting_numbers.insert(name.to_owned(), number as usize);
            Ok::<(), String>(())
        })?;
        declared.map_err(PyValueError::new_err)
    }

    fn on_change(&self, setting: &str, callback: Py<PyAny>) -> PyResult<()> {
        let known = self.declare("on_change()", |_, state| {
            let number = state.setting_numbers.get(setting).copied();
            number.map(|number| state.callbacks.on_change.push((number, callback)))
        })?;
        known.ok_or_else(|| PyValueError::new_err(format!("there is no setting \"{setting}\"")))
    }

    /// The value of a setting; `None` before it is declared.
    fn setting(&self, py: Python<'_>, name: &str) -> PyResult<Option<Py<PyAny>>> {
        let value = {
            let state = self.0.lock();
            state.setting_numbers.get(name).and_then(|&number| state.settings.get(number)).cloned()
        };
        value.map(|value| values::to_python(py, &value)).transpose()
    }

    fn set(&self, module: &str, setting: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value = values::from_python(value)?;
        let (module, setting) = (module.to_owned(), setting.to_owned());
        self.ask("set()", |_| Asked::Set { module, setting, value })
    }

    fn schedule(&self, task: u32, delay: f64) -> PyResult<()> {
        let delay = seconds(delay)?;
        self.ask("Task.after()", |_| Asked::Schedule { task, delay })
    }

    fn cancel(&self, task: u32) -> PyResult<()> {
        self.ask("Task.cancel()", |_| Asked::Cancel { task })
    }

    fn transition(&self, module: &str, transition: &str) -> PyResult<()> {
        let known = [
            ("configure", Transition::Configure),
            ("activate", Transition::Activate),
            ("deactivate", Transition::Deactivate),
            ("cleanup", Transition::Cleanup),
            ("shutdown", Transition::Shutdown),
        ];
        let found = known.into_iter().find(|(name, _)| *name == transition);
        let (_, transition) = found.ok_or_else(|| {
            let names = known.map(|(name, _)| name).join(", ");
            PyValueError::new_err(format!("unknown transition \"{transition}\"; there is {names}"))
        })?;
        let module = module.to_owned();
        self.ask("transition()", |_| Asked::Transition { module, transition })
    }

    fn remove(&self, module: &str) -> PyResult<()> {
        let module = module.to_owned();
        self.ask("remove()", |_| Asked::Remove { module })
    }

    /// Writes a line into the log of the program, from a place in the source.
    fn log(&self, level: u8, text: &str, file: &str, line: u32, function: &str) {
        macro_rules! write_line {
            ($write:ident) => {
                tracing::$write!(log.file = file, log.line = line, log.module_path = function, "{text}")
            };
        }
        match level {
            ..=10 => write_line!(debug),
            11..=20 => write_line!(info),
            21..=30 => write_line!(warn),
            _ => write_line!(error),
        }
    }
}

/// Publishes the messages of one topic: `publisher(message)`, or `publisher(field=value, ...)`.
#[pyclass(frozen, module = "downbeat")]
pub(crate) struct Publisher {
    link: Py<Link>,
    number: u32,
    topic: String,
    message: Arc<MessageType>,
}

#[pymethods]
impl Publisher {
    #[pyo3(signature = (message=None, /, **fields))]
    fn __call__(
        &self,
        py: Python<'_>,
        message: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<()> {
        let cdr = messages::to_cdr(py, &self.message, message, fields)?;
        let publisher = self.number;
        self.link.get().ask("publishing", |_| Asked::Publish { publisher, cdr })
    }

    fn __repr__(&self) -> String {
        format!("<Publisher of {} on {:?}>", self.message.name, self.topic)
    }
}

/// Calls one service: `client(request, then=function)`, or `client(field=value, ..., then=function)`.
#[pyclass(frozen, module = "downbeat")]
pub(crate) struct Client {
    link: Py<Link>,
    number: u32,
    service: String,
    request: Arc<MessageType>,
}

#[pymethods]
impl Client {
    #[pyo3(signature = (request=None, /, *, then, **fields))]
    fn __call__(
        &self,
        py: Python<'_>,
        request: Option<&Bound<'_, PyAny>>,
        then: Py<PyAny>,
        fields: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<()> {
        let cdr = messages::to_cdr(py, &self.request, request, fields)?;
        let client = self.number;
        self.link.get().ask("a call", |state| {
            // The core counts the calls of each client in the same way.
            let call = state.calls[client as usize];
            state.calls[client as usize] += 1;
            state.callbacks.replies.insert((client, call), then);
            Asked::Call { client, cdr }
        })
    }

    fn __repr__(&self) -> String {
        format!("<Client of {:?}>", self.service)
    }
}

/// A request that is answered later: `request.reply(response)`, `request.reply(field=value, ...)` or
/// `request.refuse(reason)`, once.
#[pyclass(frozen, module = "downbeat")]
pub(crate) struct Request {
    link: Py<Link>,
    number: u64,
    response: Arc<MessageType>,
}

impl Request {
    pub(super) fn new(link: Py<Link>, number: u64, response: Arc<MessageType>) -> Self {
        Self { link, number, response }
    }
}

#[pymethods]
impl Request {
    #[pyo3(signature = (response=None, /, **fields))]
    fn reply(
        &self,
        py: Python<'_>,
        response: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<()> {
        let result = Ok(messages::to_cdr(py, &self.response, response, fields)?);
        let request = self.number;
        self.link.get().ask("reply()", |_| Asked::Reply { request, result })
    }

    fn refuse(&self, reason: String) -> PyResult<()> {
        let request = self.number;
        self.link.get().ask("refuse()", |_| Asked::Reply { request, result: Err(reason) })
    }
}

fn seconds(seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| PyValueError::new_err(format!("{seconds} s is no duration")))
}
