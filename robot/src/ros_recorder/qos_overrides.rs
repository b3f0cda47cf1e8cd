//! Quality of service that a user wants in place of what is found: `--qos-profile-overrides-path`.
//!
//! The form is that of `ros2bag/api/__init__.py` and of `rclpy.qos.QoSProfile`, branch jazzy.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_msgs::qos::{BEST_AVAILABLE, History, QosProfile, SYSTEM_DEFAULT, Word};
use serde_norway::{Mapping, Value};

/// The QoS to request or offer, by topic.
///
/// ```
/// use downbeat_robot::ros_recorder::QosOverrides;
///
/// let text = "/chatter:\n  reliability: best_effort\n  depth: 7\n";
/// let overrides = QosOverrides::parse(text, "overrides.yaml".as_ref())?;
/// assert!(overrides.of("/chatter").is_some() && overrides.of("/other").is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct QosOverrides {
    topics: BTreeMap<String, QosProfile>,
}

/// Why a file of overrides cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum QosOverridesError {
    /// It could not be read.
    #[error("cannot read the QoS overrides {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// It is not YAML, or not a map of topics.
    #[error("{}: not a file of QoS overrides: {found}", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        found: String,
    },
    /// The profile of a topic is not valid.
    #[error("{}: the QoS profile of {topic}: {problem}", path.display())]
    Profile {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What is wrong.
        problem: String,
    },
}

impl QosOverrides {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or is not what rosbag2 takes.
    pub fn read(path: &Path) -> Result<Self, QosOverridesError> {
        let read = |source| QosOverridesError::Read { path: path.to_owned(), source };
        Self::parse(&downbeat_msgs::user_file::read_text(path).map_err(read)?, path)
    }

    /// Reads the text of a file; `path` is for errors.
    ///
    /// # Errors
    /// If the text is not what rosbag2 takes.
    pub fn parse(text: &str, path: &Path) -> Result<Self, QosOverridesError> {
        let form = |found: String| QosOverridesError::Form { path: path.to_owned(), found };
        let document: Value = downbeat_msgs::yaml::from_str(text).map_err(|error| form(error.to_string()))?;
        let Value::Mapping(document) = document else {
            return Err(form("it has to be a map of topics".to_owned()));
        };
        let mut topics = BTreeMap::new();
        for (name, profile) in &document {
            let Some(topic) = name.as_str() else {
                return Err(form("the names of topics have to be texts".to_owned()));
            };
            let profile = profile
                .as_mapping()
                .ok_or_else(|| "it has to be a map of policies".to_owned())
                .and_then(read_profile)
                .map_err(|problem| QosOverridesError::Profile {
                    path: path.to_owned(),
                    topic: topic.to_owned(),
                    problem,
                })?;
            topics.insert(topic.to_owned(), profile);
        }
        Ok(Self { topics })
    }

    /// The profile of a topic, by its absolute name.
    #[must_use]
    pub fn of(&self, topic: &str) -> Option<QosProfile> {
        self.topics.get(topic).copied()
    }

    /// The topics that are named.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.topics.keys().map(String::as_str)
    }
}

fn read_profile(policies: &Mapping) -> Result<QosProfile, String> {
    let mut profile = QosProfile::DEFAULT;
    let (mut history, mut depth) = (None, None);
    for (key, value) in policies {
        let key = key.as_str().ok_or("the names of policies have to be texts")?;
        match key {
            "history" => {
                history = Some(choice(key, value, &[History::KEEP_LAST, History::KEEP_ALL, SYSTEM_DEFAULT])?);
            }
            "depth" => depth = Some(number(key, value)?),
            "reliability" => profile.reliability = policy(key, value, profile.reliability)?,
            "durability" => profile.durability = policy(key, value, profile.durability)?,
            "liveliness" => profile.liveliness = policy(key, value, profile.liveliness)?,
            "deadline" => profile.deadline = duration(key, value)?,
            "lifespan" => profile.lifespan = duration(key, value)?,
            "liveliness_lease_duration" => profile.liveliness_lease_duration = duration(key, value)?,
            "avoid_ros_namespace_conventions" => match value {
                Value::Bool(false) => {}
                Value::Bool(true) => {
                    return Err(format!("`{key}` cannot be true: topics have their ROS names here"));
                }
                _ => return Err(format!("`{key}` has to be true or false")),
            },
            other => return Err(format!("Unexpected key `{other}` for QoS profile.")),
        }
    }
    profile.history = match (history, depth) {
        (None, None) => return Err("History and/or depth settings are required.".to_owned()),
        (Some(0), None) => return Err("History set to KEEP_LAST without a depth setting.".to_owned()),
        (Some(1), _) => History::KeepAll,
        (_, depth) => depth.map_or(profile.history, |depth| History::KeepLast(depth.max(1))),
    };
    Ok(profile)
}

/// `system_default` and `best_available` give the default.
fn policy<T: Word>(key: &str, value: &Value, default: T) -> Result<T, String> {
    let names: Vec<_> =
        T::ALL.iter().map(|policy| policy.name()).chain([SYSTEM_DEFAULT, BEST_AVAILABLE]).collect();
    Ok(T::ALL.get(choice(key, value, &names)?).copied().unwrap_or(default))
}

/// The position of the name among `names`.
fn choice(key: &str, value: &Value, names: &[&str]) -> Result<usize, String> {
    let name = value.as_str().map(str::to_ascii_lowercase).unwrap_or_default();
    names
        .iter()
        .position(|known| *known == name)
        .ok_or_else(|| format!("`{key}` has to be one of {}", names.join(", ")))
}

fn number(key: &str, value: &Value) -> Result<u32, String> {
    match value.as_i64() {
        Some(negative) if negative < 0 => Err(format!("`{key}` may not be a negative value.")),
        Some(number) => u32::try_from(number).map_err(|_| format!("`{key}` is too large")),
        None => Err(format!("`{key}` has to be a number")),
    }
}

/// Nothing stands for infinite.
fn duration(key: &str, value: &Value) -> Result<Option<Duration>, String> {
    if value.is_null() {
        return Ok(None);
    }
    let part = |name: &str| value.get(name).and_then(Value::as_i64);
    let (Some(sec), Some(nsec)) = (part("sec"), part("nsec")) else {
        return Err(format!(
            "`{key}`: Time overrides must include both seconds (sec) and nanoseconds (nsec)."
        ));
    };
    let (Ok(sec), Ok(nsec)) = (u64::try_from(sec), u64::try_from(nsec)) else {
        return Err(format!("`{key}`: Time duration may not be a negative value."));
    };
    let duration = Duration::from_secs(sec).saturating_add(Duration::from_nanos(nsec));
    // Zero is what is not specified (`RMW_DURATION_UNSPECIFIED`), and the largest that there is, infinite.
    let is_infinite = duration.is_zero() || duration.as_nanos() >= u128::from(i64::MAX as u64);
    Ok((!is_infinite).then_some(duration))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::qos::{Durability, Liveliness, Reliability};

    fn read(profile: &str) -> Result<QosProfile, String> {
        QosOverrides::parse(&format!("/t: {profile}\n"), Path::new("o.yaml"))
            .map(|overrides| overrides.of("/t").unwrap())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn every_policy_is_read() {
        let text = "{history: keep_all, depth: 0, reliability: best_effort, durability: transient_local, \
                    deadline: {sec: 1, nsec: 5}, lifespan: {sec: 2147483647, nsec: 4294967295}, \
                    liveliness: manual_by_topic, liveliness_lease_duration: {sec: 10, nsec: 0}, \
                    avoid_ros_namespace_conventions: false}";
        let profile = read(text).unwrap();
        assert_eq!(profile.history, History::KeepAll);
        assert_eq!(profile.reliability, Reliability::BestEffort);
        assert_eq!(profile.durability, Durability::TransientLocal);
        assert_eq!(profile.deadline, Some(Duration::new(1, 5)));
        assert_eq!(profile.liveliness, Liveliness::ManualByTopic);
        assert_eq!(profile.liveliness_lease_duration, Some(Duration::from_secs(10)));
        assert_eq!(read("{depth: 7}").unwrap(), QosProfile::DEFAULT.keep_last(7));
    }

    #[test]
    fn what_rosbag2_refuses_is_refused_in_its_words() {
        for (profile, words) in [
            ("{reliability: reliable}", "History and/or depth settings are required."),
            ("{history: keep_last}", "without a depth setting"),
            ("{depth: -1}", "`depth` may not be a negative value."),
            ("{depth: 1, colour: red}", "Unexpected key `colour`"),
            ("{depth: 1, deadline: {sec: 1}}", "must include both seconds (sec) and nanoseconds (nsec)"),
            ("{depth: 1, deadline: {sec: -1, nsec: 0}}", "may not be a negative value"),
            ("{depth: 1, reliability: yes_please}", "one of reliable, best_effort"),
        ] {
            let error = read(profile).unwrap_err();
            assert!(error.starts_with("o.yaml: ") && error.contains(words), "{error}");
        }
        assert!(QosOverrides::parse("[]", Path::new("o.yaml")).is_err());
    }
}
