//! `[[include]]` in a robot file: the modules of another one, in a namespace.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::module::{self, ModuleEntry};
use super::table::Value;
use super::{Place, RobotFile, RobotFileError, Source, suggestion};
use crate::Catalog;

type Result<T> = std::result::Result<T, RobotFileError>;

/// Reads the modules of another robot file. Their names begin with the namespace, and so do their topics and
/// services.
pub(super) fn include(value: Value<'_>, catalog: &Catalog, inside: &[PathBuf]) -> Result<Vec<ModuleEntry>> {
    let mut table = value.table("[[include]]")?;
    let file = table.require("robot")?;
    let namespace = module::namespace(table.require("namespace")?)?;
    let settings = table.take("settings");
    table.finish()?;
    let path = file.path().parent().unwrap_or(Path::new("")).join(file.text()?);
    if inside.contains(&path) {
        return Err(file.error(format!("{} includes itself", path.display())));
    }
    let source = Source::read(&path, "the robot file").map_err(|error| file.error(error.to_string()))?;
    let (included, parameter_files) = RobotFile::parse_inside(source, catalog, inside)?;
    if let Some(parameters) = parameter_files.first() {
        let problem =
            "an included robot file has no \"params\"; give the settings in [[module]] or [[include]]";
        return Err(included.source.error(parameters.line, problem));
    }
    let (source, mut modules) = (Arc::new(included.source), included.modules);
    if let Some(settings) = settings {
        for (name, given) in settings.table("settings")?.take_rest() {
            let known: BTreeSet<&str> = modules.iter().map(|module| module.name.as_str()).collect();
            let Some(position) = modules.iter().position(|module| module.name == name) else {
                let hint = suggestion(&name, known);
                return Err(given.error(format!("{} has no module \"{name}\"{hint}", path.display())));
            };
            let module = &mut modules[position];
            module.place_in(&source);
            let given = module::settings(Some(given), &module.kind)?;
            module.settings.extend(given);
        }
    }
    for module in &mut modules {
        module.place_in(&source);
        module.name = format!("{namespace}/{}", module.name);
        module.source.module.clone_from(&module.name);
        let inner = std::mem::take(&mut module.running.namespace);
        module.running.namespace =
            if inner.is_empty() { namespace.clone() } else { format!("{namespace}/{inner}") };
    }
    Ok(modules)
}

impl ModuleEntry {
    /// Says that the lines of the module are those of an included file, unless that was said.
    fn place_in(&mut self, source: &Arc<Source>) {
        if self.included.is_some() {
            return;
        }
        for given in self.settings.values_mut() {
            if let Place::Line(line) = given.place {
                given.place = Place::Included(Arc::clone(source), line);
            }
        }
        self.included = Some(Arc::clone(source));
    }
}
