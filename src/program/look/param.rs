//! `downbeat param`

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Duration;

use crate::bridge::ros::{Client, EndpointKind, Found};
use crate::msgs::Service;
use crate::msgs::dynamic::{YamlContext, python, write_yaml_float, write_yaml_text};
use crate::msgs::qos::QosProfile;
use crate::msgs::rcl_interfaces::msg::{
    Parameter, ParameterDescriptor, ParameterType, ParameterValue, SetParametersResult,
};
use crate::msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersRequest, GetParameters, GetParametersRequest, ListParameters,
    ListParametersRequest, SetParameters, SetParametersRequest,
};
use anyhow::{Context, anyhow, bail, ensure};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use clap::{Args, Subcommand};
use regex_lite::Regex;
use serde_norway::Value;

use super::network::{Environment, Look, LookArguments, Patience, absolute, is_hidden_node, node_names};
use super::values::seconds;

#[derive(Subcommand)]
pub(crate) enum ParamCommand {
    /// List the parameters of a node, or of all.
    List(ListArguments),
    /// Print the value of a parameter.
    Get(GetArguments),
    /// Give a parameter another value.
    Set(SetArguments),
    /// Print type, description and constraints of parameters.
    Describe(DescribeArguments),
    /// Print all parameters of a node with their values, as a parameter file.
    Dump(DumpArguments),
    /// Give the parameters of a node the values in a parameter file.
    Load(LoadArguments),
    /// Delete a parameter.
    Delete(DeleteArguments),
}

/// The node whose parameters are meant.
#[derive(Args)]
struct NodeArguments {
    /// The node.
    node: String,
    /// Consider also nodes whose name begins with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    /// Wait at most so long until the node is there, in seconds; as long as --spin-time says unless given.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    timeout: Option<Duration>,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// The node; all nodes unless given.
    node: Option<String>,
    /// Print only parameters whose name begins with what this regular expression matches.
    #[arg(long, value_name = "REGEX")]
    filter: Option<String>,
    /// Consider also nodes whose name begins with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    /// Print only parameters below these prefixes.
    #[arg(long, value_name = "PREFIX", num_args = 1..)]
    param_prefixes: Vec<String>,
    /// Print the types, too.
    #[arg(long)]
    param_type: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct GetArguments {
    #[command(flatten)]
    node: NodeArguments,
    /// The parameter.
    parameter: String,
    /// Print the value alone.
    #[arg(long)]
    hide_type: bool,
}

#[derive(Args)]
pub(crate) struct SetArguments {
    #[command(flatten)]
    node: NodeArguments,
    /// The parameter.
    parameter: String,
    /// The value, in YAML.
    #[arg(allow_hyphen_values = true)]
    value: String,
}

#[derive(Args)]
pub(crate) struct DescribeArguments {
    #[command(flatten)]
    node: NodeArguments,
    /// The parameters.
    #[arg(required = true, value_name = "PARAMETER")]
    parameters: Vec<String>,
}

#[derive(Args)]
pub(crate) struct DumpArguments {
    #[command(flatten)]
    node: NodeArguments,
}

#[derive(Args)]
pub(crate) struct LoadArguments {
    #[command(flatten)]
    node: NodeArguments,
    /// The parameter file: what it has for any node is taken, as `ros2` does.
    file: PathBuf,
    /// Leave out what the file has for all nodes, under /**.
    #[arg(long)]
    no_use_wildcard: bool,
}

#[derive(Args)]
pub(crate) struct DeleteArguments {
    #[command(flatten)]
    node: NodeArguments,
    /// The parameter.
    parameter: String,
}

pub(crate) fn param(command: &ParamCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        ParamCommand::List(arguments) => list(arguments, environment),
        ParamCommand::Get(arguments) => get(arguments, environment),
        ParamCommand::Set(arguments) => set(arguments, environment),
        ParamCommand::Describe(arguments) => describe(arguments, environment),
        ParamCommand::Dump(arguments) => dump(arguments, environment),
        ParamCommand::Load(arguments) => load(arguments, environment),
        ParamCommand::Delete(arguments) => delete(arguments, environment),
    }
}

/// How long a service of a node that is there gets to be matched, and to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// A node that has parameters.
struct Parameters {
    look: Look,
    node: String,
}

impl Parameters {
    fn of(arguments: &NodeArguments, environment: &Environment<'_>) -> anyhow::Result<Self> {
        let look = Look::join("param", &arguments.look, environment)?;
        let look = look.no_longer_than(arguments.timeout);
        let node = absolute(&arguments.node);
        let is_there =
            |found: &Found| has_parameters(found, &node) || node_names(found, true).contains(&&*node);
        let is_shown = arguments.include_hidden_nodes || !is_hidden_node(&node);
        ensure!(is_shown && is_there(&look.found_with(is_there)), "Node not found");
        Ok(Self { look, node })
    }

    fn ask<S: Service>(&self, service: &str, request: &S::Request) -> anyhow::Result<S::Response> {
        let Self { look, node } = self;
        let client = client::<S>(look, node, service)?;
        if !look.wait_for(Some(PATIENCE), || client.is_available()) {
            bail!("Wait for service timed out waiting for parameter services for node {node}");
        }
        let answer = client.call_and_wait(request, PATIENCE);
        answer.with_context(|| format!("Exception while calling service of node {node}"))
    }

    fn values(&self, names: Vec<String>) -> anyhow::Result<Vec<ParameterValue>> {
        Ok(self.ask::<GetParameters>("get_parameters", &GetParametersRequest { names })?.values)
    }

    /// The result for each of the parameters. An empty list has the type of the parameter.
    fn set(&self, mut parameters: Vec<Parameter>) -> anyhow::Result<Vec<SetParametersResult>> {
        let is_empty_list = |parameter: &&mut Parameter| {
            parameter.value.r#type == ParameterType::PARAMETER_BOOL_ARRAY
                && parameter.value.bool_array_value.is_empty()
        };
        let mut empty_lists: Vec<_> = parameters.iter_mut().filter(is_empty_list).collect();
        if !empty_lists.is_empty() {
            let names = empty_lists.iter().map(|parameter| parameter.name.clone()).collect();
            let request = DescribeParametersRequest { names };
            let answer = self.ask::<DescribeParameters>("describe_parameters", &request)?;
            for (parameter, descriptor) in empty_lists.iter_mut().zip(&answer.descriptors) {
                if descriptor.name == parameter.name
                    && descriptor.r#type >= ParameterType::PARAMETER_BYTE_ARRAY
                {
                    parameter.value.r#type = descriptor.r#type;
                }
            }
        }
        let count = parameters.len();
        let results =
            self.ask::<SetParameters>("set_parameters", &SetParametersRequest { parameters })?.results;
        ensure!(results.len() == count, "{} answered for {} of {count} parameters", self.node, results.len());
        Ok(results)
    }

    /// The same for one.
    fn set_one(&self, name: &str, value: ParameterValue) -> anyhow::Result<SetParametersResult> {
        let parameter = Parameter { name: name.to_owned(), value };
        self.set(vec![parameter])?.pop().context("there is no result")
    }
}

fn client<S: Service>(look: &Look, node: &str, service: &str) -> anyhow::Result<Client<S>> {
    Ok(look.node.client::<S>(&format!("{node}/{service}"), QosProfile::PARAMETERS)?)
}

fn has_parameters(found: &Found, node: &str) -> bool {
    let servers = found.endpoints.iter().filter(|endpoint| endpoint.kind == EndpointKind::Server);
    let mut nodes = servers.filter_map(|server| server.name.strip_suffix("/list_parameters"));
    nodes.any(|known| known == node)
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    // As `re.match` of Python: from the beginning of the name on.
    let filter = arguments.filter.as_deref().map(|filter| Regex::new(&format!("^(?:{filter})")));
    let filter = filter.transpose().context("--filter is no regular expression")?;
    let look = Look::join("param", &arguments.look, environment)?;
    let only = arguments.node.as_deref().map(absolute);
    let found = match &only {
        Some(node) => look.found_with(|found| has_parameters(found, node)),
        None => look.all(Patience::Nodes),
    };
    let mut nodes: Vec<String> =
        node_names(&found, arguments.include_hidden_nodes).into_iter().map(str::to_owned).collect();
    nodes.dedup();
    if let Some(node) = &only {
        let is_there = has_parameters(&found, node) || nodes.contains(node);
        ensure!(is_there && (arguments.include_hidden_nodes || !is_hidden_node(node)), "Node not found");
        nodes = vec![node.clone()];
    }
    // All at once: each takes a moment to be matched.
    let clients = nodes.iter().map(|node| client::<ListParameters>(&look, node, "list_parameters"));
    let clients = clients.collect::<anyhow::Result<Vec<_>>>()?;
    let with_service: Vec<_> =
        nodes.iter().zip(&clients).filter(|(node, _)| has_parameters(&found, node)).collect();
    look.wait_for(Some(PATIENCE), || with_service.iter().all(|(_, client)| client.is_available()));
    for (node, client) in nodes.iter().zip(&clients) {
        if !client.is_available() {
            println!("Wait for service timed out waiting for parameter services for node {node}");
            continue;
        }
        let request = ListParametersRequest { prefixes: arguments.param_prefixes.clone(), depth: 0 };
        let mut names = match client.call_and_wait(&request, PATIENCE) {
            Ok(answer) => answer.result.names,
            Err(error) => {
                eprintln!("Exception while calling service of node '{node}': {error}");
                continue;
            }
        };
        names.sort();
        names.retain(|name| filter.as_ref().is_none_or(|filter| filter.is_match(name)));
        print_names(&look, node, &names, arguments)?;
    }
    Ok(())
}

fn print_names(look: &Look, node: &str, names: &[String], arguments: &ListArguments) -> anyhow::Result<()> {
    if arguments.node.is_none() && !names.is_empty() {
        println!("{node}:");
    }
    if !arguments.param_type {
        names.iter().for_each(|name| println!("  {}", name));
        return Ok(());
    }
    let client = client::<DescribeParameters>(look, node, "describe_parameters")?;
    look.wait_for(Some(PATIENCE), || client.is_available());
    let request = DescribeParametersRequest { names: names.to_vec() };
    let answer = client.call_and_wait(&request, PATIENCE);
    let answer = answer.with_context(|| format!("Exception while calling service of node {node}"))?;
    for (name, descriptor) in names.iter().zip(&answer.descriptors) {
        println!("  {} (type: {})", name, type_name(descriptor.r#type));
    }
    Ok(())
}

/// What tools call a type of parameters.
fn type_name(kind: u8) -> &'static str {
    match kind {
        ParameterType::PARAMETER_BOOL => "boolean",
        ParameterType::PARAMETER_INTEGER => "integer",
        ParameterType::PARAMETER_DOUBLE => "double",
        ParameterType::PARAMETER_STRING => "string",
        ParameterType::PARAMETER_BYTE_ARRAY => "byte array",
        ParameterType::PARAMETER_BOOL_ARRAY => "boolean array",
        ParameterType::PARAMETER_INTEGER_ARRAY => "integer array",
        ParameterType::PARAMETER_DOUBLE_ARRAY => "double array",
        ParameterType::PARAMETER_STRING_ARRAY => "string array",
        _ => "not set",
    }
}

fn get(arguments: &GetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    let values = parameters.values(vec![arguments.parameter.clone()])?;
    let value = values.first().context("Parameter not set")?;
    let shown = python_value(value);
    let label = match value.r#type {
        _ if arguments.hide_type => "",
        ParameterType::PARAMETER_BOOL => "Boolean value is: ",
        ParameterType::PARAMETER_INTEGER => "Integer value is: ",
        ParameterType::PARAMETER_DOUBLE => "Double value is: ",
        ParameterType::PARAMETER_STRING => "String value is: ",
        ParameterType::PARAMETER_BYTE_ARRAY => "Byte values are: ",
        ParameterType::PARAMETER_BOOL_ARRAY => "Boolean values are: ",
        ParameterType::PARAMETER_INTEGER_ARRAY => "Integer values are: ",
        ParameterType::PARAMETER_DOUBLE_ARRAY => "Double values are: ",
        ParameterType::PARAMETER_STRING_ARRAY => "String values are: ",
        ParameterType::PARAMETER_NOT_SET => {
            println!("Parameter not set.");
            return Ok(());
        }
        other => bail!("Unknown parameter type '{other}'"),
    };
    println!("{label}{shown}");
    Ok(())
}

/// The value as `print` shows it in Python.
fn python_value(value: &ParameterValue) -> String {
    fn list<T>(values: &[T], write: impl Fn(&mut String, &T)) -> String {
        let mut out = String::from("[");
        for (index, value) in values.iter().enumerate() {
            out.push_str(if index == 0 { "" } else { ", " });
            write(&mut out, value);
        }
        out + "]"
    }
    let truth = |value: bool| if value { "True" } else { "False" };
    match value.r#type {
        ParameterType::PARAMETER_BOOL => truth(value.bool_value).to_owned(),
        ParameterType::PARAMETER_INTEGER => value.integer_value.to_string(),
        ParameterType::PARAMETER_DOUBLE => {
            let mut out = String::new();
            python::write_float(&mut out, value.double_value);
            out
        }
        ParameterType::PARAMETER_STRING => value.string_value.clone(),
        ParameterType::PARAMETER_BYTE_ARRAY => {
            list(&value.byte_array_value, |out, byte| python::write_bytes(out, &[*byte]))
        }
        ParameterType::PARAMETER_BOOL_ARRAY => {
            list(&value.bool_array_value, |out, value| out.push_str(truth(*value)))
        }
        ParameterType::PARAMETER_INTEGER_ARRAY => {
            list(&value.integer_array_value, |out, value| out.push_str(&value.to_string()))
        }
        ParameterType::PARAMETER_DOUBLE_ARRAY => {
            list(&value.double_array_value, |out, value| python::write_float(out, *value))
        }
        ParameterType::PARAMETER_STRING_ARRAY => {
            list(&value.string_array_value, |out, text| python::write_text(out, text))
        }
        _ => "None".to_owned(),
    }
}

fn set(arguments: &SetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let value = value_in(&arguments.value)?;
    let parameters = Parameters::of(&arguments.node, environment)?;
    let result = parameters.set_one(&arguments.parameter, value)?;
    print_result(&result, "Set parameter successful", "Setting parameter failed")
}

fn delete(arguments: &DeleteArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    // Of type "not set".
    let result = parameters.set_one(&arguments.parameter, ParameterValue::default())?;
    print_result(&result, "Deleted parameter successfully", "Deleting parameter failed")
}

fn print_result(result: &SetParametersResult, done: &str, failed: &str) -> anyhow::Result<()> {
    let reason = match &*result.reason {
        "" => String::new(),
        reason => format!(": {reason}"),
    };
    ensure!(result.successful, "{failed}{reason}");
    println!("{done}{reason}");
    Ok(())
}

/// The value that a text stands for, of the type that YAML gives it; other texts stand for themselves.
fn value_in(text: &str) -> anyhow::Result<ParameterValue> {
    let string = |text: &str| ParameterValue {
        r#type: ParameterType::PARAMETER_STRING,
        string_value: text.to_owned(),
        ..ParameterValue::default()
    };
    match serde_norway::from_str::<Value>(text) {
        Err(_) | Ok(Value::Null) => Ok(string(text)),
        // Words that are truth values in YAML 1.1, which ROS 2 reads.
        Ok(Value::String(word)) if word == text => Ok(match &*word.to_ascii_lowercase() {
            "yes" | "on" => bool_value(true),
            "no" | "off" => bool_value(false),
            _ => string(text),
        }),
        Ok(value) => value_of(&value),
    }
}

fn bool_value(value: bool) -> ParameterValue {
    ParameterValue { r#type: ParameterType::PARAMETER_BOOL, bool_value: value, ..ParameterValue::default() }
}

fn value_of(value: &Value) -> anyhow::Result<ParameterValue> {
    let mut message = ParameterValue::default();
    message.r#type = match value {
        Value::Bool(value) => return Ok(bool_value(*value)),
        Value::Number(number) => match number.as_i64() {
            Some(integer) => {
                message.integer_value = integer;
                ParameterType::PARAMETER_INTEGER
            }
            None if number.is_f64() => {
                message.double_value = number.as_f64().unwrap_or_default();
                ParameterType::PARAMETER_DOUBLE
            }
            None => bail!("{number} does not fit an integer of 64 bits"),
        },
        Value::String(text) => {
            message.string_value.clone_from(text);
            ParameterType::PARAMETER_STRING
        }
        Value::Sequence(values) => {
            if let Some(values) = values.iter().map(Value::as_bool).collect() {
                message.bool_array_value = values;
                ParameterType::PARAMETER_BOOL_ARRAY
            } else if let Some(values) = values.iter().map(Value::as_i64).collect() {
                message.integer_array_value = values;
                ParameterType::PARAMETER_INTEGER_ARRAY
            } else if let Some(values) = values.iter().map(Value::as_f64).collect() {
                message.double_array_value = values;
                ParameterType::PARAMETER_DOUBLE_ARRAY
            } else if let Some(texts) = values.iter().map(|text| text.as_str().map(str::to_owned)).collect() {
                message.string_array_value = texts;
                ParameterType::PARAMETER_STRING_ARRAY
            } else {
                bail!("a list has values of one type, numbers, strings or truth values");
            }
        }
        Value::Null | Value::Mapping(_) | Value::Tagged(_) => {
            bail!("a value is a number, a string, true, false, or a list of one of these")
        }
    };
    Ok(message)
}

fn describe(arguments: &DescribeArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    let request = DescribeParametersRequest { names: arguments.parameters.clone() };
    let answer = parameters.ask::<DescribeParameters>("describe_parameters", &request)?;
    answer.descriptors.iter().for_each(|descriptor| print!("{}", described(descriptor)));
    Ok(())
}

fn described(descriptor: &ParameterDescriptor) -> String {
    let mut text = format!("Parameter name: {}\n  Type: {}\n", descriptor.name, type_name(descriptor.r#type));
    // Writing to a String does not fail.
    if !descriptor.description.is_empty() {
        let _ = writeln!(text, "  Description: {}", descriptor.description);
    }
    text.push_str("  Constraints:\n");
    if descriptor.read_only {
        text.push_str("    Read only: true\n");
    }
    let float = |value: f64| {
        let mut out = String::new();
        python::write_float(&mut out, value);
        out
    };
    let floats = descriptor.floating_point_range.iter();
    let floats = floats.map(|range| {
        (float(range.from_value), float(range.to_value), (range.step != 0.0).then(|| float(range.step)))
    });
    let integers = descriptor.integer_range.iter().map(|range| {
        (
            range.from_value.to_string(),
            range.to_value.to_string(),
            (range.step != 0).then(|| range.step.to_string()),
        )
    });
    if let Some((from, to, step)) = floats.chain(integers).next() {
        let _ = writeln!(text, "    Min value: {from}\n    Max value: {to}");
        if let Some(step) = step {
            let _ = writeln!(text, "    Step: {step}");
        }
    }
    if !descriptor.additional_constraints.is_empty() {
        let _ = writeln!(text, "    Additional constraints: {}", descriptor.additional_constraints);
    }
    text
}

fn dump(arguments: &DumpArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    let request = ListParametersRequest::default();
    let mut names = parameters.ask::<ListParameters>("list_parameters", &request)?.result.names;
    names.sort();
    let values = parameters.values(names.clone())?;
    let mut tree = Tree::default();
    names.iter().zip(values).for_each(|(name, value)| tree.insert(name, value));
    println!("{}", parameter_file(&parameters.node, &tree));
    Ok(())
}

/// Parameters whose names have parts behind points.
#[derive(Default)]
struct Tree(BTreeMap<String, Branch>);

enum Branch {
    Value(ParameterValue),
    Tree(Tree),
}

/// No parameter of sense has so many parts; a deeper one stands under what is left of its name.
const DEEPEST: usize = 64;

impl Tree {
    fn insert(&mut self, name: &str, value: ParameterValue) {
        let (mut tree, mut rest) = (self, name);
        for _ in 0..DEEPEST {
            // A name that stands for a value cannot hold others: these keep their points.
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
}

/// A parameter file as PyYAML writes it.
fn parameter_file(node: &str, tree: &Tree) -> String {
    let mut out = String::new();
    write_yaml_text(&mut out, node, YamlContext::Block, 0);
    out.push_str(":\n  ros__parameters:");
    write_tree(&mut out, tree, 4);
    out
}

fn write_tree(out: &mut String, tree: &Tree, indentation: usize) {
    if tree.0.is_empty() {
        return out.push_str(" {}\n");
    }
    out.push('\n');
    for (name, branch) in &tree.0 {
        out.extend(std::iter::repeat_n(' ', indentation));
        write_yaml_text(out, name, YamlContext::Block, indentation);
        out.push(':');
        match branch {
            Branch::Tree(tree) => write_tree(out, tree, indentation + 2),
            Branch::Value(value) => write_value(out, value, indentation),
        }
    }
}

fn write_value(out: &mut String, value: &ParameterValue, indentation: usize) {
    let text = |out: &mut String, text: &str| write_yaml_text(out, text, YamlContext::Block, indentation + 2);
    match value.r#type {
        ParameterType::PARAMETER_BOOL => {
            let _ = write!(out, " {}", value.bool_value);
        }
        ParameterType::PARAMETER_INTEGER => {
            let _ = write!(out, " {}", value.integer_value);
        }
        ParameterType::PARAMETER_DOUBLE => {
            out.push(' ');
            write_yaml_float(out, value.double_value);
        }
        ParameterType::PARAMETER_STRING => {
            out.push(' ');
            text(out, &value.string_value);
        }
        ParameterType::PARAMETER_BYTE_ARRAY => {
            return write_list(out, &value.byte_array_value, indentation, |out, byte| {
                let _ = write!(out, "!!binary \"{}\"", BASE64_STANDARD.encode([*byte]));
            });
        }
        ParameterType::PARAMETER_BOOL_ARRAY => {
            return write_list(out, &value.bool_array_value, indentation, |out, value| {
                let _ = write!(out, "{value}");
            });
        }
        ParameterType::PARAMETER_INTEGER_ARRAY => {
            return write_list(out, &value.integer_array_value, indentation, |out, value| {
                let _ = write!(out, "{value}");
            });
        }
        ParameterType::PARAMETER_DOUBLE_ARRAY => {
            return write_list(out, &value.double_array_value, indentation, |out, value| {
                write_yaml_float(out, *value)
            });
        }
        ParameterType::PARAMETER_STRING_ARRAY => {
            return write_list(out, &value.string_array_value, indentation, |out, value| text(out, value));
        }
        _ => out.push_str(" null"),
    }
    out.push('\n');
}

fn write_list<T>(out: &mut String, values: &[T], indentation: usize, write: impl Fn(&mut String, &T)) {
    if values.is_empty() {
        return out.push_str(" []\n");
    }
    out.push('\n');
    for value in values {
        out.extend(std::iter::repeat_n(' ', indentation));
        out.push_str("- ");
        write(out, value);
        out.push('\n');
    }
}

fn load(arguments: &LoadArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let path = arguments.file.display();
    let text = std::fs::read_to_string(&arguments.file).with_context(|| format!("cannot read {path}"))?;
    let values = values_in(&text, !arguments.no_use_wildcard).with_context(|| format!("{path}"))?;
    let parameters = Parameters::of(&arguments.node, environment)?;
    let messages = values.iter().map(|(name, value)| Parameter { name: name.clone(), value: value.clone() });
    let results = parameters.set(messages.collect())?;
    let mut failed = 0;
    for ((name, _), result) in values.iter().zip(&results) {
        let (done, refused) =
            (format!("Set parameter {name} successful"), format!("Set parameter {name} failed"));
        if let Err(error) = print_result(result, &done, &refused) {
            eprintln!("{error}");
            failed += 1;
        }
    }
    // What a node dumps has parameters that are read-only, so that some are refused as a rule.
    ensure!(failed == 0 || failed < results.len(), "no parameter was set");
    Ok(())
}

/// The parameters of a parameter file, of whatever node; what is for all nodes comes first and is overridden.
fn values_in(text: &str, with_wildcard: bool) -> anyhow::Result<Vec<(String, ParameterValue)>> {
    const ALL: &str = "/**";
    let file: Value = serde_norway::from_str(text)?;
    let Value::Mapping(nodes) = file else { bail!("YAML file is not a valid ROS parameter file") };
    let mut chosen: Vec<_> =
        nodes.iter().filter(|(node, _)| with_wildcard || node.as_str() != Some(ALL)).collect();
    chosen.sort_by_key(|(node, _)| node.as_str() != Some(ALL));
    ensure!(!chosen.is_empty(), "Param file does not contain selected parameters");
    let mut values = Vec::new();
    for (node, parameters) in chosen {
        let invalid = || {
            let node = node.as_str().unwrap_or("?");
            anyhow!("YAML file is not a valid ROS parameter file for node {node}")
        };
        let parameters = parameters.get("ros__parameters").and_then(Value::as_mapping).ok_or_else(invalid)?;
        collect("", parameters, &mut values)?;
    }
    let mut last: Vec<(String, ParameterValue)> = Vec::new();
    for (name, value) in values {
        match last.iter_mut().find(|(known, _)| *known == name) {
            Some(known) => known.1 = value,
            None => last.push((name, value)),
        }
    }
    Ok(last)
}

fn collect(
    prefix: &str,
    parameters: &serde_norway::Mapping,
    values: &mut Vec<(String, ParameterValue)>,
) -> anyhow::Result<()> {
    for (name, value) in parameters {
        let name = name.as_str().context("a key is no name of a parameter; put it in quotes")?;
        let name = format!("{prefix}{name}");
        match value {
            Value::Mapping(inner) => collect(&format!("{name}."), inner, values)?,
            value => values.push((name.clone(), value_of(value).with_context(|| name.clone())?)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::msgs::rcl_interfaces::msg::FloatingPointRange;

    fn tree(texts: &[(&str, &str)]) -> Tree {
        let mut tree = Tree::default();
        texts.iter().for_each(|(name, text)| tree.insert(name, value_in(text).unwrap()));
        tree
    }

    /// What PyYAML writes.
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
        assert_eq!(parameter_file("/ns/robot", &tree(&texts)), expected);
        assert_eq!(parameter_file("/robot", &Tree::default()), "/robot:\n  ros__parameters: {}\n");
    }

    #[test]
    fn a_dump_is_loaded_again() {
        let texts = [("a", "1"), ("b.c", "[true, false]"), ("b.d", "text"), ("e", "[1, 2]"), ("f", "-1.5")];
        let file = parameter_file("/robot", &tree(&texts));
        let loaded = values_in(&file, true).unwrap();
        let expected: Vec<_> =
            texts.iter().map(|(name, text)| ((*name).to_owned(), value_in(text).unwrap())).collect();
        assert_eq!(loaded, expected);
    }

    #[test]
    fn what_is_for_a_node_overrides_what_is_for_all() {
        let file = "/robot:\n  ros__parameters: {a: 2}\n/**:\n  ros__parameters: {a: 1, b: 3}\n";
        let shown = |with_wildcard| -> Vec<_> {
            let values = values_in(file, with_wildcard).unwrap();
            values.iter().map(|(name, value)| format!("{name}={}", value.integer_value)).collect()
        };
        assert_eq!(shown(true), ["a=2", "b=3"]);
        assert_eq!(shown(false), ["a=2"]);
        assert!(values_in("/robot: {a: 1}\n", true).is_err());
    }

    #[test]
    fn a_value_has_the_type_that_yaml_gives_it() {
        let shown = |text: &str| {
            let value = value_in(text).unwrap();
            format!("{} {}", type_name(value.r#type), python_value(&value))
        };
        for (text, expected) in [
            ("true", "boolean True"),
            ("on", "boolean True"),
            ("3", "integer 3"),
            ("-2.50", "double -2.5"),
            ("'3'", "string 3"),
            ("a: b", "refused"),
            ("/dev/ttyUSB0", "string /dev/ttyUSB0"),
            ("[a, \"it's\"]", "string array ['a', \"it's\"]"),
            ("[1, 2]", "integer array [1, 2]"),
            ("[1.0, 2]", "double array [1.0, 2.0]"),
            ("[]", "boolean array []"),
        ] {
            match expected {
                "refused" => assert!(value_in(text).is_err(), "{text}"),
                expected => assert_eq!(shown(text), expected, "{text}"),
            }
        }
    }

    #[test]
    fn constraints_are_described() {
        let descriptor = ParameterDescriptor {
            name: "gain".into(),
            r#type: ParameterType::PARAMETER_DOUBLE,
            description: "how much".into(),
            read_only: true,
            floating_point_range: vec![FloatingPointRange { from_value: 0.0, to_value: 1.0, step: 0.5 }],
            ..ParameterDescriptor::default()
        };
        assert_eq!(
            described(&descriptor),
            "Parameter name: gain\n  Type: double\n  Description: how much\n  Constraints:\n    Read only: true\n    \
             Min value: 0.0\n    Max value: 1.0\n    Step: 0.5\n"
        );
    }
}
