//! `downbeat param`

mod file;
mod value;

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow, bail, ensure};
use clap::{Args, Subcommand};
use downbeat_bridge::expose::{parameter_value, setting_value};
use downbeat_bridge::ros::{Client, EndpointKind, Found};
use downbeat_executor::SettingValue;
use downbeat_msgs::Service;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::{
    Parameter, ParameterDescriptor, ParameterType, ParameterValue, SetParametersResult,
};
use downbeat_msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersRequest, GetParameters, GetParametersRequest, ListParameters,
    ListParametersRequest, SetParameters, SetParametersRequest,
};
use downbeat_robot::Source;
use regex_lite::Regex;

use super::network::{Environment, Look, LookArguments, Patience, absolute, is_hidden_node, node_names};
use super::values::seconds;
use file::{Loaded, Tree, values_in};
use value::{is_empty_list, label, python_float, python_value, type_name, value_in};

#[derive(Subcommand)]
pub(crate) enum ParamCommand {
    /// List the parameters of a node, or of all.
    List(ListArguments),
    /// Print the value of a parameter.
    Get(GetArguments),
    /// Set a parameter.
    Set(SetArguments),
    /// Print type, description and constraints of parameters.
    Describe(DescribeArguments),
    /// Print all parameters of a node with their values, as a parameter file.
    Dump(DumpArguments),
    /// Set the parameters of a node to the values in a parameter file.
    Load(LoadArguments),
    /// Delete a parameter.
    Delete(DeleteArguments),
}

/// Selects the node.
#[derive(Args)]
struct NodeArguments {
    /// The node.
    node: String,
    /// Also consider nodes whose name starts with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    /// Wait at most this long for the node, in seconds; default is --spin-time.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    timeout: Option<Duration>,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// The node; default is all nodes.
    node: Option<String>,
    /// Print only parameters whose name matches this regular expression at its start.
    #[arg(long, value_name = "REGEX")]
    filter: Option<String>,
    /// Also consider nodes whose name starts with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    /// Print only parameters below these prefixes.
    #[arg(long, value_name = "PREFIX", num_args = 1..)]
    param_prefixes: Vec<String>,
    /// Also print the types.
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
    /// Print only the value.
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
    /// The parameter file: values for the node are used, those under wildcards only if it declares them.
    file: PathBuf,
    /// Ignore values for all nodes, under /**.
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

/// How long a service of an existing node may take to be matched, and to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// The parameters of a node.
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

    /// `None` for parameters that are not set.
    fn values(&self, names: Vec<String>) -> anyhow::Result<Vec<Option<SettingValue>>> {
        let values = self.ask::<GetParameters>("get_parameters", &GetParametersRequest { names })?.values;
        let value = |value: ParameterValue| match value.r#type {
            ParameterType::PARAMETER_NOT_SET => Ok(None),
            _ => setting_value(value).map(Some).map_err(|problem| anyhow!(problem)),
        };
        values.into_iter().map(value).collect()
    }

    /// Sets parameters and returns the result for each. An empty list gets the type of the parameter.
    fn set(&self, values: &[(String, SettingValue)]) -> anyhow::Result<Vec<SetParametersResult>> {
        let message = |(name, value): &(String, SettingValue)| Parameter {
            name: name.clone(),
            value: parameter_value(value),
        };
        let mut parameters: Vec<Parameter> = values.iter().map(message).collect();
        let is_empty = |(_, (_, value)): &(_, &(_, SettingValue))| is_empty_list(value);
        let mut empty_lists: Vec<_> =
            parameters.iter_mut().zip(values).filter(is_empty).map(|(parameter, _)| parameter).collect();
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
        self.send(parameters)
    }

    fn send(&self, parameters: Vec<Parameter>) -> anyhow::Result<Vec<SetParametersResult>> {
        let count = parameters.len();
        let results =
            self.ask::<SetParameters>("set_parameters", &SetParametersRequest { parameters })?.results;
        ensure!(results.len() == count, "{} answered for {} of {count} parameters", self.node, results.len());
        Ok(results)
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
    // Like Python's `re.match`: anchored at the start of the name.
    let filter = arguments.filter.as_deref().map(|filter| Regex::new(&format!("^(?:{filter})")));
    let filter = filter.transpose().context("--filter is not a regular expression")?;
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
    // All in parallel, since matching takes a moment.
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

fn get(arguments: &GetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    let values = parameters.values(vec![arguments.parameter.clone()])?;
    let Some(value) = values.first().context("Parameter not set")? else {
        println!("Parameter not set.");
        return Ok(());
    };
    let label = if arguments.hide_type { "" } else { label(value) };
    println!("{label}{}", python_value(value));
    Ok(())
}

fn set(arguments: &SetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let value = value_in(&arguments.value).map_err(|problem| anyhow!(problem))?;
    let parameters = Parameters::of(&arguments.node, environment)?;
    let results = parameters.set(&[(arguments.parameter.clone(), value)])?;
    print_result(&results[0], "Set parameter successful", "Setting parameter failed")
}

fn delete(arguments: &DeleteArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    // A value of the type "not set" deletes it.
    let parameter = Parameter { name: arguments.parameter.clone(), ..Parameter::default() };
    let results = parameters.send(vec![parameter])?;
    print_result(&results[0], "Deleted parameter successfully", "Deleting parameter failed")
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

fn describe(arguments: &DescribeArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let parameters = Parameters::of(&arguments.node, environment)?;
    let request = DescribeParametersRequest { names: arguments.parameters.clone() };
    let answer = parameters.ask::<DescribeParameters>("describe_parameters", &request)?;
    answer.descriptors.iter().for_each(|descriptor| print!("{}", described(descriptor)));
    Ok(())
}

fn described(descriptor: &ParameterDescriptor) -> String {
    let mut text = format!("Parameter name: {}\n  Type: {}\n", descriptor.name, type_name(descriptor.r#type));
    // Writing to a String cannot fail.
    if !descriptor.description.is_empty() {
        let _ = writeln!(text, "  Description: {}", descriptor.description);
    }
    text.push_str("  Constraints:\n");
    if descriptor.read_only {
        text.push_str("    Read only: true\n");
    }
    let floats = descriptor.floating_point_range.iter();
    let floats = floats.map(|range| {
        (
            python_float(range.from_value),
            python_float(range.to_value),
            (range.step != 0.0).then(|| python_float(range.step)),
        )
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
    println!("{}", tree.to_file(&parameters.node));
    Ok(())
}

fn load(arguments: &LoadArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let source = Arc::new(Source::read(&arguments.file, "the parameter file")?);
    let node = absolute(&arguments.node.node);
    let loaded = values_in(&source, &node, !arguments.no_use_wildcard)?;
    let parameters = Parameters::of(&arguments.node, environment)?;
    let declared = match loaded.iter().any(|loaded| loaded.is_wildcard) {
        true => {
            parameters
                .ask::<ListParameters>("list_parameters", &ListParametersRequest::default())?
                .result
                .names
        }
        false => Vec::new(),
    };
    let declared: BTreeSet<_> = declared.into_iter().collect();
    let is_meant = |loaded: &Loaded| {
        let is_meant = !loaded.is_wildcard || declared.contains(&loaded.name);
        if !is_meant {
            tracing::debug!("{} is ignored: {node} does not declare it", loaded.name);
        }
        is_meant
    };
    let values: Vec<_> =
        loaded.into_iter().filter(is_meant).map(|Loaded { name, value, .. }| (name, value)).collect();
    let results = parameters.set(&values)?;
    let mut failed = 0;
    for ((name, _), result) in values.iter().zip(&results) {
        let (done, refused) =
            (format!("Set parameter {name} successful"), format!("Set parameter {name} failed"));
        if let Err(error) = print_result(result, &done, &refused) {
            eprintln!("{error}");
            failed += 1;
        }
    }
    // Dumps contain read-only parameters, so some are usually rejected.
    ensure!(failed == 0 || failed < results.len(), "no parameter was set");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::rcl_interfaces::msg::FloatingPointRange;

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
