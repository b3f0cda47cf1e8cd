//! Rust source for the interfaces of a catalog.
//!
//! One text per package, to be included in a module with the package's name. It contains modules `msg`, `srv`
//! and `action` with one struct per message and the implementations of the traits of `downbeat-msgs`. Names
//! within it are chosen so that no ROS 2 type name (`String`, `Error`, `Message`) can shadow names that the
//! code uses.

mod cdr;
mod description;
mod docs;
#[doc(hidden)]
pub mod generated;
mod layout;
mod message;
mod names;
mod service;
mod values;
mod view;

use std::collections::BTreeMap;

use downbeat_msgs_definitions::{Catalog, Error, Kind, MessageDefinition, TypeName};

/// The paths that generated code refers to.
#[derive(Clone, Debug)]
pub struct Modules {
    runtime: String,
    home: String,
    elsewhere: BTreeMap<String, String>,
}

impl Modules {
    /// `runtime` is the path of the crate with the traits and CDR: `::downbeat_msgs`, or `crate` within it.
    /// `home` is the path of the module that will hold the generated packages: `crate`, `crate::interfaces`.
    #[must_use]
    pub fn new(runtime: &str, home: &str) -> Self {
        Self { runtime: runtime.into(), home: home.into(), elsewhere: BTreeMap::new() }
    }

    /// Packages that are not generated because the module at `path` contains them.
    #[must_use]
    pub fn with_packages<'a>(mut self, path: &str, packages: impl IntoIterator<Item = &'a str>) -> Self {
        self.elsewhere.extend(packages.into_iter().map(|package| (package.to_owned(), path.to_owned())));
        self
    }

    fn of(&self, package: &str) -> &str {
        self.elsewhere.get(package).unwrap_or(&self.home)
    }
}

/// Writes Rust source.
#[derive(Clone, Copy, Debug)]
pub struct RustSource<'a> {
    catalog: &'a Catalog,
    modules: &'a Modules,
}

impl<'a> RustSource<'a> {
    /// For a [checked](Catalog::check) catalog.
    #[must_use]
    pub fn new(catalog: &'a Catalog, modules: &'a Modules) -> Self {
        Self { catalog, modules }
    }

    /// The module of one package.
    ///
    /// # Errors
    /// See [`RustSource::package`].
    pub fn module(&self, package: &str) -> Result<String, Error> {
        let content = indent(&self.package(package)?);
        let name = names::identifier(package);
        Ok(format!(
            "/// Interfaces of the package `{package}`.\n#[allow(clippy::all)]\npub mod {name} {{{content}}}\n"
        ))
    }

    /// The content of the module of one package.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] if a message refers to one that is not in the catalog.
    pub fn package(&self, package: &str) -> Result<String, Error> {
        let mut source = String::new();
        for (kind, what) in
            [(Kind::Message, "Messages"), (Kind::Service, "Services"), (Kind::Action, "Actions")]
        {
            let is_here = |name: &TypeName| name.package == package && name.kind == kind;
            let messages: Vec<&MessageDefinition> =
                self.catalog.messages().filter(|message| is_here(&message.name)).collect();
            if messages.is_empty() {
                continue;
            }
            if !source.is_empty() {
                source.push('\n');
            }
            let module = kind.as_str();
            source.push_str(&format!("/// {what} of the package `{package}`.\npub mod {module} {{\n"));
            source.push_str(&format!("    use {}::{{cdr, description, serde}};\n", self.modules.runtime));
            for action in self.catalog.actions().filter(|action| is_here(&action.name)) {
                source.push_str(&indent(&self.action(action)?));
            }
            for service in self.catalog.services().filter(|service| is_here(&service.name)) {
                source.push_str(&indent(&self.service(service)?));
            }
            for message in &messages {
                source.push_str(&indent(&self.message(message)?));
            }
            source.push_str(&indent(&self.views(&messages)?));
            source.push_str("}\n");
        }
        Ok(source)
    }
}

/// Indents code, but not the lines of raw strings.
fn indent(source: &str) -> String {
    let mut indented = String::from("\n");
    let mut within_raw_string: Option<String> = None;
    for line in source.lines() {
        match &within_raw_string {
            Some(end) => {
                indented.push_str(line);
                if line.ends_with(end.as_str()) {
                    within_raw_string = None;
                }
            }
            None => {
                if !line.is_empty() {
                    indented.push_str("    ");
                }
                indented.push_str(line);
                within_raw_string = values::opens_raw_string(line);
            }
        }
        indented.push('\n');
    }
    indented
}
