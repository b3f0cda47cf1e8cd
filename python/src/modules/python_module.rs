//! An instance of a user's class as a module of a core.

use super::link::{Link, Request};
use super::values;
use super::watch::Watch;
use crate::messages;
use downbeat::edge::foreign::{Declarations, Event, Foreign, ForeignContext, SavedState};
use downbeat::executor::{Failure, SettingValue, Transition};
use downbeat::robot::ModuleSource;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::fmt;
use std::sync::Arc;

/// Loads the next version of a module, if there is one.
pub(super) type Successor = Box<dyn Fn() -> Result<Option<Box<dyn Foreign>>, String> + Send + Sync>;

/// A module in Python.
pub(super) struct PythonModule {
    instance: Py<PyAny>,
    link: Py<Link>,
    /// `None` for a module that is not loaded again when its file is saved.
    successor: Option<Successor>,
    watch: Watch,
}

impl PythonModule {
    /// An instance of a loaded class.
    pub(super) fn new(
        class: &Bound<'_, PyAny>,
        source: &ModuleSource,
        successor: Option<Successor>,
    ) -> PyResult<Self> {
        let instance = class.call0()?;
        let link = instance.getattr("_link")?.extract()?;
        let watch = Watch::new(&source.module, source.deadline);
        Ok(Self { instance: instance.unbind(), link, successor, watch })
    }

    /// Calls Python.
    fn attached<T>(&self, call: impl FnOnce(&Self, Python<'_>) -> PyResult<T>) -> Result<T, Failure> {
        Python::attach(|py| {
            let _watched = self.watch.begin(py);
            let process = std::process::id();
            let result = call(self, py);
            if std::process::id() != process {
                end_forked(py);
            }
            result.map_err(|error| Failure {
                reason: sentence(py, &error),
                report: Some(traceback(py, &error)),
            })
        })
    }

    /// Calls Python, and then, detached, asks the core for what the callback has asked for.
    fn running(
        &self,
        context: &mut ForeignContext<'_, '_>,
        call: impl FnOnce(&Self, Python<'_>) -> PyResult<()>,
    ) -> Result<(), Failure> {
        self.link.get().running(context, || self.attached(call))
    }

    fn call(&self, py: Python<'_>, event: Event) -> PyResult<()> {
        let link = self.link.get();
        match event {
            Event::Message { subscription, cdr, .. } => {
                let found = link.callbacks(|callbacks| {
                    let found = callbacks.subscriptions.get(subscription as usize);
                    found.map(|(message, callback)| (Arc::clone(message), callback.clone_ref(py)))
                });
                let Some((message, callback)) = found else { return Ok(()) };
                callback.call1(py, (messages::from_cdr(py, &message, cdr)?,))?;
            }
            Event::Request { server, request, cdr } => {
                let found = link.callbacks(|callbacks| {
                    let found = callbacks.servers.get(server as usize);
                    found.map(|server| {
                        (
                            Arc::clone(&server.request),
                            Arc::clone(&server.response),
                            server.callback.clone_ref(py),
                        )
                    })
                });
                let Some((request_type, response, callback)) = found else { return Ok(()) };
                let open = Request::new(self.link.clone_ref(py), request, response);
                callback.call1(py, (messages::from_cdr(py, &request_type, cdr)?, open))?;
            }
            Event::Reply { client, call, result } => {
                let found = link.callbacks(|callbacks| {
                    let then = callbacks.replies.remove(&(client, call))?;
                    Some((then, Arc::clone(callbacks.clients.get(client as usize)?)))
                });
                let Some((then, response)) = found else { return Ok(()) };
                match result {
                    Ok(cdr) => then.call1(py, (messages::from_cdr(py, &response, cdr)?, py.None()))?,
                    Err(reason) => then.call1(py, (py.None(), reason))?,
                };
            }
            Event::Setting { setting } => {
                let changed = link.callbacks(|callbacks| {
                    let of_setting =
                        callbacks.on_change.iter().filter(|(number, _)| *number == setting as usize);
                    of_setting.map(|(_, callback)| callback.clone_ref(py)).collect::<Vec<_>>()
                });
                changed.iter().try_for_each(|callback| callback.call0(py).map(drop))?;
            }
            Event::Timer { timer } => {
                let callback =
                    link.callbacks(|all| all.timers.get(timer as usize).map(|found| found.clone_ref(py)));
                callback.map(|callback| callback.call0(py)).transpose()?;
            }
            Event::Task { task } => {
                let callback =
                    link.callbacks(|all| all.tasks.get(task as usize).map(|found| found.clone_ref(py)));
                callback.map(|callback| callback.call0(py)).transpose()?;
            }
            Event::EachRun => {
                let all = link.callbacks(|all| {
                    all.each_run.iter().map(|found| found.clone_ref(py)).collect::<Vec<_>>()
                });
                all.iter().try_for_each(|callback| callback.call0(py).map(drop))?;
            }
        }
        Ok(())
    }
}

/// Ends a process that a callback forked and that came back from it: it has the sockets, ports and bags of
/// the robot, but of its threads only this one, and must not run as a second robot.
fn end_forked(py: Python<'_>) -> ! {
    const TEXT: &[u8] =
        b"downbeat: a callback returned in a process that it had forked, which ends here: leave such a process with os._exit, or use subprocess\n";
    // Without locks, which threads that do not exist here may hold, and without handlers that are run at an
    // exit.
    let end = py.import("os").and_then(|os| {
        os.call_method1("write", (2, TEXT))?;
        os.call_method1("_exit", (1,))
    });
    drop(end);
    std::process::abort()
}

/// The longest text of a field for a debugger, in characters.
const LONGEST_FIELD: usize = 2000;

/// Its fields, apart from those whose names begin with `_`.
impl fmt::Debug for PythonModule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fields = Python::attach(|py| -> PyResult<(String, Vec<(String, String)>)> {
            let instance = self.instance.bind(py);
            let name = instance.get_type().name()?.to_string();
            let fields = instance.getattr("__dict__")?.cast_into::<PyDict>().map_err(PyErr::from)?;
            let mut texts = Vec::new();
            for (field, value) in fields {
                let field: String = field.extract()?;
                if !field.starts_with('_') {
                    let text = value.repr()?.to_string().chars().take(LONGEST_FIELD).collect();
                    texts.push((field, text));
                }
            }
            Ok((name, texts))
        });
        match fields {
            Ok((name, fields)) => {
                let mut shown = f.debug_struct(&name);
                for (field, text) in &fields {
                    shown.field(field, &format_args!("{text}"));
                }
                shown.finish()
            }
            Err(error) => write!(f, "its fields cannot be shown: {error}"),
        }
    }
}

impl Foreign for PythonModule {
    fn debug(&self) -> Option<&dyn fmt::Debug> {
        Some(self)
    }

    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        if self.successor.is_some() {
            declarations.reload();
        }
        self.attached(|module, py| {
            module
                .link
                .get()
                .declaring(declarations, || module.instance.call_method0(py, "_set_up").map(drop))
        })
        .map_err(Failure::into_report)
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        if let Event::Setting { setting } = event {
            self.link.get().refresh(setting, context);
        }
        self.running(context, |module, py| module.call(py, event))
    }

    fn transition(
        &mut self,
        transition: Transition,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        let method = match transition {
            Transition::Configure => "configure",
            Transition::Activate => "activate",
            Transition::Deactivate => "deactivate",
            Transition::Cleanup => "cleanup",
            Transition::Shutdown => "shutdown",
        };
        self.running(context, |module, py| module.instance.call_method0(py, method).map(drop))
            .map_err(Failure::into_report)
    }

    fn accept(&mut self, setting: u32, value: &SettingValue) -> Result<(), String> {
        let name = self.link.get().setting_name(setting);
        Python::attach(|py| {
            let accepted = values::to_python(py, value)
                .and_then(|value| self.instance.call_method1(py, "accept", (name, value)));
            // In one line: whoever sets the parameter reads it.
            accepted.map(drop).map_err(|error| error.value(py).to_string())
        })
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        self.successor.as_ref().map_or(Ok(None), |successor| successor())
    }

    fn save(&mut self) -> Result<SavedState, String> {
        let state = self.attached(|module, py| module.instance.call_method0(py, "save"));
        Ok(Box::new(state.map_err(Failure::into_report)?))
    }

    fn restore(&mut self, state: SavedState) -> Result<(), String> {
        let Ok(state) = state.downcast::<Py<PyAny>>() else { return Ok(()) };
        self.attached(|module, py| match state.is_none(py) {
            true => Ok(()),
            false => module.instance.call_method1(py, "restore", (&*state,)).map(drop),
        })
        .map_err(Failure::into_report)
    }
}

/// The last lines of that: the exception without the calls that led to it.
fn sentence(py: Python<'_>, error: &PyErr) -> String {
    let format = || -> PyResult<String> {
        let parts = (error.get_type(py), error.value(py));
        let lines = py.import("traceback")?.call_method1("format_exception_only", parts)?;
        Ok(lines.extract::<Vec<String>>()?.concat().trim_end().to_owned())
    };
    format().unwrap_or_else(|_| error.to_string())
}

/// An exception as Python prints it.
pub(super) fn traceback(py: Python<'_>, error: &PyErr) -> String {
    let format = || -> PyResult<String> {
        let parts = (error.get_type(py), error.value(py), error.traceback(py));
        let lines = py.import("traceback")?.call_method1("format_exception", parts)?;
        Ok(lines.extract::<Vec<String>>()?.concat().trim_end().to_owned())
    };
    format().unwrap_or_else(|_| error.to_string())
}
