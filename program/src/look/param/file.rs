//! Parameter files, printed by `param dump` and read by `param load`.

use std::collections::BTreeMap;
use std::fmt::{Display, Write};
use std::sync::Arc;

use anyhow::{anyhow, bail};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use downbeat_executor::SettingValue;

use downbeat_msgs::dynamic::{YamlContext, write_yaml_float, write_yaml_text};
use downbeat_robot::Source;
use downbeat_robot::parameters::{NodeParameter, is_wildcard, matches, parameters_of_nodes};

/// Parameters by the parts of their names, separated by dots.
#[derive(Default)]
pub(super) struct Tree(BTreeMap<String, Branch>);

enum Branch {
    /// `None` for a parameter that is declared but not set.
    Value(Option<SettingValue>),
    Tree(Tree),
}

/// No sensible parameter has more parts; deeper ones keep the rest of their name unsplit.
const DEEPEST: usize = 64;

impl Tree {
    pub(super) fn insert(&mut self, name: &str, value: Option<SettingValue>) {
        let (mut tree, mut rest) = (self, name);
        for _ in 0..DEEPEST {
            // A name with a value cannot contain others, so these keep their dots.
            let Some((first, behind)) = rest.split_once('.') else { break };
            if matches!(tree.0.get(first), Some(Branch::Value(_))) {
                break;
            }
            rest = behind;
            match tree.0.entry(first.to_owned()).or_insert_with(|| Branch::Tree(Self::default())) {
                Branch::Tree(next) => tree = next,
                Branch::Value(_) => return,
            }
        }
        tree.0.insert(rest.to_owned(), Branch::Value(value));
    }

    /// The parameter file of a node, as written by PyYAML.
    pub(super) fn to_file(&self, node: &str) -> String {
        let mut out = String::new();
        write_yaml_text(&mut out, node, YamlContext::Block, 0);
        out.push_str(":\n  ros__parameters:");
        self.write(&mut out, 4);
        out
    }

    fn write(&self, out: &mut String, indentation: usize) {
        if self.0.is_empty() {
            return out.push_str(" {}\n");
        }
        out.push('\n');
        for (name, branch) in &self.0 {
            out.extend(std::iter::repeat_n(' ', indentation));
            write_yaml_text(out, name, YamlContext::Block, indentation);
            out.push(':');
            match branch {
                Branch::Tree(tree) => tree.write(out, indentation + 2),
                Branch::Value(None) => out.push_str(" null\n"),
                Branch::Value(Some(value)) => write_value(out, value, indentation),
            }
        }
    }
}

fn write_value(out: &mut String, value: &SettingValue, indentation: usize) {
    let text = |out: &mut String, text: &str| write_yaml_text(out, text, YamlContext::Block, indentation + 2);
    match value {
        SettingValue::Bool(value) => write_scalar(out, value, write_plain),
        SettingValue::Integer(value) => write_scalar(out, value, write_plain),
        SettingValue::Double(value) => write_scalar(out, value, |out, value| write_yaml_float(out, *value)),
        SettingValue::Text(value) => write_scalar(out, value, |out, value| text(out, value)),
        SettingValue::Bytes(values) => write_list(out, values, indentation, |out, byte| {
            write_plain(out, &format_args!("!!binary \"{}\"", BASE64_STANDARD.encode([*byte])));
        }),
        SettingValue::Bools(values) => write_list(out, values, indentation, write_plain),
        SettingValue::Integers(values) => write_list(out, values, indentation, write_plain),
        SettingValue::Doubles(values) => {
            write_list(out, values, indentation, |out, value| write_yaml_float(out, *value));
        }
        SettingValue::Texts(values) => write_list(out, values, indentation, |out, value| text(out, value)),
    }
}

fn write_plain(out: &mut String, value: &impl Display) {
    // Writing to a String cannot fail.
    let _ = write!(out, "{value}");
}

fn write_scalar<T>(out: &mut String, value: &T, write: impl Fn(&mut String, &T)) {
    out.push(' ');
    write(out, value);
    out.push('\n');
}

fn write_list<T>(out: &mut String, values: &[T], indentation: usize, write: impl Fn(&mut String, &T)) {
    if values.is_empty() {
        return out.push_str(" []\n");
    }
    out.push('\n');
    for value in values {
        out.extend(std::iter::repeat_n(' ', indentation));
        out.push('-');
        write_scalar(out, value, &write);
    }
}

/// A parameter that a file has for a node.
#[derive(Debug)]
pub(super) struct Loaded {
    pub(super) name: String,
    pub(super) value: SettingValue,
    /// Whether it is under a wildcard, and may be meant for other nodes only.
    pub(super) is_wildcard: bool,
}

/// The parameters in a parameter file for a node: those under wildcards come first and are overridden.
/// Parameters without a value, as a dump has them for those that are not set, are left out.
pub(super) fn values_in(
    source: &Arc<Source>,
    node: &str,
    with_wildcard: bool,
) -> anyhow::Result<Vec<Loaded>> {
    const ALL: &str = "/**";
    let mut nodes = parameters_of_nodes(source)?;
    nodes.retain(|(_, parameters)| !parameters.is_empty());
    let all: Vec<String> = nodes.iter().map(|(name, _)| name.clone()).collect();
    nodes.retain(|(pattern, _)| matches(pattern, node) && (with_wildcard || pattern != ALL));
    nodes.sort_by_key(|(pattern, _)| (pattern != ALL, !is_wildcard(pattern)));
    if nodes.is_empty() {
        let names = if all.is_empty() { "no node".to_owned() } else { all.join(", ") };
        let path = source.path().display();
        bail!(
            "Param file does not contain selected parameters: {path} has parameters for {names}, not for {node}"
        );
    }
    let mut values: Vec<Loaded> = Vec::new();
    let mut places = BTreeMap::new();
    for (pattern, parameters) in nodes {
        for NodeParameter { name, value, is_unset, .. } in parameters {
            if is_unset {
                continue;
            }
            let value = value.map_err(|problem| anyhow!("{}: {name}: {problem}", source.path().display()))?;
            let loaded = Loaded { name: name.clone(), value, is_wildcard: is_wildcard(&pattern) };
            match places.get(&name) {
                Some(&place) => values[place] = loaded,
                None => {
                    places.insert(name, values.len());
                    values.push(loaded);
                }
            }
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::Path;

    use super::*;
    use crate::look::param::value::value_in;

    fn tree(texts: &[(&str, &str)]) -> Tree {
        let mut tree = Tree::default();
        texts.iter().for_each(|(name, text)| tree.insert(name, Some(value_in(text).unwrap())));
        tree
    }

    fn read(text: &str, with_wildcard: bool) -> anyhow::Result<Vec<(String, SettingValue)>> {
        read_for("/robot", text, with_wildcard)
    }

    fn read_for(node: &str, text: &str, with_wildcard: bool) -> anyhow::Result<Vec<(String, SettingValue)>> {
        let source = Arc::new(Source::new(Path::new("robot.yaml"), text.to_owned()));
        let values = values_in(&source, node, with_wildcard)?;
        Ok(values.into_iter().map(|loaded| (loaded.name, loaded.value)).collect())
    }

    /// Expected output of PyYAML.
    #[test]
    fn a_dump_is_a_parameter_file() {
        let texts = [
            ("use_sim_time", "false"),
            ("mux.hold_s", "2.0"),
            ("mux.names", "[a, 'yes', \"b\\te\"]"),
            ("mux.gains", "[1.0e-5, 2.5]"),
            ("on", "off"),
            ("port", "''"),
            ("none", "[]"),
        ];
        let expected = "/ns/robot:
  ros__parameters:
    mux:
      gains:
      - 1.0e-05
      - 2.5
      hold_s: 2.0
      names:
      - a
      - 'yes'
      - \"b\\te\"
    none: []
    'on': false
    port: ''
    use_sim_time: false
";
        assert_eq!(tree(&texts).to_file("/ns/robot"), expected);
        assert_eq!(Tree::default().to_file("/robot"), "/robot:\n  ros__parameters: {}\n");
    }

    #[test]
    fn a_dump_is_loaded_again() {
        let texts = [("a", "1"), ("b.c", "[true, false]"), ("b.d", "text"), ("e", "[1, 2]"), ("f", "-1.5")];
        let loaded = read(&tree(&texts).to_file("/robot"), true).unwrap();
        let expected = texts.map(|(name, text)| (name.to_owned(), value_in(text).unwrap()));
        assert_eq!(loaded, expected);
    }

    #[test]
    fn values_for_a_node_override_those_for_all() {
        let file = "/robot:\n  ros__parameters: {a: 2}\n/**:\n  ros__parameters: {a: 1, b: 3}\n";
        let shown = |with_wildcard| -> Vec<_> {
            let values = read(file, with_wildcard).unwrap();
            values.iter().map(|(name, value)| format!("{name}={value}")).collect()
        };
        assert_eq!(shown(true), ["a=2", "b=3"]);
        assert_eq!(shown(false), ["a=2"]);
        assert!(read("/robot: {a: 1}\n", true).is_err());
        let others = "/*:\n  gps_node: {ros__parameters: {port: p}}\n  blackboard: {ros__parameters: {a: 2}}\n/**: {ros__parameters: {a: 1}}\n";
        let read = |node: &str| read_for(node, others, true).unwrap();
        assert_eq!(read("/demo/blackboard"), [("a".to_owned(), SettingValue::Integer(2))]);
        assert_eq!(read("/demo/other"), [("a".to_owned(), SettingValue::Integer(1))]);
        let refused = read_for("/other", "/robot: {ros__parameters: {a: 1}}", true).unwrap_err().to_string();
        assert!(refused.contains("has parameters for /robot, not for /other"), "{refused}");
        let read = |text: &str| read_for("/robot", text, true);
        assert_eq!(read("/robot: {ros__parameters: {a: null, b: , c: ~}}").unwrap(), []);
        let refused = read("/robot:\n  ros__parameters: {a: [1, x]}\n").unwrap_err().to_string();
        assert!(refused.starts_with("robot.yaml: a: expected a list of numbers only"), "{refused}");
    }
}
