//! Definitions in folders of the user.

use std::path::Path;

use downbeat_msgs_definitions::{Catalog, Error, Kind, TypeName};

use super::{DefinitionSource, Found, instead};
use crate::carried;

/// The interfaces in folders: of packages, of workspaces, of ament prefixes. They may refer to each other and
/// to the built-in ones.
#[derive(Clone, Debug)]
pub struct InterfaceFolders {
    folders: Vec<String>,
    /// With the built-in interfaces.
    catalog: Catalog,
}

impl InterfaceFolders {
    /// Starts without folders.
    #[must_use]
    pub fn new() -> Self {
        Self { folders: Vec::new(), catalog: carried().clone() }
    }

    /// Adds the interfaces in a folder, see [`Catalog::add_folder`].
    ///
    /// # Errors
    /// Returns an error if it has none, has two packages of one name, or one of its files is invalid or
    /// defines something that is already defined, differently. Nothing is then added.
    pub fn add(&mut self, folder: &Path) -> Result<(), Error> {
        let mut catalog = self.catalog.clone();
        catalog.add_folder(folder)?;
        self.catalog = catalog;
        self.folders.push(folder.display().to_string());
        Ok(())
    }
}

impl Default for InterfaceFolders {
    fn default() -> Self {
        Self::new()
    }
}

impl DefinitionSource for InterfaceFolders {
    fn description(&self) -> String {
        self.folders.join(", ")
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, Error> {
        if self.catalog.message(name).is_ok() {
            if self.catalog.missing_for(name).is_empty() {
                return Ok(Found::Complete(&self.catalog));
            }
            // What it refers to may be installed. A part comes with the whole.
            let stem = match name.kind {
                Kind::Message => name.name.as_str(),
                _ => name.name.split('_').next().unwrap_or_default(),
            };
            let mut alone = Catalog::new();
            alone.add_alone_from(&self.catalog, &TypeName::new(&name.package, name.kind, stem))?;
            return Ok(Found::Alone(Box::new(alone)));
        }
        Ok(Found::Nothing(instead("it has", [&self.catalog].into_iter(), name)))
    }
}
