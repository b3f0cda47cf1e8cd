//! Settings from ROS 2 parameters: `--params-file`, `-p`, and back.

mod dump;
mod file;
mod scalar;

use std::path::Path;
use std::sync::Arc;

use downbeat_executor::SettingValue;
use serde_norway::Value;

use super::file::{Given, ParameterPlace, Place, Source, suggestion};
use super::{ClockChoice, RobotFile, RobotFileError};
use crate::file::list_of;
pub use file::{NodeParameter, is_wildcard, matches, parameters_of_nodes};
pub use scalar::values_in as yaml_values;

type Result<T, E = RobotFileError> = std::result::Result<T, E>;

/// Parameters of every ROS 2 node that do not set modules.
const OF_EVERY_NODE: [&str; 3] = ["use_sim_time", "start_type_description_service", "qos_overrides"];

impl RobotFile {
    /// Sets settings to the values in a ROS 2 parameter file for the robot's node. They override earlier
    /// values. The parameter `module.setting`, also written as a map of settings under `module`, is a
    /// module's setting.
    ///
    /// Node names and wildcards are matched as in rcl: `node` and `/ns/node` by name, `*` for one part of the
    /// name, `/**` for any number of them. A file without values for this node changes nothing and is
    /// reported with a warning.
    ///
    /// # Errors
    /// Returns an error with path and line if the file cannot be read or is not a parameter file, or names a
    /// module that the robot does not have. Settings and their types are checked by [`RobotFile::build`].
    pub fn set_from_parameter_file(&mut self, path: &Path) -> Result<()> {
        let source = Arc::new(Source::read(path, "the parameter file")?);
        self.set_from_parameters(&source)
    }

    /// Sets a setting from an argument in the form of `ros2 run -p`: `module.setting:=value`, with the value
    /// in YAML.
    ///
    /// # Errors
    /// Returns an error if the argument does not have this form, or names a module that the robot does not
    /// have.
    pub fn set_from_argument(&mut self, argument: &str) -> Result<()> {
        let place = Place::Argument(argument.to_owned());
        let Some((name, text)) = argument.split_once(":=") else {
            return Err(self.error_at(&place, "expected module.setting:=value"));
        };
        let value = yaml_values(text).map_err(|error| error.to_string());
        let value = value.and_then(|value| setting_value(&value));
        let value = value.map_err(|problem| self.error_at(&place, problem))?;
        self.set(name.trim(), value, place, false)
    }

    /// Applies `module.setting=value`, or `setting=value` of the only module for which `has_setting` is true,
    /// or `module=file`: another version of the file of a module in another language.
    ///
    /// # Errors
    /// Returns an error if the module, the setting or the file does not exist.
    pub fn change(&mut self, change: &str, has_setting: impl Fn(&str, &str) -> bool) -> Result<()> {
        let place = Place::Argument(change.to_owned());
        let Some((name, value)) = change.split_once('=') else {
            return Err(self.error_at(&place, "expected module.setting=value, setting=value or module=file"));
        };
        let (name, value) = (name.trim_end_matches(':').trim(), value.trim());
        if let Some(module) = self.modules.iter_mut().find(|module| module.name == name) {
            let file = Path::new(value);
            let replaced = module.kind.source_files(&module.source).into_iter().next();
            let problem = match replaced {
                Some(_) if !file.is_file() => format!("there is no file {value}"),
                Some(replaced) => {
                    module.source.replaced.insert(replaced, file.to_owned());
                    return Ok(());
                }
                None => format!("\"{name}\" is compiled into the program; a setting is named {name}.setting"),
            };
            return Err(self.error_at(&place, problem));
        }
        let name = if name.contains('.') {
            name.to_owned()
        } else {
            let with_it = self.modules.iter().filter(|module| has_setting(&module.name, name));
            match with_it.map(|module| module.name.as_str()).collect::<Vec<_>>().as_slice() {
                [module] => format!("{module}.{name}"),
                [] => {
                    let names = self.modules.iter().map(|module| module.name.as_str());
                    let hint = suggestion(name, names);
                    let problem = format!("no module is named \"{name}\" or has such a setting{hint}");
                    return Err(self.error_at(&place, problem));
                }
                several => {
                    let problem = format!("{} have \"{name}\"; write module.{name}", several.join(" and "));
                    return Err(self.error_at(&place, problem));
                }
            }
        };
        self.set_from_argument(&format!("{name}:={value}"))
    }

    pub(crate) fn set_from_parameters(&mut self, source: &Arc<Source>) -> Result<()> {
        let node = self.node_name()?.to_string();
        let nodes = parameters_of_nodes(source)?;
        let mut is_for_us = false;
        for (pattern, parameters) in nodes.iter().filter(|(pattern, _)| matches(pattern, &node)) {
            is_for_us = true;
            let is_wildcard = is_wildcard(pattern);
            for NodeParameter { name, value, keys, .. } in parameters {
                let place = ParameterPlace { source: Arc::clone(source), keys: keys.clone() };
                let value = value.clone().map_err(|problem| place.error(problem));
                let first = name.split('.').next().unwrap_or_default();
                if first != "use_sim_time"
                    && OF_EVERY_NODE.contains(&first)
                    && !self.modules.iter().any(|module| module.name == first)
                {
                    tracing::warn!(
                        "{}",
                        place.error(format!("\"{name}\" has no effect on a robot's modules"))
                    );
                    continue;
                }
                if is_wildcard && !self.has_module_of(name) {
                    tracing::debug!(
                        "{}",
                        place.error(format!("\"{name}\" is ignored: no module declares it"))
                    );
                    continue;
                }
                self.set(name, value?, Place::Parameter(place), is_wildcard)?;
            }
        }
        if !is_for_us {
            let names: Vec<_> = nodes.iter().map(|(name, _)| name.as_str()).collect();
            let names = if names.is_empty() { "no node".into() } else { names.join(", ") };
            let path = source.path().display();
            tracing::warn!("{path}: nothing in it applies to the node {node}; it is for {names}");
        }
        Ok(())
    }

    /// Whether a parameter of this name can be a setting of a module, or of every node.
    fn has_module_of(&self, parameter: &str) -> bool {
        let module = parameter.split_once('.').map(|(module, _)| module);
        parameter == "use_sim_time"
            || module.is_some_and(|name| self.modules.iter().any(|module| module.name == name))
    }

    /// With `is_wildcard`, the module may have no such setting.
    fn set(&mut self, parameter: &str, value: SettingValue, place: Place, is_wildcard: bool) -> Result<()> {
        if parameter == "use_sim_time" {
            return self.use_sim_time(&value, &place);
        }
        let names = || self.modules.iter().map(|module| module.name.as_str());
        let (module, setting) = parameter.split_once('.').unwrap_or((parameter, ""));
        let Some(position) = names().position(|name| name == module) else {
            let hint = with_slashes(parameter, names())
                .or_else(|| of_namespace(module, setting, names()))
                .unwrap_or_else(|| suggestion(module, names()));
            return Err(self.error_at(&place, format!("the robot has no module \"{module}\"{hint}")));
        };
        if setting.is_empty() {
            let problem = format!("\"{parameter}\" is a module; a parameter is named {module}.setting");
            return Err(self.error_at(&place, problem));
        }
        self.modules[position].settings.insert(setting.to_owned(), Given { place, value, is_wildcard });
        Ok(())
    }
}

impl RobotFile {
    /// Handles the parameter `use_sim_time` of every ROS 2 node, which selects the time of `/clock`.
    fn use_sim_time(&mut self, value: &SettingValue, place: &Place) -> Result<()> {
        let clock = &mut self.expose.features.clock;
        match value {
            SettingValue::Bool(true) => *clock = ClockChoice::Follow,
            SettingValue::Bool(false) if *clock == ClockChoice::Follow => *clock = ClockChoice::Own,
            SettingValue::Bool(false) => {}
            other => {
                return Err(
                    self.error_at(place, format!("use_sim_time: expected true or false, found {other}"))
                );
            }
        }
        Ok(())
    }
}

/// Suggests the name of a parameter in which dots were written for the slashes in the name of its module.
fn with_slashes<'a>(parameter: &str, modules: impl Iterator<Item = &'a str>) -> Option<String> {
    let spelled = modules.filter_map(|module| {
        let rest = parameter.strip_prefix(&module.replace('/', "."))?;
        let is_its = module.contains('/') && (rest.is_empty() || rest.starts_with('.'));
        is_its.then_some((module, if rest.is_empty() { ".setting" } else { rest }))
    });
    let (module, rest) = spelled.max_by_key(|(module, _)| module.len())?;
    let namespace = module.rsplit_once('/').map_or("", |(namespace, _)| namespace);
    Some(format!(
        ", did you mean \"{module}{rest}\"? Modules in the namespace {namespace} are named {namespace}/module"
    ))
}

/// Explains a name that has a namespace in place of a module, before the setting.
fn of_namespace<'a>(
    namespace: &str,
    setting: &str,
    modules: impl Iterator<Item = &'a str>,
) -> Option<String> {
    let is_inside = |name: &&str| name.strip_prefix(namespace).is_some_and(|name| name.starts_with('/'));
    let inside: Vec<_> = modules.filter(is_inside).collect();
    let setting = if setting.is_empty() { "setting" } else { setting };
    (!inside.is_empty() && !setting.contains('.')).then(|| {
        let inside = inside.join(", ");
        format!(
            ": it is a namespace, so write {namespace}/module.{setting} with one of its modules: {inside}"
        )
    })
}

/// Converts a value to that of a setting. Errors contain what was expected and found.
pub fn setting_value(value: &Value) -> Result<SettingValue, String> {
    match value {
        Value::Bool(value) => Ok(SettingValue::Bool(*value)),
        Value::String(text) => Ok(SettingValue::Text(text.clone())),
        Value::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(integer), _) => Ok(SettingValue::Integer(integer)),
            (None, Some(double)) if number.is_f64() => Ok(SettingValue::Double(double)),
            _ => Err(format!("{number} does not fit into a whole number of 64 bits")),
        },
        Value::Sequence(elements) => {
            let values = elements.iter().map(setting_value).collect::<Result<Vec<_>, _>>()?;
            list_of(values)
                .ok_or_else(|| "expected a list of numbers only, of texts only, or of booleans only".into())
        }
        Value::Null => Err(expected("nothing")),
        Value::Mapping(_) => Err(expected("a map")),
        Value::Tagged(tagged) if tagged.tag == scalar::NULL_WORD => setting_value(&tagged.value),
        Value::Tagged(_) => Err(expected("a value with a tag")),
    }
}

fn expected(found: &str) -> String {
    format!("expected true, false, a number, text, or a list of one of these; found {found}")
}

#[cfg(test)]
mod tests;
