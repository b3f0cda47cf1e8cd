//! Bags and their messages.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use downbeat::encoding::RecordedType;
use downbeat_bags::{BagMessage, Reader, ReaderError, RecordedTopic, Selection, TopicId};
use downbeat_edge::Interfaces;
use downbeat_msgs::definitions::nearest;
use parking_lot::Mutex;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyString, PyTuple, PyType};

use super::errors::exception;
use super::table::{self, Table};
use crate::messages::{MessageType, class_of, described_type, from_cdr, message_type};

/// A bag: a directory of rosbag2, or one of its files.
#[pyclass(frozen, subclass, module = "downbeat._core")]
pub(super) struct Bag {
    reader: Arc<Reader>,
    topics: Vec<Py<Topic>>,
}

/// A topic of a bag.
#[pyclass(frozen, module = "downbeat._core")]
pub(super) struct Topic {
    recorded: RecordedTopic,
    origin: String,
    name: Py<PyString>,
    reading: PyOnceLock<Reading>,
}

/// How the messages of a topic are read.
struct Reading {
    of: Arc<MessageType>,
    /// Converts messages that are not CDR.
    recorded: Option<RecordedType>,
}

#[pymethods]
impl Bag {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let reader = py.detach(|| Reader::open(path)).map_err(exception)?;
        let origin = reader.path().display().to_string();
        let topics = reader.topics().iter().map(|recorded| {
            let name = PyString::intern(py, &recorded.info.name).unbind();
            let (recorded, origin) = (recorded.clone(), origin.clone());
            Py::new(py, Topic { recorded, origin, name, reading: PyOnceLock::new() })
        });
        Ok(Self { topics: topics.collect::<PyResult<_>>()?, reader: Arc::new(reader) })
    }

    #[getter]
    fn path(&self) -> PathBuf {
        self.reader.path().to_owned()
    }

    #[getter]
    fn topics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let topics = PyDict::new(py);
        for topic in &self.topics {
            topics.set_item(&topic.get().name, topic)?;
        }
        Ok(topics)
    }

    #[getter]
    fn message_count(&self) -> u64 {
        self.reader.message_count()
    }

    #[getter]
    fn start_time(&self) -> Option<i64> {
        self.reader.start_time()
    }

    #[getter]
    fn end_time(&self) -> Option<i64> {
        self.reader.end_time()
    }

    #[getter]
    fn duration(&self) -> u64 {
        u64::try_from(self.reader.duration().as_nanos()).unwrap_or(u64::MAX)
    }

    /// What is missing because recording was interrupted or a file was damaged.
    #[getter]
    fn missing(&self) -> Vec<String> {
        self.reader.truncation().map(ToString::to_string).collect()
    }

    fn __len__(&self) -> usize {
        usize::try_from(self.reader.message_count()).unwrap_or(usize::MAX)
    }

    fn __bool__(&self) -> bool {
        true
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<Messages> {
        self.messages(py, None, None, None)
    }

    #[pyo3(signature = (topics = None, start = None, end = None))]
    fn messages(
        &self,
        py: Python<'_>,
        topics: Option<Vec<String>>,
        start: Option<i64>,
        end: Option<i64>,
    ) -> PyResult<Messages> {
        let mut selection = Selection::all().from(start.unwrap_or(i64::MIN)).until(end.unwrap_or(i64::MAX));
        if let Some(topics) = topics {
            let chosen = topics.iter().map(|topic| self.find(topic));
            selection = selection.topics(chosen.collect::<PyResult<Vec<_>>>()?);
        }
        let messages = py.detach(|| self.reader.messages(selection)).map_err(exception)?;
        Ok(Messages {
            topics: self.topics.iter().map(|topic| topic.clone_ref(py)).collect(),
            messages: Mutex::new(messages),
            ready: VecDeque::new(),
            failed: None,
        })
    }

    /// The columns of a topic: see `Table` in Python.
    #[pyo3(signature = (topic, start = None, end = None))]
    fn columns<'py>(
        &self,
        py: Python<'py>,
        topic: &str,
        start: Option<i64>,
        end: Option<i64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let id = self.find(topic)?;
        let selection =
            Selection::all().topics([id]).from(start.unwrap_or(i64::MIN)).until(end.unwrap_or(i64::MAX));
        let read = py.detach(|| Table::read(&self.reader, &self.reader.topics()[id.index()], &selection));
        table::to_python(py, read?)
    }

    fn __repr__(&self) -> String {
        format!(
            "Bag({:?}, {} topics, {} messages)",
            self.reader.path(),
            self.topics.len(),
            self.reader.message_count()
        )
    }
}

impl Bag {
    /// Finds a topic by its name, with or without the first slash.
    fn find(&self, name: &str) -> PyResult<TopicId> {
        let found = self.reader.topic(name).or_else(|| self.reader.topic(&format!("/{name}")));
        found.ok_or_else(|| {
            let names = || self.reader.topics().iter().map(|topic| topic.info.name.as_str());
            let hint = match nearest(name, names()) {
                Some(near) => format!("did you mean {near}?"),
                None => format!("it has {}", names().collect::<Vec<_>>().join(", ")),
            };
            PyKeyError::new_err(format!("{} has no topic {name}: {hint}", self.reader.path().display()))
        })
    }
}

#[pymethods]
impl Topic {
    #[getter]
    fn name(&self) -> &str {
        &self.recorded.info.name
    }

    #[getter]
    fn type_name(&self) -> &str {
        &self.recorded.info.type_name
    }

    #[getter]
    fn type_hash(&self) -> &str {
        &self.recorded.info.type_hash
    }

    #[getter]
    fn definition(&self) -> &str {
        &self.recorded.info.definition
    }

    #[getter]
    fn message_count(&self) -> u64 {
        self.recorded.message_count
    }

    #[getter]
    fn message_class(&self, py: Python<'_>) -> PyResult<Py<PyType>> {
        class_of(py, &self.reading(py)?.of)
    }

    fn __repr__(&self) -> String {
        let RecordedTopic { info, message_count, .. } = &self.recorded;
        format!("Topic({:?}, {:?}, {message_count} messages)", info.name, info.type_name)
    }
}

impl Topic {
    fn reading(&self, py: Python<'_>) -> PyResult<&Reading> {
        self.reading.get_or_try_init(py, || {
            let info = &self.recorded.info;
            let schema = info.format.as_ref().filter(|_| info.definition.is_empty());
            if !info.is_cdr() {
                let recorded = RecordedType::of(&self.recorded, &Interfaces::carried())
                    .map_err(|error| PyValueError::new_err(error.to_string()))?;
                let of = message_type(py, recorded.message_type().name())?;
                return Ok(Reading { of, recorded: Some(recorded) });
            }
            let (encoding, text) = match schema {
                Some(format) => (
                    format.schema.encoding.as_str(),
                    String::from_utf8_lossy(&format.schema.data).into_owned(),
                ),
                None => ("ros2msg", info.definition.clone()),
            };
            let of = if text.is_empty() && info.type_hash.is_empty() {
                message_type(py, &info.type_name)?
            } else {
                described_type(py, &info.type_name, encoding, &text, &self.origin)?
            };
            Ok(Reading { of, recorded: None })
        })
    }
}

/// Iterates over the messages of a bag.
#[pyclass(module = "downbeat._core", name = "BagIterator")]
pub(super) struct Messages {
    topics: Vec<Py<Topic>>,
    /// Only locked by its owner: it cannot be shared between threads otherwise.
    messages: Mutex<downbeat_bags::Messages>,
    ready: VecDeque<BagMessage>,
    /// Follows those that are ready.
    failed: Option<ReaderError>,
}

/// How much is read ahead while Python code can run in other threads.
const MOST_READY: usize = 256;
const MOST_READY_BYTES: usize = 1 << 20;

#[pymethods]
impl Messages {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        if self.ready.is_empty() && self.failed.is_none() {
            py.detach(|| self.read_ahead());
        }
        let Some(BagMessage { topic, log_time, data, .. }) = self.ready.pop_front() else {
            return self.failed.take().map_or(Ok(None), |error| Err(exception(error)));
        };
        let topic = self.topics[topic.index()].get();
        let reading = topic.reading(py)?;
        let data = match &reading.recorded {
            Some(recorded) => {
                recorded.to_cdr(data).map_err(|error| PyValueError::new_err(error.to_string()))?
            }
            None => data,
        };
        let message = from_cdr(py, &reading.of, data)?;
        let time = log_time.into_pyobject(py)?.into_any();
        let items = [topic.name.bind(py).clone().into_any(), message.into_bound(py), time];
        record(py, PyTuple::new(py, items)?).map(Some)
    }
}

impl Messages {
    fn read_ahead(&mut self) {
        let mut bytes = 0;
        while self.ready.len() < MOST_READY && bytes < MOST_READY_BYTES {
            match self.messages.get_mut().next() {
                Some(Ok(message)) => {
                    bytes += message.data.len();
                    self.ready.push_back(message);
                }
                Some(Err(error)) => {
                    self.failed = Some(error);
                    return;
                }
                None => return,
            }
        }
    }
}

/// A tuple with names: `BagMessage` in Python.
fn record<'py>(py: Python<'py>, items: Bound<'py, PyTuple>) -> PyResult<Bound<'py, PyAny>> {
    static NEW: PyOnceLock<(Py<PyAny>, Py<PyAny>)> = PyOnceLock::new();
    let (new, class) = NEW.get_or_try_init(py, || {
        let class = py.import("downbeat._bags")?.getattr("BagMessage")?;
        PyResult::Ok((py.get_type::<PyTuple>().getattr("__new__")?.unbind(), class.unbind()))
    })?;
    new.bind(py).call1((class, items))
}
