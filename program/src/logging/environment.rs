//! The environment variables of the log, as in ROS 2.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use downbeat_robot::LogArguments;

use super::format::{self, Format};

/// How and where lines are written.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct LogOptions {
    pub(super) format: Format,
    /// The format of lines that go to systemd's journal, which adds time and severity.
    pub(super) journal_format: Format,
    /// The device and inode of the journal's stream, if the service manager gave the process one.
    pub(super) journal: Option<String>,
    pub(super) colors: Colors,
    pub(super) stream: Stream,
    /// The log file, if any.
    pub(super) file: Option<PathBuf>,
    /// Remarks to log once the log is started.
    pub(super) remarks: Vec<&'static str>,
}

/// When lines are colored by severity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Colors {
    OnTerminals,
    Always,
    Never,
}

/// The output stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stream {
    Error,
    Output,
}

/// A variable has an invalid value.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{variable}={found:?} is invalid: expected 0 ({zero}), 1 ({one}), or nothing")]
pub(super) struct VariableError {
    variable: &'static str,
    found: String,
    zero: &'static str,
    one: &'static str,
}

impl LogOptions {
    /// Reads the variables; an empty one counts as unset.
    pub(super) fn from_variables(lookup: impl Fn(&str) -> Option<String>) -> Result<Self, VariableError> {
        let lookup = |name: &str| lookup(name).filter(|value| !value.is_empty());
        let switch = |variable, zero, one| match lookup(variable).as_deref() {
            None => Ok(None),
            Some("0") => Ok(Some(false)),
            Some("1") => Ok(Some(true)),
            Some(found) => Err(VariableError { variable, found: found.to_owned(), zero, one }),
        };
        // Each line is written at once and completely, which satisfies both values.
        switch("RCUTILS_LOGGING_BUFFERED_STREAM", "not buffered", "buffered by line")?;
        let mut remarks = Vec::new();
        if lookup("RCUTILS_CONSOLE_STDOUT_LINE_BUFFERED").is_some() {
            remarks.push(
                "RCUTILS_CONSOLE_STDOUT_LINE_BUFFERED is ignored, as by ROS 2: set RCUTILS_LOGGING_USE_STDOUT and \
                 RCUTILS_LOGGING_BUFFERED_STREAM",
            );
        }
        let given = lookup("RCUTILS_CONSOLE_OUTPUT_FORMAT");
        Ok(Self {
            format: Format::read(given.as_deref().unwrap_or(format::DEFAULT)),
            journal_format: Format::read(given.as_deref().unwrap_or(format::IN_JOURNAL)),
            journal: lookup("JOURNAL_STREAM"),
            colors: match switch("RCUTILS_COLORIZED_OUTPUT", "no colors", "colors")? {
                None => Colors::OnTerminals,
                Some(true) => Colors::Always,
                Some(false) => Colors::Never,
            },
            stream: match switch("RCUTILS_LOGGING_USE_STDOUT", "standard error", "standard output")? {
                Some(true) => Stream::Output,
                Some(false) | None => Stream::Error,
            },
            file: log_folder(lookup).map(|folder| folder.join(file_name(None))),
            remarks,
        })
    }

    /// Applies the command line.
    pub(super) fn with(mut self, arguments: &LogArguments) -> Self {
        let folder = self.file.as_deref().and_then(Path::parent).filter(|_| !arguments.is_external_disabled);
        self.file = folder.map(|folder| folder.join(file_name(arguments.file_name.as_deref())));
        self
    }
}

/// `ROS_LOG_DIR`, or the folder `log` of `ROS_HOME` (`rcl_logging_get_logging_directory`, with `~` for the
/// home folder). If neither is set, no file is written, so that a robot's disk is not filled unintentionally.
fn log_folder(lookup: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    let expanded = |path: String| match (path.strip_prefix('~'), lookup("HOME")) {
        (Some(rest), Some(home)) => PathBuf::from(home + rest),
        _ => PathBuf::from(path),
    };
    lookup("ROS_LOG_DIR").map(expanded).or_else(|| lookup("ROS_HOME").map(|home| expanded(home).join("log")))
}

/// Named as in `rcl_logging_spdlog`: program, process id, and milliseconds since 1970.
fn file_name(begins_with: Option<&str>) -> String {
    let program =
        std::env::current_exe().ok().and_then(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!(
        "{}_{}_{}.log",
        begins_with.or(program.as_deref()).unwrap_or("downbeat"),
        std::process::id(),
        now.as_millis()
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn options(variables: &[(&str, &str)]) -> Result<LogOptions, VariableError> {
        LogOptions::from_variables(|name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn an_empty_environment_means_the_format_of_ros_on_standard_error_and_no_file() {
        let expected = LogOptions {
            format: Format::read(format::DEFAULT),
            journal_format: Format::read(format::IN_JOURNAL),
            journal: None,
            colors: Colors::OnTerminals,
            stream: Stream::Error,
            file: None,
            remarks: vec![],
        };
        assert_eq!(options(&[]).unwrap(), expected);
        assert_eq!(options(&[("RCUTILS_COLORIZED_OUTPUT", ""), ("ROS_LOG_DIR", "")]).unwrap(), expected);
    }

    #[test]
    fn switches_are_0_or_1_and_other_values_are_refused_as_in_rcutils() {
        let color = |value| options(&[("RCUTILS_COLORIZED_OUTPUT", value)]).map(|options| options.colors);
        assert_eq!((color("1"), color("0")), (Ok(Colors::Always), Ok(Colors::Never)));
        let stdout =
            options(&[("RCUTILS_LOGGING_USE_STDOUT", "1"), ("RCUTILS_LOGGING_BUFFERED_STREAM", "0")]);
        assert_eq!(stdout.unwrap().stream, Stream::Output);
        for variable in
            ["RCUTILS_COLORIZED_OUTPUT", "RCUTILS_LOGGING_USE_STDOUT", "RCUTILS_LOGGING_BUFFERED_STREAM"]
        {
            let refused = options(&[(variable, "yes")]).unwrap_err().to_string();
            assert!(
                refused.starts_with(&format!("{variable}=\"yes\" is invalid: expected 0 (")),
                "{refused}"
            );
        }
    }

    #[test]
    fn the_folder_of_the_log_is_found_as_in_rcl() {
        let folder = |variables: &[(&str, &str)]| {
            options(variables).unwrap().file.map(|file| file.parent().unwrap().to_owned())
        };
        assert_eq!(folder(&[("ROS_LOG_DIR", "/logs"), ("ROS_HOME", "/ros")]), Some("/logs".into()));
        assert_eq!(folder(&[("ROS_HOME", "/ros")]), Some("/ros/log".into()));
        assert_eq!(
            folder(&[("ROS_LOG_DIR", "~/logs"), ("HOME", "/home/ada")]),
            Some("/home/ada/logs".into())
        );
    }

    #[test]
    fn a_file_is_named_by_program_process_and_time() {
        let name = file_name(None);
        let parts: Vec<_> = name.strip_suffix(".log").unwrap().rsplitn(3, '_').collect();
        let [milliseconds, process, _program] = parts[..] else { panic!("{name}") };
        assert_eq!(process, std::process::id().to_string());
        assert!(milliseconds.parse::<u64>().unwrap() > 1_700_000_000_000);
    }

    #[test]
    fn the_command_line_names_the_file_and_turns_it_off() {
        let with =
            |arguments: LogArguments| options(&[("ROS_LOG_DIR", "/logs")]).unwrap().with(&arguments).file;
        let named = with(LogArguments { file_name: Some("walk".into()), ..LogArguments::default() }).unwrap();
        assert!(named.to_str().unwrap().starts_with("/logs/walk_"), "{}", named.display());
        assert_eq!(with(LogArguments { is_external_disabled: true, ..LogArguments::default() }), None);
    }

    #[test]
    fn a_variable_that_ros_ignores_causes_a_remark() {
        let remarks = options(&[("RCUTILS_CONSOLE_STDOUT_LINE_BUFFERED", "1")]).unwrap().remarks;
        assert!(remarks[0].contains("RCUTILS_LOGGING_BUFFERED_STREAM"));
    }
}
