//! `--ros-args`: the arguments of every ROS 2 program.
//!
//! # References
//! `rcl_parse_arguments` in `rcl/src/rcl/arguments.c` (branch jazzy).

use std::ffi::OsString;
use std::path::PathBuf;

use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{ParameterRule, RemapRule, RemapRules};

use downbeat_msgs::definitions::suggestion;

/// Arguments between `--ros-args` and `--`, or the end.
///
/// ```
/// use downbeat_robot::RosArgs;
///
/// let line = ["run", "robot.toml", "--ros-args", "-r", "__ns:=/robot1", "--log-level", "debug", "--", "--record"];
/// let (others, ros) = RosArgs::split(line.map(Into::into))?;
/// assert_eq!(others, ["run", "robot.toml", "--record"]);
/// assert_eq!(ros.remaps[0].to_string(), "__ns:=/robot1");
/// # Ok::<(), downbeat_robot::RosArgsError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosArgs {
    /// `-r` or `--remap`, in their order.
    pub remaps: Vec<RemapRule>,
    /// `-p`, `--param` and `--params-file`, in their order: later ones take precedence.
    pub parameters: Vec<ParameterArgument>,
    /// What is logged, and where.
    pub log: LogArguments,
    /// `-e` or `--enclave`: the last one.
    pub enclave: Option<String>,
    /// `ROS_NAMESPACE`: the namespace of a node if no other is given.
    pub namespace: Option<String>,
}

/// Values of parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ParameterArgument {
    /// A parameter file.
    File(PathBuf),
    /// One value.
    Value(ParameterRule),
}

/// What is logged, and where.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogArguments {
    /// `--log-level LEVEL`: the level of all loggers.
    pub level: Option<LogLevel>,
    /// `--log-level LOGGER:=LEVEL`, in their order.
    pub loggers: Vec<(String, LogLevel)>,
    /// `--disable-stdout-logs`: nothing is logged to the terminal.
    pub is_stdout_disabled: bool,
    /// `--disable-rosout-logs`: nothing is logged to `/rosout`.
    pub is_rosout_disabled: bool,
    /// `--disable-external-lib-logs`: nothing is logged to a file.
    pub is_external_disabled: bool,
    /// `--log-file-name`: the prefix of the name of the log file.
    pub file_name: Option<String>,
    /// `--log-config-file`: the configuration of the library that writes log files.
    pub config_file: Option<String>,
}

/// The lowest severity that is logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LogLevel {
    /// The level of the parent logger.
    Unset,
    /// 10
    Debug,
    /// 20
    Info,
    /// 30
    Warn,
    /// 40
    Error,
    /// 50
    Fatal,
}

/// An unknown or invalid ROS 2 argument.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("--ros-args {argument}: {problem}")]
pub struct RosArgsError {
    argument: String,
    problem: String,
}

/// Flags with a value.
const WITH_VALUE: [&str; 10] = [
    "-r",
    "--remap",
    "-p",
    "--param",
    "--params-file",
    "--log-level",
    "--log-file-name",
    "--log-config-file",
    "-e",
    "--enclave",
];

/// Flags without a value.
const ALONE: [&str; 6] = [
    "--enable-rosout-logs",
    "--disable-rosout-logs",
    "--enable-stdout-logs",
    "--disable-stdout-logs",
    "--enable-external-lib-logs",
    "--disable-external-lib-logs",
];

impl RosArgs {
    /// Separates ROS 2 arguments from the others, which keep their order.
    ///
    /// # Errors
    /// Returns an error if an argument is unknown, lacks its value, or has an invalid value.
    pub fn split(
        arguments: impl IntoIterator<Item = OsString>,
    ) -> Result<(Vec<OsString>, Self), RosArgsError> {
        let (mut others, mut ros, mut is_ros) = (Vec::new(), Self::default(), false);
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            match (is_ros, argument.to_str()) {
                (_, Some("--ros-args")) => is_ros = true,
                (true, Some("--")) => is_ros = false,
                (false, _) => others.push(argument),
                (true, Some(flag)) if WITH_VALUE.contains(&flag) => {
                    let value = arguments.next().ok_or_else(|| error(flag, "its value is missing"))?;
                    let value = value.into_string().map_err(|value| {
                        error(&format!("{flag} {}", value.display()), "it is not in UTF-8")
                    })?;
                    ros.take(flag, &value)?;
                }
                (true, Some(flag)) if ALONE.contains(&flag) => ros.log.switch(flag),
                (true, _) => {
                    let argument = argument.display().to_string();
                    let hint = suggestion(&argument, WITH_VALUE.into_iter().chain(ALONE));
                    return Err(error(&argument, &format!("unknown argument of ROS 2{hint}")));
                }
            }
        }
        Ok((others, ros))
    }

    /// Completes the arguments with the values of environment variables.
    #[must_use]
    pub fn with_variables(mut self, lookup: impl Fn(&str) -> Option<String>) -> Self {
        self.namespace = lookup("ROS_NAMESPACE").filter(|namespace| !namespace.is_empty());
        self
    }

    /// Returns true if nothing was given on the command line.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self { namespace: self.namespace.clone(), ..Self::default() }
    }

    /// Logs a warning for each argument that has no effect.
    pub fn warn_about_what_is_ignored(&self) {
        if let Some(value) = &self.log.config_file {
            tracing::warn!("--log-config-file {value} changes nothing: no such library writes the log file");
        }
    }

    /// Returns options with the enclave of the command line.
    #[must_use]
    pub fn with_enclave(&self, mut options: ParticipantOptions) -> ParticipantOptions {
        if let (Some(security), Some(enclave)) = (&mut options.security, &self.enclave) {
            security.enclave.clone_from(enclave);
        }
        options
    }

    /// Returns the remapping rules for a participant.
    #[must_use]
    pub fn remap_rules(&self) -> RemapRules {
        self.remaps.iter().cloned().collect()
    }

    fn take(&mut self, flag: &str, value: &str) -> Result<(), RosArgsError> {
        let refuse = |problem: String| error(&format!("{flag} {value}"), &problem);
        match flag {
            "-r" | "--remap" => self.remaps.push(value.parse().map_err(|e| refuse(format!("{e}")))?),
            "-p" | "--param" => {
                let rule = value.parse().map_err(|e| refuse(format!("{e}")))?;
                self.parameters.push(ParameterArgument::Value(rule));
            }
            "--params-file" => self.parameters.push(ParameterArgument::File(value.into())),
            "--log-level" => self.log.set_level(value).map_err(refuse)?,
            "--log-file-name" => self.log.file_name = Some(value.to_owned()),
            "--log-config-file" => self.log.config_file = Some(value.to_owned()),
            _ => {
                if !value.starts_with('/') {
                    return Err(refuse("an enclave is an absolute name, such as \"/robot\"".into()));
                }
                self.enclave = Some(value.to_owned());
            }
        }
        Ok(())
    }
}

impl LogArguments {
    fn switch(&mut self, flag: &str) {
        let is_disabled = flag.starts_with("--disable-");
        match flag.split_once("able-").map_or("", |(_, what)| what) {
            "stdout-logs" => self.is_stdout_disabled = is_disabled,
            "rosout-logs" => self.is_rosout_disabled = is_disabled,
            _ => self.is_external_disabled = is_disabled,
        }
    }

    fn set_level(&mut self, value: &str) -> Result<(), String> {
        match value.split_once(":=") {
            None => self.level = Some(LogLevel::named(value)?),
            Some(("", _)) => return Err("the name of the logger is missing before \":=\"".into()),
            Some((logger, level)) => self.loggers.push((logger.to_owned(), LogLevel::named(level)?)),
        }
        Ok(())
    }
}

impl LogLevel {
    const ALL: [(&'static str, Self); 6] = [
        ("unset", Self::Unset),
        ("debug", Self::Debug),
        ("info", Self::Info),
        ("warn", Self::Warn),
        ("error", Self::Error),
        ("fatal", Self::Fatal),
    ];

    fn named(name: &str) -> Result<Self, String> {
        let known = Self::ALL.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        known.map(|&(_, level)| level).ok_or_else(|| {
            let hint = suggestion(&name.to_lowercase(), Self::ALL.map(|(known, _)| known));
            format!("\"{name}\" is not a severity{hint}")
        })
    }

    /// Returns the level in the syntax of `tracing` filters, which have no level above error.
    #[must_use]
    pub fn as_filter(self) -> &'static str {
        match self {
            Self::Unset | Self::Info => "info",
            Self::Debug => "debug",
            Self::Warn => "warn",
            Self::Error | Self::Fatal => "error",
        }
    }
}

fn error(argument: &str, problem: &str) -> RosArgsError {
    RosArgsError { argument: argument.to_owned(), problem: problem.to_owned() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn split(line: &str) -> Result<(Vec<OsString>, RosArgs), RosArgsError> {
        RosArgs::split(line.split_whitespace().map(OsString::from))
    }

    fn ros(line: &str) -> RosArgs {
        split(&format!("--ros-args {line}")).unwrap().1
    }

    #[test]
    fn ros_arguments_end_at_two_dashes_and_can_be_repeated() {
        let (others, ros) =
            split("run a.toml --ros-args -r a:=b -- --record x --ros-args --ros-args -r c:=d").unwrap();
        assert_eq!(others, ["run", "a.toml", "--record", "x"]);
        assert_eq!(ros.remaps.iter().map(ToString::to_string).collect::<Vec<_>>(), ["a:=b", "c:=d"]);
        let (others, ros) = split("run -- -r a:=b").unwrap();
        assert!(ros.is_empty() && others.len() == 4);
    }

    #[test]
    fn all_arguments_of_rcl_are_known() {
        let given = ros(
            "-p n:a.b:=1 --params-file f.yaml --param c:=x --log-level WARN --log-level a.b:=Debug --enclave /e \
             --disable-rosout-logs --disable-stdout-logs --enable-stdout-logs --disable-external-lib-logs \
             --log-config-file c --log-file-name f",
        );
        let value = |text: &str| ParameterArgument::Value(text.parse().unwrap());
        assert_eq!(
            given.parameters,
            [value("n:a.b:=1"), ParameterArgument::File("f.yaml".into()), value("c:=x")]
        );
        assert_eq!(given.log.level, Some(LogLevel::Warn));
        assert_eq!(given.log.loggers, [("a.b".to_owned(), LogLevel::Debug)]);
        assert!(
            given.log.is_rosout_disabled && given.log.is_external_disabled && !given.log.is_stdout_disabled
        );
        assert_eq!(given.enclave.as_deref(), Some("/e"));
        assert!(!given.is_empty() && ros("").is_empty());
    }

    #[test]
    fn unknown_arguments_are_reported() {
        for (line, expected) in [
            ("-r", "-r: its value is missing"),
            ("-r foo:=", "-r foo:=: \"foo:=\" is no remapping rule: expected a name"),
            ("--remap __ns:=a", "--remap __ns:=a: "),
            ("-p a", "-p a: \"a\" is no value of a parameter: expected \":=\""),
            ("--log-level loud", "--log-level loud: \"loud\" is not a severity; there is"),
            ("--log-level wran", "did you mean \"warn\"?"),
            ("--log-level :=debug", "the name of the logger is missing"),
            ("--enclave e", "--enclave e: an enclave is an absolute name"),
            ("--loglevel debug", "--loglevel: unknown argument of ROS 2, did you mean \"--log-level\"?"),
            ("foo:=bar", "foo:=bar: unknown argument of ROS 2"),
        ] {
            let error = split(&format!("--ros-args {line}")).unwrap_err().to_string();
            assert!(error.starts_with("--ros-args ") && error.contains(expected), "{error}");
        }
    }
}
