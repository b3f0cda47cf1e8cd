//! `[replay]` of a robot file.

use downbeat_bags::{FieldRule, FieldRuleError};
use downbeat_bridge::expose::TopicPattern;

use super::RobotFileError;
use super::table::Value;

type Result<T> = std::result::Result<T, RobotFileError>;

/// How a bag of the robot is replayed, unless the command line says otherwise.
#[derive(Clone, Debug, Default)]
pub struct ReplaySection {
    /// Only these modules; empty for all that can be.
    pub modules: Vec<String>,
    /// How exactly what they publish is compared.
    pub rules: Vec<FieldRule>,
    /// Topics that are not compared.
    pub except: Vec<TopicPattern>,
}

pub(super) fn replay(value: Value<'_>) -> Result<ReplaySection> {
    let mut table = value.table("[replay]")?;
    let modules = table.take("modules").map_or(Ok(Vec::new()), |value| value.list())?;
    let modules = modules.iter().map(|value| Ok(value.text()?.to_owned())).collect::<Result<_>>()?;
    let mut rules = Vec::new();
    for (key, read) in RULES {
        for value in table.take(key).map_or(Ok(Vec::new()), |value| value.list())? {
            rules.push(read(value.text()?).map_err(|error| value.error(error.to_string()))?);
        }
    }
    let mut except = Vec::new();
    for value in table.take("except").map_or(Ok(Vec::new()), |value| value.list())? {
        except.push(TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))?);
    }
    table.finish()?;
    Ok(ReplaySection { modules, rules, except })
}

type ReadRule = fn(&str) -> std::result::Result<FieldRule, FieldRuleError>;

const RULES: [(&str, ReadRule); 2] = [("tolerance", FieldRule::tolerance), ("ignore", FieldRule::ignore)];
