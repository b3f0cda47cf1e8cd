//! Writing bags.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use downbeat_bags::{Compression, TopicDescription, TopicId, WriterError, WriterOptions};
use downbeat_msgs::definitions::suggestion;
use downbeat_msgs::qos::QosProfile;
use parking_lot::Mutex;
use pyo3::exceptions::{PyFileExistsError, PyOSError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyType;

use crate::messages::{MessageType, message_type, ros_name, to_cdr, type_of, type_of_message};

/// Writes a bag, a directory of rosbag2 with MCAP files.
#[pyclass(frozen, module = "downbeat._core")]
pub(super) struct Writer {
    path: PathBuf,
    state: Mutex<State>,
}

struct State {
    /// `None` after it was closed.
    writer: Option<downbeat_bags::Writer>,
    topics: HashMap<String, (TopicId, Arc<MessageType>)>,
}

#[pymethods]
impl Writer {
    #[new]
    #[pyo3(signature = (path, *, compression = "none", custom_data = None))]
    fn new(path: PathBuf, compression: &str, custom_data: Option<HashMap<String, String>>) -> PyResult<Self> {
        let Some((_, compression)) = Compression::ALL.into_iter().find(|(name, _)| *name == compression)
        else {
            let hint = suggestion(compression, Compression::ALL.map(|(name, _)| name));
            return Err(PyValueError::new_err(format!("there is no compression {compression:?}{hint}")));
        };
        let options = custom_data
            .into_iter()
            .flatten()
            .fold(WriterOptions::new().compression(compression), |options, (key, value)| {
                options.custom_data(key, value)
            });
        let writer = options.create(&path).map_err(exception)?;
        Ok(Self { path, state: Mutex::new(State { writer: Some(writer), topics: HashMap::new() }) })
    }

    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    fn add_topic(&self, py: Python<'_>, topic: &str, message_class: &Bound<'_, PyType>) -> PyResult<()> {
        let of = type_of(message_class).or_else(|_| message_type(py, &ros_name(message_class)?))?;
        self.topic(topic, &of).map(drop)
    }

    #[pyo3(signature = (topic, message, time = None, *, publish_time = None))]
    fn write(
        &self,
        py: Python<'_>,
        topic: &str,
        message: &Bound<'_, PyAny>,
        time: Option<i64>,
        publish_time: Option<i64>,
    ) -> PyResult<()> {
        let of = type_of_message(message)?;
        let topic_id = self.topic(topic, &of)?;
        let bytes = to_cdr(py, &of, Some(message), None)?;
        let time = match time {
            Some(time) => time,
            None => py.import("time")?.call_method0("time_ns")?.extract()?,
        };
        py.detach(|| {
            let mut state = self.state.lock();
            let writer = state.writer.as_mut().ok_or_else(|| self.closed())?;
            writer.write(topic_id, time, publish_time.unwrap_or(time), &bytes).map_err(exception)
        })
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| match self.state.lock().writer.take() {
            Some(writer) => writer.finish().map(drop).map_err(exception),
            None => Ok(()),
        })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, PyAny>) -> PyResult<()> {
        self.close(py)
    }
}

impl Writer {
    /// Adds the topic if it is new.
    fn topic(&self, topic: &str, of: &Arc<MessageType>) -> PyResult<TopicId> {
        let mut state = self.state.lock();
        let state = &mut *state;
        if let Some((id, known)) = state.topics.get(topic) {
            if Arc::ptr_eq(known, of) {
                return Ok(*id);
            }
            return Err(PyTypeError::new_err(format!(
                "{}: topic {topic} has the type {}, got a message of {}",
                self.path.display(),
                known.name,
                of.name
            )));
        }
        let name = if topic.starts_with('/') { topic.to_owned() } else { format!("/{topic}") };
        let info = TopicDescription {
            name,
            type_name: of.name.clone(),
            definition: of.definition.clone(),
            type_hash: of.hash.clone(),
            offered_qos: vec![QosProfile::DEFAULT.into()],
            format: None,
        };
        let writer = state.writer.as_mut().ok_or_else(|| self.closed())?;
        let id = writer.add_topic(info).map_err(exception)?;
        state.topics.insert(topic.to_owned(), (id, Arc::clone(of)));
        Ok(id)
    }

    fn closed(&self) -> PyErr {
        PyValueError::new_err(format!("the bag {} is closed", self.path.display()))
    }
}

fn exception(error: WriterError) -> PyErr {
    let text = error.to_string();
    match error {
        WriterError::AlreadyExists { .. } => PyFileExistsError::new_err(text),
        WriterError::Create { .. } | WriterError::Write { .. } => PyOSError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}
