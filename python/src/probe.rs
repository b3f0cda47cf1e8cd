//! Modules under test: a core whose time only the test moves, for `downbeat.test.Robot`.

use crate::messages;
use crate::modules::{python_kind, python_kind_of, setting_value};
use bytes::Bytes;
use downbeat::edge::{CoreAccess, EncodedCallError, RawMessage};
use downbeat::executor::{
    AnyReceived, CallError, Inbox, MessageType, ModuleOptions, OutletInbox, Probe as CoreProbe, ProbeError,
};
use downbeat::robot::{Catalog, Kind, ModuleSource};
use parking_lot::{Mutex, MutexGuard};
use pyo3::exceptions::{PyKeyError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use std::any::TypeId;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Probe>()
}

/// Modules without a robot file.
#[pyclass(frozen, module = "downbeat._core")]
struct Probe(Mutex<State>);

struct State {
    probe: CoreProbe,
    catalog: Catalog,
    heard: BTreeMap<Arc<str>, Heard>,
}

/// The messages of a topic that were not taken yet, with the names of their types.
type Heard = Arc<Mutex<VecDeque<(&'static str, Bytes)>>>;

#[pymethods]
impl Probe {
    #[new]
    fn new() -> PyResult<Self> {
        let mut catalog = Catalog::built_in();
        catalog.add_kind(python_kind()).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        Ok(Self(Mutex::new(State { probe: CoreProbe::new(), catalog, heard: BTreeMap::new() })))
    }

    /// Adds a module: of a class, or of a kind by its name. Of `settings`, those that are keys of the kind
    /// are such.
    fn add(
        &self,
        py: Python<'_>,
        name: String,
        kind: &Bound<'_, PyAny>,
        settings: &Bound<'_, PyDict>,
        remap: BTreeMap<String, String>,
    ) -> PyResult<()> {
        let kind = self.kind(py, &name, kind)?;
        let mut options = ModuleOptions { remaps: remap, ..ModuleOptions::default() };
        let folder = PathBuf::from(".");
        let mut source = ModuleSource::new(name.clone(), folder);
        for (key, value) in settings {
            let (key, value) = (key.extract::<String>()?, setting_value(&value)?);
            let is_key = kind.keys().iter().any(|keys| keys.contains(&key.as_str()));
            let values = if is_key { &mut source.keys } else { &mut options.settings };
            values.insert(key, value);
        }
        self.run(py, |state| {
            let State { probe, catalog, .. } = state;
            let added = kind.add_to(probe.core(), &name, options, &source, &catalog.interfaces);
            added.map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
            state.listen()?;
            state.probe.settle().map_err(failed)
        })
    }

    /// Publishes a message, or one of the type of the topic with these fields.
    #[pyo3(signature = (topic, message, fields))]
    fn inject(
        &self,
        py: Python<'_>,
        topic: &str,
        message: Option<&Bound<'_, PyAny>>,
        fields: &Bound<'_, PyDict>,
    ) -> PyResult<()> {
        let type_name = match message.and_then(|message| messages::type_of_message(message).ok()) {
            Some(of) => of.name.clone(),
            None => self.lock()?.type_on(topic)?.to_owned(),
        };
        let of = messages::message_type(py, &type_name)?;
        let cdr = messages::to_cdr(py, &of, message, Some(fields))?;
        self.run(py, |state| {
            state.require_topic(topic)?;
            let interfaces = &state.catalog.interfaces;
            let known = interfaces.find_message(&type_name);
            let known = known.map_err(|unknown| PyKeyError::new_err(unknown.to_string()))?;
            let inlet = interfaces.inlet(state.probe.core(), topic, known);
            let inlet = inlet.map_err(|error| PyTypeError::new_err(error.to_string()))?;
            inlet.publish(&cdr).map_err(|error| PyValueError::new_err(error.to_string()))?;
            state.probe.settle().map_err(failed)
        })
    }

    /// Lets time pass, in seconds.
    fn advance(&self, py: Python<'_>, time: f64) -> PyResult<()> {
        let time = seconds(time)?;
        self.run(py, |state| state.probe.advance(time).map_err(failed))
    }

    /// Takes the next message of a topic; `None` if there is none after `within`, in seconds.
    fn next(&self, py: Python<'_>, topic: &str, within: f64) -> PyResult<Option<Py<PyAny>>> {
        let within = seconds(within)?;
        let found = self.run(py, |state| {
            let heard = state.heard_on(topic)?;
            state.probe.wait(within, || heard.lock().pop_front()).map_err(failed)
        })?;
        found.map(|found| decoded(py, found)).transpose()
    }

    /// Takes all messages of a topic.
    fn heard(&self, py: Python<'_>, topic: &str) -> PyResult<Vec<Py<PyAny>>> {
        let heard = std::mem::take(&mut *self.lock()?.heard_on(topic)?.lock());
        heard.into_iter().map(|found| decoded(py, found)).collect()
    }

    /// How many messages of each topic wait to be taken.
    fn waiting(&self) -> PyResult<BTreeMap<String, usize>> {
        let state = self.lock()?;
        let waiting = state.heard.iter().map(|(topic, heard)| (topic.to_string(), heard.lock().len()));
        Ok(waiting.filter(|(_, count)| *count > 0).collect())
    }

    /// Calls a service and returns the response, or `None` and the reason why there is none.
    #[pyo3(signature = (service, request, fields))]
    fn call(
        &self,
        py: Python<'_>,
        service: &str,
        request: Option<&Bound<'_, PyAny>>,
        fields: &Bound<'_, PyDict>,
    ) -> PyResult<(Option<Py<PyAny>>, String)> {
        let known = {
            let mut state = self.lock()?;
            let State { probe, catalog, .. } = &mut *state;
            catalog.interfaces.service_in(probe.core(), service).ok_or_else(|| {
                let names: Vec<_> = probe.core().services().map(|info| info.name.to_string()).collect();
                PyKeyError::new_err(format!(
                    "no module serves {service:?}; there are the services [{}]",
                    names.join(", ")
                ))
            })?
        };
        let request_type = messages::message_type(py, &format!("{}_Request", known.name()))?;
        let cdr = messages::to_cdr(py, &request_type, request, Some(fields))?;
        let answer = self.run(py, |state| {
            let caller = known.caller(state.probe.core(), service);
            let caller = caller.map_err(|error| PyTypeError::new_err(error.to_string()))?;
            let (sender, answer) = channel();
            caller.call(&cdr, CoreProbe::PATIENCE, move |result| drop(sender.send(result)));
            state.probe.wait(CoreProbe::PATIENCE, || answer.try_recv().ok()).map_err(failed)
        })?;
        match answer {
            Some(Ok(answer)) => {
                let response = messages::message_type(py, &format!("{}_Response", known.name()))?;
                let response = messages::from_cdr(py, &response, answer.into_cdr().into())?;
                Ok((Some(response), String::new()))
            }
            Some(Err(EncodedCallError::Call(CallError::Refused { reason, .. }))) => Ok((None, reason)),
            Some(Err(other)) => Ok((None, other.to_string())),
            None => Ok((None, format!("no response within {} s", CoreProbe::PATIENCE.as_secs()))),
        }
    }

    /// Changes a setting of a module.
    fn set(&self, py: Python<'_>, module: &str, setting: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value = setting_value(value)?;
        self.run(py, |state| {
            let changed = state.probe.set(module, setting, value);
            changed.map_err(|error| match error {
                ProbeError::Setting(refused) => PyValueError::new_err(refused.to_string()),
                other => failed(other),
            })
        })
    }

    /// The time in nanoseconds.
    #[getter]
    fn now(&self) -> PyResult<i64> {
        Ok(self.lock()?.probe.now().as_nanos())
    }
}

impl Probe {
    fn kind(&self, py: Python<'_>, name: &str, kind: &Bound<'_, PyAny>) -> PyResult<Kind> {
        if kind.is_instance_of::<PyType>() {
            return Ok(python_kind_of(py, name, kind.clone().unbind()));
        }
        let wanted = kind.extract::<String>().map_err(|_| {
            PyTypeError::new_err(
                "a module is given as its class, or as the name of a kind, such as \"diff_drive\"",
            )
        })?;
        self.lock()?.catalog.kind(&wanted).cloned().ok_or_else(|| {
            PyKeyError::new_err(format!("there is no kind {wanted:?}: `downbeat check --kinds` lists them"))
        })
    }

    fn lock(&self) -> PyResult<MutexGuard<'_, State>> {
        self.0.try_lock().ok_or_else(|| {
            PyRuntimeError::new_err("a robot under test is used by one thread, and not by its own modules")
        })
    }

    /// Runs the core without the interpreter, which its modules need.
    fn run<T: Send>(
        &self,
        py: Python<'_>,
        run: impl FnOnce(&mut State) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| run(&mut *self.lock()?))
    }
}

impl State {
    /// Collects the messages of topics that are new.
    fn listen(&mut self) -> PyResult<()> {
        let core = self.probe.core();
        let topics: Vec<_> =
            core.topics().map(|info| (Arc::clone(&info.name), info.message_type_id)).collect();
        for (topic, type_id) in topics {
            let known = self.catalog.interfaces.message_of(type_id);
            if self.heard.contains_key(&topic) || (known.is_none() && type_id != TypeId::of::<RawMessage>()) {
                continue;
            }
            let heard = Heard::default();
            let collected = Arc::clone(&heard);
            let outlet = match known {
                Some(known) => {
                    let collect = move |_, cdr| collected.lock().push_back((known.name(), cdr));
                    let inbox = OutletInbox::from(Inbox::KeepAll);
                    known.outlet(&mut CoreAccess::Idle(core), &topic, &inbox, collect)
                }
                None => {
                    let collect = move |AnyReceived { message, .. }: AnyReceived<'_>| {
                        if let Some(raw) = message.downcast_ref::<RawMessage>() {
                            collected.lock().push_back((raw.message_type().name(), raw.cdr().clone()));
                        }
                    };
                    core.outlet_of(MessageType::of::<RawMessage>(), &topic, Inbox::KeepAll, collect)
                }
            };
            outlet.map_err(|error| PyRuntimeError::new_err(error.to_string()))?.keep();
            self.heard.insert(topic, heard);
        }
        Ok(())
    }

    fn require_topic(&mut self, topic: &str) -> PyResult<()> {
        self.heard_on(topic).map(drop)
    }

    fn heard_on(&self, topic: &str) -> PyResult<Heard> {
        self.heard.get(topic.trim_start_matches('/')).cloned().ok_or_else(|| {
            let known: Vec<_> = self.heard.keys().map(|known| &**known).collect();
            PyKeyError::new_err(format!(
                "no module publishes or receives {topic:?}; there are the topics [{}]",
                known.join(", ")
            ))
        })
    }

    /// The name of the type of a topic.
    fn type_on(&mut self, topic: &str) -> PyResult<&'static str> {
        self.require_topic(topic)?;
        let name = topic.trim_start_matches('/');
        let found = self.probe.core().topics().find(|info| *info.name == *name);
        let known = found.and_then(|info| self.catalog.interfaces.message_in(info));
        let known = known.ok_or_else(|| {
            PyTypeError::new_err(format!(
                "the type of {topic:?} is not built in: pass a message of its class"
            ))
        })?;
        Ok(known.name())
    }
}

fn decoded(py: Python<'_>, (type_name, cdr): (&str, Bytes)) -> PyResult<Py<PyAny>> {
    messages::from_cdr(py, &messages::message_type(py, type_name)?, cdr)
}

/// A module that failed fails the test, with its traceback.
fn failed(error: ProbeError) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

fn seconds(seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| PyValueError::new_err(format!("{seconds} s is no duration")))
}
