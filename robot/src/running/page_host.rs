//! What the page asks of a robot beside its core: recordings, the log, the measured chains, and files of
//! modules that it has edited.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use downbeat_bags::{Recording, RecordingControl, RecordingSender};
use downbeat_bridge::expose::Exposure;
use downbeat_edge::CoreAccess;
use downbeat_executor::{CoreHandle, TopicInfo};
use downbeat_msgs::user_file;
use downbeat_view::{Ask, Host};
use parking_lot::Mutex;
use serde_json::{Value, json};

use super::LogTail;
use super::recording::{Recordable, Taking};
use crate::Latencies;
use crate::recorder::RecorderError;

/// How long a disk may take to write a snapshot.
const PATIENCE: Duration = Duration::from_secs(30);

/// Answers questions of the page about a robot.
pub(super) struct PageHost {
    core: CoreHandle,
    /// What can be recorded, or why nothing can.
    recordable: Result<Recordable, String>,
    log: Option<LogTail>,
    latencies: Latencies,
    /// The recording that began with the robot.
    first: Option<(RecordingSender, RecordingControl)>,
    /// The recording that the page began.
    own: Mutex<Option<OwnRecording>>,
    files: ModuleFiles,
}

/// The files that settings name, by module and setting.
pub(super) type ModuleFiles = HashMap<(String, String), PathBuf>;

/// The largest file that the page writes, in bytes.
const LARGEST_FILE: usize = 1 << 20;

struct OwnRecording {
    recording: Recording,
    taking: Taking,
}

impl PageHost {
    pub(super) fn new(
        core: CoreHandle,
        recordable: Result<Recordable, String>,
        log: Option<LogTail>,
        latencies: Latencies,
        first: Option<&Recording>,
        files: ModuleFiles,
    ) -> Self {
        let first = first.map(|recording| (recording.sender(), recording.control()));
        Self { core, recordable, log, latencies, first, own: Mutex::default(), files }
    }

    /// Takes in topics that modules bring while the robot runs.
    pub(super) fn extend(&self, topics: &[TopicInfo], exposed: &[Exposure]) -> Result<(), RecorderError> {
        let Ok(recordable) = &self.recordable else { return Ok(()) };
        recordable.extend(topics, exposed);
        match &mut *self.own.lock() {
            Some(own) => recordable.record_more(&mut CoreAccess::Running(&self.core), &mut own.taking),
            None => Ok(()),
        }
    }

    /// Finishes the recording that the page began.
    pub(super) fn finish(&self) {
        if let Some(OwnRecording { recording, .. }) = self.own.lock().take()
            && let Err(error) = recording.finish()
        {
            tracing::error!("the recording that the page began is not complete: {error}");
        }
    }

    /// The recording that runs, or else the last one.
    fn current(&self) -> Option<(RecordingSender, RecordingControl)> {
        let own = self.own.lock();
        let own = own.as_ref().map(|own| (own.recording.sender(), own.recording.control()));
        own.or_else(|| self.first.clone())
    }

    fn running(&self) -> Result<(RecordingSender, RecordingControl), String> {
        self.current()
            .filter(|(_, control)| !control.is_stopped())
            .ok_or_else(|| "nothing is being recorded".to_owned())
    }

    fn status(&self) -> Value {
        let Some((sender, control)) = self.current() else { return Value::Null };
        let statistics = sender.statistics();
        json!({
            "path": statistics.summary.path,
            "messages": statistics.summary.message_count(),
            "bytes": statistics.summary.bytes,
            "lost": statistics.summary.lost_count(),
            "is_recording": !control.is_stopped(),
            "is_paused": statistics.is_paused,
            "takes_snapshots": self.takes_snapshots(),
            "failure": statistics.failure,
        })
    }

    fn takes_snapshots(&self) -> bool {
        self.recordable.as_ref().is_ok_and(|recordable| recordable.options.recording.takes_snapshots())
    }

    /// Begins a recording in the working directory.
    fn record(&self, name: Option<&str>) -> Result<Value, String> {
        let recordable = self.recordable.as_ref().map_err(Clone::clone)?;
        let directory = match name.map(str::trim).filter(|name| !name.is_empty()) {
            Some(name) => named(name)?,
            None => unnamed(),
        };
        let mut own = self.own.lock();
        let first = self.first.as_ref().filter(|(_, control)| !control.is_stopped());
        if first.is_some() || own.as_ref().is_some_and(|own| !own.recording.control().is_stopped()) {
            return Err("the robot is being recorded already".to_owned());
        }
        let options = recordable.options.clone();
        let begin = || -> Result<OwnRecording, Box<dyn std::error::Error>> {
            let mut core = CoreAccess::Running(&self.core);
            let (writer, bag) = recordable.create(&core, &directory, options.writer(true))?;
            let recording = Recording::start_with(writer, &options.recording(true))?;
            let taking = recordable.record(&mut core, &recording, options.encoding, bag)?;
            Ok(OwnRecording { recording, taking })
        };
        *own = Some(begin().map_err(|error| error.to_string())?);
        Ok(json!(directory))
    }

    fn stop(&self) -> Result<Value, String> {
        let (_, control) = self.running()?;
        control.stop();
        if let Some(OwnRecording { recording, .. }) = self.own.lock().take() {
            let summary = recording.finish().map_err(|error| error.to_string())?;
            tracing::info!("recorded {} messages in {}", summary.message_count(), summary.path.display());
            return Ok(json!({ "path": summary.path, "messages": summary.message_count() }));
        }
        Ok(Value::Null)
    }

    fn snapshot(&self) -> Result<Value, String> {
        let (sender, receiver) = mpsc::channel();
        self.running()?.1.snapshot(move |result| {
            let _ = sender.send(result);
        });
        let written = receiver.recv_timeout(PATIENCE).map_err(|_| "the disk is too slow".to_owned())?;
        written.map(|()| Value::Null).map_err(|error| error.to_string())
    }

    /// Writes a file that a setting of a module names. The module keeps what it has read of the old one.
    fn save_file(&self, ask: Ask<'_>) -> Result<Value, String> {
        let [module, setting, text] = ["module", "setting", "text"].map(|name| ask.require_text(name));
        let (module, setting, text) = (module?, setting?, text?);
        let path = self.files.get(&(module.to_owned(), setting.to_owned())).ok_or_else(|| {
            format!("the robot file gives \"{module}\" no {setting}: without one there is nothing to save to")
        })?;
        if text.len() > LARGEST_FILE {
            return Err(format!("it has {} bytes; at most {LARGEST_FILE} are saved", text.len()));
        }
        if !path.is_file() {
            return Err(format!(
                "{} is inside the program: `downbeat robots copy` makes files of a carried robot",
                path.display()
            ));
        }
        user_file::replace(path, text)
            .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        tracing::info!("the page has saved {}", path.display());
        Ok(json!({ "path": path }))
    }

    fn log(&self, ask: Ask<'_>) -> Result<Value, String> {
        let log = self.log.as_ref().ok_or("this program does not keep its log for the page")?;
        let after = ask.arguments.get("after").and_then(Value::as_u64);
        let (lines, dropped) = log.since(after.map_or(0, |after| after.saturating_add(1)));
        let lines = lines.into_iter().map(|(sequence, line, logger)| {
            json!({
                "sequence": sequence,
                "time_ns": line.time_ns.to_string(),
                "level": line.severity.name(),
                "module": line.module,
                "logger": logger,
                "text": line.message,
            })
        });
        Ok(
            json!({ "lines": lines.collect::<Vec<_>>(), "dropped": if after.is_some() { dropped } else { 0 } }),
        )
    }
}

impl Host for PageHost {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        let change = |act: &dyn Fn() -> Result<Value, String>| ask.check_access().and_then(|()| act());
        Some(match ask.name {
            "recording" => Ok(self.status()),
            "log" => self.log(ask),
            "latencies" => Ok(json!(self.latencies.reports())),
            "record" => change(&|| self.record(ask.text("name"))),
            "stop_recording" => change(&|| self.stop()),
            "record_snapshot" => change(&|| self.snapshot()),
            "pause_recording" => change(&|| self.running().map(|(_, control)| json!(control.pause()))),
            "save_file" => change(&|| self.save_file(ask)),
            "resume_recording" => change(&|| self.running().map(|(_, control)| json!(control.resume()))),
            _ => return None,
        })
    }
}

/// A new directory in the working directory, and nowhere else.
fn named(name: &str) -> Result<PathBuf, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if name.len() > 128 || name.starts_with('.') || !name.chars().all(is_plain) {
        return Err(
            "the name of a bag has letters, digits, \".\", \"_\" and \"-\", and does not begin with \".\""
                .to_owned(),
        );
    }
    let path = Path::new(name);
    if path.exists() {
        return Err(format!("{name} exists already"));
    }
    Ok(path.to_owned())
}

/// A name with the time, that no bag has.
fn unnamed() -> PathBuf {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let names = (0..)
        .map(|n| PathBuf::from(if n == 0 { format!("bag_{seconds}") } else { format!("bag_{seconds}_{n}") }));
    names.into_iter().find(|path| !path.exists()).unwrap_or_default()
}
