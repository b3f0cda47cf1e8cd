//! The interfaces that commands can use.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};

use super::packages::{ament_packages, packages_at};
use super::{Registered, SourceArguments, TypeArguments};
use downbeat_msgs::definitions::{
    ActionDefinition, Catalog, DefinitionEncoding, Kind, MessageDefinition, ServiceDefinition, TypeName,
    nearest,
};

/// Definitions from --from, AMENT_PREFIX_PATH and this program (built-in and registered), in this order: as
/// with ament overlays, a package is taken completely from the first source that has it.
pub(crate) struct Interfaces {
    pub(crate) catalog: Catalog,
}

/// The definition of a name.
#[derive(Clone, Copy)]
pub(crate) enum Definition<'a> {
    Message(&'a MessageDefinition),
    Service(&'a ServiceDefinition),
    Action(&'a ActionDefinition),
}

impl Interfaces {
    /// # Errors
    /// Returns an error if a source of --from has no packages or an invalid definition. An invalid package in
    /// AMENT_PREFIX_PATH is skipped with a warning, since it may be unrelated to the request.
    pub(crate) fn load(source: &SourceArguments, registered: &Registered) -> anyhow::Result<Self> {
        let mut catalog = Catalog::new();
        let mut places = BTreeMap::<String, PathBuf>::new();
        for path in &source.from {
            for folder in packages_at(path)? {
                let package = Catalog::package_name(&folder);
                match places.get(&package) {
                    Some(first) => warn_of_two(&package, first, &folder),
                    None => {
                        catalog.add_package(&folder)?;
                        places.insert(package, folder);
                    }
                }
            }
        }
        for folder in ament_packages().context("AMENT_PREFIX_PATH")? {
            let package = Catalog::package_name(&folder);
            if let Some(first) = places.get(&package) {
                // An overlay, unless both define the same.
                if definitions_in(first) != definitions_in(&folder) {
                    warn_of_two(&package, first, &folder);
                }
                continue;
            }
            // Parsed separately first, so that an invalid package leaves nothing behind.
            match Catalog::new().add_package(&folder) {
                Ok(_) => {
                    catalog.add_package(&folder)?;
                    places.insert(package, folder);
                }
                Err(error) => tracing::warn!("skipped the package {}: {error}", folder.display()),
            }
        }
        let taken: BTreeSet<String> = places.into_keys().collect();
        add(&mut catalog, downbeat_msgs::carried(), &taken, CARRIED)?;
        for described in registered.registered() {
            let (name, mut definition) = (described.type_name.parse()?, Catalog::new());
            definition.add_definition_text(
                &name,
                DefinitionEncoding::Ros2Msg,
                described.definition,
                REGISTERED,
            )?;
            add(&mut catalog, &definition, &taken, REGISTERED)?;
        }
        Ok(Self { catalog })
    }

    /// The definition of that name.
    ///
    /// # Errors
    /// Returns an error if there is none; suggests the nearest name.
    pub(crate) fn find(&self, name: &TypeName) -> anyhow::Result<Definition<'_>> {
        let catalog = &self.catalog;
        let message = || catalog.message(name).map(Definition::Message);
        let found = match name.kind {
            Kind::Message => message(),
            Kind::Service => catalog.service(name).map(Definition::Service).or_else(|_| message()),
            Kind::Action => catalog
                .action(name)
                .map(Definition::Action)
                .or_else(|_| catalog.service(name).map(Definition::Service))
                .or_else(|_| message()),
        };
        found.map_err(|_| self.unknown(&name.to_string()))
    }

    /// The types selected by the arguments.
    ///
    /// # Errors
    /// Returns an error with the nearest name if a type does not exist.
    pub(super) fn chosen(&self, arguments: &TypeArguments) -> anyhow::Result<Vec<TypeName>> {
        match arguments.name.as_deref() {
            None => Ok(self.names()),
            Some("-") => Ok(vec![self.named(&name_from_standard_input()?)?]),
            Some(name) => Ok(vec![self.named(name)?]),
        }
    }

    /// The sorted names of all definitions, including parts of services and actions.
    pub(super) fn names(&self) -> Vec<TypeName> {
        let mut names: Vec<TypeName> = self.catalog.messages().map(|message| message.name.clone()).collect();
        names.extend(self.catalog.services().map(|service| service.name.clone()));
        names.extend(self.catalog.actions().map(|action| action.name.clone()));
        names.sort_by_cached_key(TypeName::to_string);
        names
    }

    /// Returns whether a name is that of a file rather than a part of a service or action.
    pub(super) fn is_whole(&self, name: &TypeName) -> bool {
        match name.kind {
            Kind::Message => true,
            Kind::Service => self.catalog.service(name).is_ok(),
            Kind::Action => self.catalog.action(name).is_ok(),
        }
    }

    /// # Errors
    /// Returns an error if no package of that name has interfaces; suggests the nearest name.
    pub(super) fn check_package(&self, package: &str) -> anyhow::Result<()> {
        let packages = self.catalog.packages();
        if packages.contains(&package) {
            return Ok(());
        }
        let hint = hint(nearest(package, packages));
        bail!("no package \"{package}\" with interfaces is known{hint}")
    }

    /// Parses a name, if there is a definition for it.
    ///
    /// # Errors
    /// Returns an error if there is none; suggests the nearest name.
    pub(super) fn named(&self, text: &str) -> anyhow::Result<TypeName> {
        let name: TypeName = text.parse().map_err(|_| self.unknown(text))?;
        self.find(&name).map(|_| name)
    }

    fn unknown(&self, text: &str) -> anyhow::Error {
        let names = self.names();
        let is_known = |package: &str| names.iter().any(|name| name.package == package);
        let place = match text.split_once('/') {
            Some((package, _)) if !is_known(package) => {
                format!(" (nor any other of the package \"{package}\": set its location with --from)")
            }
            _ => String::new(),
        };
        let hint = hint(nearest(text, &names));
        anyhow!("no interface \"{text}\" is known{place}{hint}")
    }
}

impl<'a> Definition<'a> {
    /// The text of the file, or of the part of it.
    pub(super) fn text(self) -> &'a str {
        match self {
            Self::Message(message) => &message.text,
            Self::Service(service) => &service.text,
            Self::Action(action) => &action.text,
        }
    }

    /// The parts of the file between its lines `---`.
    pub(super) fn parts(self) -> Vec<&'a MessageDefinition> {
        match self {
            Self::Message(message) => vec![message],
            Self::Service(service) => vec![&service.request, &service.response],
            Self::Action(action) => vec![&action.goal, &action.result, &action.feedback],
        }
    }

    /// The name of the file.
    pub(super) fn origin(self) -> &'a str {
        match self {
            Self::Message(message) => &message.origin,
            Self::Service(service) => &service.origin,
            Self::Action(action) => &action.origin,
        }
    }
}

/// The origin of built-in definitions.
const CARRIED: &str = "downbeat";

/// The origin of definitions registered by this program.
const REGISTERED: &str = "this program";

/// Adds missing definitions, of packages that are not taken from another source.
fn add(
    catalog: &mut Catalog,
    definitions: &Catalog,
    taken: &BTreeSet<String>,
    origin: &str,
) -> anyhow::Result<()> {
    for MessageDefinition { name, text, .. } in definitions.messages() {
        let is_own = name.kind == Kind::Message && !taken.contains(&name.package);
        if is_own && catalog.message(name).is_err() {
            catalog.add_message(name.clone(), text, origin)?;
        }
    }
    for ServiceDefinition { name, text, .. } in definitions.services() {
        let is_own = name.kind == Kind::Service && !taken.contains(&name.package);
        if is_own && catalog.service(name).is_err() {
            catalog.add_service(name.clone(), text, origin)?;
        }
    }
    for ActionDefinition { name, text, .. } in definitions.actions() {
        if !taken.contains(&name.package) && catalog.action(name).is_err() {
            catalog.add_action(name.clone(), text, origin)?;
        }
    }
    Ok(())
}

/// Two sources have a package of one name.
fn warn_of_two(package: &str, taken: &Path, left_out: &Path) {
    tracing::warn!(
        "there are two packages named {package}: that in {} is used, and that in {}, which comes later, is not",
        taken.display(),
        left_out.display()
    );
}

/// The names and texts of the definitions in a package; `None` if one of them is invalid.
fn definitions_in(folder: &Path) -> Option<BTreeMap<String, String>> {
    let mut catalog = Catalog::new();
    catalog.add_package(folder).ok()?;
    Some(catalog.messages().map(|message| (message.name.to_string(), message.text.clone())).collect())
}

fn hint(nearest: Option<impl Display>) -> String {
    nearest.map(|nearest| format!(", did you mean \"{nearest}\"?")).unwrap_or_default()
}

/// Reads a name, as in `ros2 topic type /chatter | ros2 interface show -`.
fn name_from_standard_input() -> anyhow::Result<String> {
    let input = std::io::stdin();
    if input.is_terminal() {
        bail!("`-` reads the name of the type from a pipe, but standard input is a terminal");
    }
    let mut line = String::new();
    input.read_line(&mut line).context("cannot read the name of the type from standard input")?;
    match line.trim() {
        "" => bail!("expected the name of a type on standard input, found nothing"),
        name => Ok(name.to_owned()),
    }
}
