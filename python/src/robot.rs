//! Robots with modules in Python: the command line, robots beside a script, and replays.

use crate::modules::{python_kind, python_kind_of};
use downbeat::App;
use downbeat::executor::SettingValue;
use downbeat::replay as replays;
use downbeat::running::RunningRobot;
use parking_lot::Mutex;
use pyo3::exceptions::{PyAssertionError, PyRuntimeError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Duration;

type Kinds = BTreeMap<String, Py<PyAny>>;

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    run_children_by(module.py())?;
    module.add_class::<Robot>()?;
    module.add_class::<ReplayReport>()?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(start, module)?)?;
    module.add_function(wrap_pyfunction!(replay, module)?)
}

/// The app of the console script `downbeat`, with the classes of a script as further kinds.
fn app(py: Python<'_>, kinds: Kinds) -> App {
    let app = App::with_built_in_kinds().add_kind(python_kind());
    kinds.into_iter().fold(app, |app, (name, class)| app.add_kind(python_kind_of(py, &name, class)))
}

/// Runs the child processes of libraries by the interpreter that runs this package.
fn run_children_by(py: Python<'_>) -> PyResult<()> {
    let interpreter: String = py.import("sys")?.getattr("executable")?.extract()?;
    let command = [interpreter.as_str(), "-m", "downbeat", "library-child"].map(OsString::from);
    downbeat::library_host::set_child_command(command);
    Ok(())
}

#[pyfunction]
fn main(py: Python<'_>, kinds: Kinds, line: Vec<String>) -> u8 {
    let app = app(py, kinds);
    let code = py.detach(|| app.main_with(line.into_iter().map(Into::into)));
    u8::from(code != ExitCode::SUCCESS)
}

#[pyfunction]
fn start(py: Python<'_>, kinds: Kinds, robot: String) -> PyResult<Robot> {
    let app = app(py, kinds);
    let robot = py.detach(|| app.start(robot).map_err(|error| error.to_string()));
    Ok(Robot(Mutex::new(Some(robot.map_err(PyRuntimeError::new_err)?))))
}

#[pyfunction]
fn replay(py: Python<'_>, kinds: Kinds, robot: String, bag: String) -> PyResult<ReplayReport> {
    let app = app(py, kinds);
    let report = py.detach(|| app.replay(robot, bag).map_err(|error| error.to_string()));
    report.map(ReplayReport).map_err(PyRuntimeError::new_err)
}

/// A robot that runs beside a script, until it is stopped.
#[pyclass(frozen, module = "downbeat")]
struct Robot(Mutex<Option<RunningRobot>>);

#[pymethods]
impl Robot {
    /// Stops the robot, and waits until it has stopped.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let robot = self.0.lock().take();
        let stopped = py.detach(|| robot.map_or(Ok(None), RunningRobot::stop));
        stopped.map(drop).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    /// False once the robot has stopped, by itself or by `stop`.
    #[getter]
    fn is_running(&self) -> bool {
        self.0.lock().as_ref().is_some_and(|robot| !robot.is_finished())
    }

    /// Changes a setting of a module. Raises `RuntimeError` if it is refused.
    fn set(&self, py: Python<'_>, module: &str, setting: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value: SettingValue = crate::modules::setting_value(value)?;
        let core = self.0.lock().as_ref().map(|robot| robot.core().clone());
        let core = core.ok_or_else(|| PyRuntimeError::new_err("the robot has stopped"))?;
        let receipt = core.set(module, setting, value);
        match py.detach(|| receipt.wait(Duration::from_secs(10))) {
            Some(Ok(())) => Ok(()),
            Some(Err(refused)) => Err(PyRuntimeError::new_err(refused.to_string())),
            None => Err(PyRuntimeError::new_err("the robot does not answer")),
        }
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, PyAny>) -> PyResult<()> {
        self.stop(py)
    }
}

/// What was replayed, and how it differs from the bag.
#[pyclass(frozen, module = "downbeat")]
struct ReplayReport(replays::ReplayReport);

#[pymethods]
impl ReplayReport {
    /// Raises `AssertionError` with the report unless the replay equals the bag on every topic of the
    /// modules.
    fn assert_same(&self) -> PyResult<()> {
        let checked = self.0.clone().check(replays::Strictness::EveryTopic);
        checked.map_err(|different| PyAssertionError::new_err(different.to_string()))
    }

    /// How many messages differ.
    #[getter]
    fn different(&self) -> u64 {
        self.0.different()
    }

    /// How many messages were compared.
    #[getter]
    fn compared(&self) -> u64 {
        self.0.compared()
    }

    /// The modules whose sources have changed since the bag was recorded.
    #[getter]
    fn changed_sources(&self) -> Vec<String> {
        self.0.changed_sources.clone()
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }
}
