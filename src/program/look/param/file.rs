//! Parameter files, printed by `param dump` and read by `param load`.

use std::collections::BTreeMap;
use std::fmt::{Display, Write};
use std::sync::Arc;

use anyhow::{anyhow, ensure};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use downbeat_executor::SettingValue;

use crate::msgs::dynamic::{YamlContext, write_yaml_float, write_yaml_text};
use crate::robot::{NodeParameter, Source, parameters_of_nodes};

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

/// The parameters in a parameter file, for any node; those for all nodes come first and are overridden.
pub(super) fn values_in(
    source: &Arc<Source>,
    with_wildcard: bool,
) -> anyhow::Result<Vec<(String, SettingValue)>> {
    const ALL: &str = "/**";
    let mut nodes = parameters_of_nodes(source)?;
    nodes.retain(|(node, _)| with_wildcard || node != ALL);
    nodes.sort_by_key(|(node, _)| node != ALL);
    ensure!(!nodes.is_empty(), "Param file does not contain selected parameters");
    let mut values: Vec<(String, SettingValue)> = Vec::new();
    for NodeParameter { name, value, .. } in nodes.into_iter().flat_map(|(_, parameters)| parameters) {
        let value = value.map_err(|problem| anyhow!("{}: {name}: {problem}", source.path().display()))?;
        match values.iter_mut().find(|(known, _)| *known == name) {
            Some(known) => known.1 = value,
            None => values.push((name, value)),
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::Path;

    use super::*;
    use crate::program::look::param::value::value_in;

    fn tree(texts: &[(&str, &str)]) -> Tree {
        let mut tree = Tree::default();
        texts.iter().for_each(|(name, text)| tree.insert(name, Some(value_in(text).unwrap())));
        tree
    }

    fn read(text: &str, with_wildcard: bool) -> anyhow::Result<Vec<(String, SettingValue)>> {
        values_in(&Arc::new(Source::new(Path::new("robot.yaml"), text.to_owned())), with_wildcard)
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
        let refused = read("/robot:\n  ros__parameters: {a: [1, x]}\n", true).unwrap_err().to_string();
        assert!(refused.starts_with("robot.yaml: a: expected a list of numbers only"), "{refused}");
    }
}
