//! The services by which tools read and set the levels of loggers.

use super::{LoggerLevels, Severity};
use crate::ros::{Node, NodeError, Service};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::{LoggerLevel, SetLoggerLevelsResult};
use downbeat_msgs::rcl_interfaces::srv::{
    GetLoggerLevels, GetLoggerLevelsResponse, SetLoggerLevels, SetLoggerLevelsResponse,
};

/// The two services of a node, until it is dropped.
pub struct LoggerServices {
    _services: [Service; 2],
}

impl LoggerLevels {
    /// Offers `~/get_logger_levels` and `~/set_logger_levels`, as a node of rclcpp with
    /// `enable_logger_service` does: for all loggers of the program, whatever the node. A logger without a
    /// level of its own has level 0; setting it to 0 takes it away.
    ///
    /// ```
    /// use downbeat_bridge::middleware::in_process::Hub;
    /// use downbeat_bridge::ros::{NodeName, Participant};
    /// use downbeat_bridge::rosout::{LoggerLevels, Severity};
    ///
    /// let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
    /// let node = participant.create_node(NodeName::new("/", "robot")?)?;
    /// let levels = LoggerLevels::starting_at(Severity::Info);
    /// let _services = levels.serve(&node)?; // `ros2 service call /robot/set_logger_levels …` sets what `levels` holds.
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`NodeError`] when a service cannot be created.
    pub fn serve(&self, node: &Node) -> Result<LoggerServices, NodeError> {
        let (get, set) = (self.clone(), self.clone());
        let get =
            node.serve::<GetLoggerLevels>("~/get_logger_levels", QosProfile::SERVICES, move |request| {
                let level = |name: String| LoggerLevel {
                    level: get.own(&name).map_or(UNSET, |level| level.number().into()),
                    name,
                };
                GetLoggerLevelsResponse { levels: request.names.into_iter().map(level).collect() }
            })?;
        let set =
            node.serve::<SetLoggerLevels>("~/set_logger_levels", QosProfile::SERVICES, move |request| {
                let result = |level: LoggerLevel| {
                    let result = change(&set, &level);
                    let reason = result.err().unwrap_or_default();
                    SetLoggerLevelsResult { successful: reason.is_empty(), reason }
                };
                SetLoggerLevelsResponse { results: request.levels.into_iter().map(result).collect() }
            })?;
        Ok(LoggerServices { _services: [get, set] })
    }
}

/// `RCUTILS_LOG_SEVERITY_UNSET`.
const UNSET: u32 = 0;

/// # Errors
/// Why not, as rcutils says it (`rcutils_logging_set_logger_level`, branch jazzy).
fn change(levels: &LoggerLevels, level: &LoggerLevel) -> Result<(), String> {
    let severity = match (level.level, Severity::from_number(level.level)) {
        (UNSET, _) => None,
        (_, Some(severity)) => Some(severity),
        (number, None) if number > u32::from(Severity::Fatal.number()) => {
            return Err("Invalid severity level specified for logger".to_owned());
        }
        (_, None) => return Err("Unable to determine severity_string for severity".to_owned()),
    };
    levels.set(&level.name, severity).map_err(|error| error.to_string())?;
    tracing::debug!(logger = level.name, level = level.level, "a logger was given a level");
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::middleware::in_process::Hub;
    use crate::ros::{NodeName, Participant};
    use downbeat_msgs::rcl_interfaces::srv::{GetLoggerLevelsRequest, SetLoggerLevelsRequest};
    use std::sync::Arc;
    use std::time::Duration;

    const PATIENCE: Duration = Duration::from_secs(10);

    #[test]
    fn levels_are_told_and_set_and_what_is_none_is_refused() {
        let hub = Hub::new();
        let node = |name: &str| {
            let participant = Participant::on(Arc::new(hub.join())).unwrap();
            participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
        };
        let (robot, tool) = (node("robot"), node("tool"));
        let levels = LoggerLevels::starting_at(Severity::Warn);
        levels.set("robot", Some(Severity::Error)).unwrap();
        let _services = levels.serve(&robot).unwrap();
        let get = tool.client::<GetLoggerLevels>("/robot/get_logger_levels", QosProfile::SERVICES).unwrap();
        let names = ["", "robot", "robot.walker"].map(str::to_owned).to_vec();
        let answer = get.call_and_wait(&GetLoggerLevelsRequest { names }, PATIENCE).unwrap();
        assert_eq!(answer.levels.iter().map(|level| level.level).collect::<Vec<_>>(), [30, 40, 0]);

        let set = tool.client::<SetLoggerLevels>("/robot/set_logger_levels", QosProfile::SERVICES).unwrap();
        let wanted = [("robot", 0), ("robot.walker", 10), ("x", 15), ("x", 60)];
        let wanted = wanted.map(|(name, level)| LoggerLevel { name: name.to_owned(), level }).to_vec();
        let answer = set.call_and_wait(&SetLoggerLevelsRequest { levels: wanted }, PATIENCE).unwrap();
        let successful: Vec<_> = answer.results.iter().map(|result| result.successful).collect();
        assert_eq!(successful, [true, true, false, false]);
        assert_eq!(answer.results[3].reason, "Invalid severity level specified for logger");
        assert_eq!((levels.own("robot"), levels.own("robot.walker")), (None, Some(Severity::Debug)));
        assert_eq!(levels.own("x"), None);
    }
}
