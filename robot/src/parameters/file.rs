//! ROS 2 parameter files, which contain nodes with their parameters.
//!
//! # References
//! rcl_yaml_param_parser defines the format, and `parameter_map_from` of rclcpp which nodes a name matches.

use std::sync::Arc;

use downbeat_executor::SettingValue;
use downbeat_msgs::definitions::nearest;
use serde_norway::Value;

use super::{scalar, setting_value};
use crate::RobotFileError;
use crate::file::{ParameterPlace, Source};

type Result<T, E = RobotFileError> = std::result::Result<T, E>;

/// A parameter of a node.
pub struct NodeParameter {
    /// Nested maps are joined with `.`.
    pub name: String,
    /// The value, or the problem with it.
    pub value: std::result::Result<SettingValue, String>,
    /// Whether it has no value, or the word that YAML has for none; in rcl that is text.
    pub is_unset: bool,
    /// The keys that lead to it, from the root of the file.
    pub keys: Vec<String>,
}

/// Returns true if a name of nodes in a parameter file has wildcards: what it names may be meant for other
/// nodes.
pub fn is_wildcard(pattern: &str) -> bool {
    pattern.split('/').any(|part| matches!(part, "*" | "**"))
}

/// The nodes of a file by absolute name, wildcards included, with their parameters; both in the order of the
/// file.
pub fn parameters_of_nodes(source: &Arc<Source>) -> Result<Vec<(String, Vec<NodeParameter>)>> {
    let root = scalar::values_in(source.text()).map_err(|error| {
        let line = error.location().map_or(1, |location| location.line());
        source.error(line, error.to_string())
    })?;
    let mut nodes = Vec::new();
    if !matches!(root, Value::Null) {
        collect_nodes(source, &root, &mut Vec::new(), &mut nodes)?;
    }
    Ok(nodes)
}

/// Returns true if a node has this absolute name: `*` stands for one part of it, `**` for any number of them.
pub fn matches(pattern: &str, node: &str) -> bool {
    let parts = |name: &'_ str| {
        name.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect::<Vec<_>>()
    };
    matches_parts(&parts(pattern), &parts(node))
}

fn matches_parts(pattern: &[String], node: &[String]) -> bool {
    match (pattern.split_first(), node.split_first()) {
        (None, None) => true,
        (Some((first, rest)), _) if first == "**" => {
            (0..=node.len()).any(|skipped| matches_parts(rest, &node[skipped..]))
        }
        (Some((first, rest)), Some((part, others))) => {
            (first == "*" || first == part) && matches_parts(rest, others)
        }
        _ => false,
    }
}

const PARAMETERS: &str = "ros__parameters";

/// Whether a key is a misspelt `ros__parameters`: it looks like that, and there is none below it.
fn is_meant_for_parameters(key: &str, value: &Value) -> bool {
    fn has_parameters(value: &Value) -> bool {
        value.as_mapping().is_some_and(|map| {
            map.contains_key(PARAMETERS) || map.iter().any(|(_, below)| has_parameters(below))
        })
    }
    let lower = key.to_lowercase();
    let is_similar = lower.starts_with("ros") && nearest(&lower, [PARAMETERS]).is_some();
    key != PARAMETERS && is_similar && !has_parameters(value)
}

fn collect_nodes(
    source: &Arc<Source>,
    value: &Value,
    keys: &mut Vec<String>,
    nodes: &mut Vec<(String, Vec<NodeParameter>)>,
) -> Result<()> {
    let place = |keys: &[String]| ParameterPlace { source: Arc::clone(source), keys: keys.to_vec() };
    let Value::Mapping(map) = value else {
        let expected = format!("expected the name of a node, and under it {PARAMETERS} with its parameters");
        return Err(place(keys).error(expected));
    };
    for (key, value) in map {
        let key = key
            .as_str()
            .ok_or_else(|| place(keys).error("a key is not the name of a node; put it in quotes"))?;
        keys.push(key.to_owned());
        if is_meant_for_parameters(key, value) {
            let problem = format!("\"{key}\" is not {PARAMETERS}, with two underscores; did you mean that?");
            return Err(place(keys).error(problem));
        }
        if key != PARAMETERS {
            collect_nodes(source, value, keys, nodes)?;
        } else if keys.len() == 1 {
            return Err(
                place(keys).error(format!("{PARAMETERS} must be under the name of a node, or under /**"))
            );
        } else {
            let name = format!("/{}", keys[..keys.len() - 1].join("/").trim_start_matches('/'));
            let mut parameters = Vec::new();
            match value {
                Value::Null => {}
                Value::Mapping(_) => collect_parameters(source, value, keys, keys.len(), &mut parameters)?,
                _ => return Err(place(keys).error("expected parameters with their values")),
            }
            nodes.push((name, parameters));
        }
        keys.pop();
    }
    Ok(())
}

/// `root` is the number of keys that lead to the parameters of the node.
fn collect_parameters(
    source: &Arc<Source>,
    value: &Value,
    keys: &mut Vec<String>,
    root: usize,
    parameters: &mut Vec<NodeParameter>,
) -> Result<()> {
    let Value::Mapping(map) = value else {
        let is_unset = match value {
            Value::Tagged(word) => word.tag == scalar::NULL_WORD,
            value => value.is_null(),
        };
        let (name, value) = (keys[root..].join("."), setting_value(value));
        parameters.push(NodeParameter { name, value, is_unset, keys: keys.clone() });
        return Ok(());
    };
    for (key, value) in map {
        let Some(key) = key.as_str() else {
            let place = ParameterPlace { source: Arc::clone(source), keys: keys.clone() };
            return Err(place.error("a key is not the name of a parameter; put it in quotes"));
        };
        keys.push(key.to_owned());
        collect_parameters(source, value, keys, root, parameters)?;
        keys.pop();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_names_and_wildcards_match_as_in_rcl() {
        let cases = [
            ("/r", "/r", true),
            ("/r", "/ns/r", false),
            ("/ns/r", "/ns/r", true),
            ("/*", "/r", true),
            ("/*", "/ns/r", false),
            ("/*/r", "/ns/r", true),
            ("/*/r", "/r", false),
            ("/ns/*", "/ns/r", true),
            ("/**", "/r", true),
            ("/**", "/a/b/r", true),
            ("/**/r", "/r", true),
            ("/**/r", "/a/b/r", true),
            ("/a/**/r", "/b/r", false),
            ("/robot", "/r", false),
        ];
        for (pattern, node, expected) in cases {
            assert_eq!(matches(pattern, node), expected, "{pattern} and {node}");
        }
    }
}
