//! The levels of loggers, as ROS 2 tools read and set them while a program runs.

use super::Severity;
use parking_lot::RwLock;
use std::collections::BTreeMap;
use std::sync::Arc;
use thiserror::Error;

/// Names come from outside.
const MOST_LOGGERS: usize = 1024;

/// The name of the logger above all.
const ROOT: &str = "";

/// The levels that were set for loggers. Clones share the levels.
///
/// Names are those of rcutils: `robot.downbeat` is the parent of `robot.downbeat.walker`, and a logger that
/// has no level has that of its parent. Where no ancestor has one either, what the program was started with
/// holds.
///
/// ```
/// use downbeat_bridge::rosout::{LoggerLevels, Severity};
///
/// let levels = LoggerLevels::default();
/// levels.set("robot", Some(Severity::Warn))?;
/// levels.set("robot.walker", Some(Severity::Debug))?;
/// assert_eq!(levels.effective("robot.walker.left"), Some(Severity::Debug));
/// assert_eq!(levels.effective("robot.camera"), Some(Severity::Warn));
/// assert_eq!(levels.effective("elsewhere"), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct LoggerLevels {
    by_name: Arc<RwLock<BTreeMap<String, Severity>>>,
    /// The level at the start of the program; `None` for info.
    start: Option<Severity>,
}

/// No more loggers can be given levels.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("logger {logger:?} is not set: {MOST_LOGGERS} loggers have levels already; unset some of them")]
pub struct TooManyLoggers {
    /// The logger.
    pub logger: String,
}

impl LoggerLevels {
    /// The levels of a program that writes from this severity on; it is reported for the root logger.
    #[must_use]
    pub fn starting_at(level: Severity) -> Self {
        Self { start: Some(level), ..Self::default() }
    }

    /// Sets or removes the level of a logger. Takes effect immediately, on all threads.
    ///
    /// # Errors
    /// [`TooManyLoggers`] where 1024 loggers have one.
    pub fn set(&self, logger: &str, level: Option<Severity>) -> Result<(), TooManyLoggers> {
        {
            let mut by_name = self.by_name.write();
            match level {
                None => drop(by_name.remove(logger)),
                Some(_) if by_name.len() >= MOST_LOGGERS && !by_name.contains_key(logger) => {
                    return Err(TooManyLoggers { logger: logger.to_owned() });
                }
                Some(level) => drop(by_name.insert(logger.to_owned(), level)),
            }
        }
        // Call sites that were disabled are evaluated again.
        tracing::callsite::rebuild_interest_cache();
        Ok(())
    }

    /// The level a logger was given, if it was. The root always has one.
    #[must_use]
    pub fn own(&self, logger: &str) -> Option<Severity> {
        let given = self.by_name.read().get(logger).copied();
        given.or_else(|| logger.is_empty().then(|| self.start.unwrap_or(Severity::Info)))
    }

    /// The level a logger was given, or the nearest of its ancestors.
    #[must_use]
    pub fn effective(&self, logger: &str) -> Option<Severity> {
        let by_name = self.by_name.read();
        if by_name.is_empty() {
            return None;
        }
        let mut ancestors = std::iter::successors(Some(logger), parent).chain([ROOT]);
        ancestors.find_map(|name| by_name.get(name).copied())
    }

    /// The least severity that some logger was given: what a filter before the loggers has to let pass.
    #[must_use]
    pub fn least(&self) -> Option<Severity> {
        self.by_name.read().values().min().copied()
    }
}

fn parent<'a>(logger: &&'a str) -> Option<&'a str> {
    logger.rsplit_once('.').map(|(parent, _)| parent)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_logger_without_a_level_has_that_of_the_nearest_ancestor() {
        let levels = LoggerLevels::default();
        levels.set("a", Some(Severity::Error)).unwrap();
        levels.set("a.b.c", Some(Severity::Debug)).unwrap();
        assert_eq!(levels.effective("a.b"), Some(Severity::Error));
        assert_eq!(levels.effective("a.b.c.d"), Some(Severity::Debug));
        assert_eq!(levels.effective("ab"), None);
        assert_eq!((levels.own("a.b"), levels.least()), (None, Some(Severity::Debug)));
        levels.set("a.b.c", None).unwrap();
        assert_eq!(levels.effective("a.b.c"), Some(Severity::Error));
    }

    #[test]
    fn the_root_is_above_all_loggers_and_begins_with_the_level_of_the_program() {
        let levels = LoggerLevels::starting_at(Severity::Warn);
        assert_eq!((levels.own(""), levels.effective("a.b")), (Some(Severity::Warn), None));
        levels.set("", Some(Severity::Error)).unwrap();
        assert_eq!((levels.own(""), levels.effective("a.b")), (Some(Severity::Error), Some(Severity::Error)));
        levels.set("a", Some(Severity::Info)).unwrap();
        assert_eq!(levels.effective("a.b"), Some(Severity::Info));
        levels.set("", None).unwrap();
        assert_eq!((levels.own(""), levels.effective("b")), (Some(Severity::Warn), None));
    }

    #[test]
    fn names_from_outside_do_not_fill_the_memory() {
        let levels = LoggerLevels::default();
        for number in 0..MOST_LOGGERS {
            levels.set(&format!("logger{number}"), Some(Severity::Info)).unwrap();
        }
        let refused = levels.set("one_more", Some(Severity::Info)).unwrap_err();
        assert!(refused.to_string().contains("one_more"), "{refused}");
        levels.set("logger7", Some(Severity::Debug)).unwrap();
        levels.set("logger8", None).unwrap();
        levels.set("one_more", Some(Severity::Info)).unwrap();
    }
}
