//! Definitions in the schemas of a bag.

use std::collections::BTreeMap;

use downbeat_msgs_definitions::{Catalog, Error, TypeName};

use super::{DefinitionSource, Found, find_complete};
use crate::dynamic::layout::catalog_of;

/// The schemas of a bag, or of another source of complete definition texts.
///
/// Schemas are independent of each other: a bag may have been merged from bags with different definitions of
/// the same message.
#[derive(Clone, Debug, Default)]
pub struct Schemas {
    description: String,
    catalogs: BTreeMap<TypeName, Catalog>,
}

impl Schemas {
    /// Starts without schemas; `description` names their source in errors.
    #[must_use]
    pub fn new(description: &str) -> Self {
        Self { description: description.into(), catalogs: BTreeMap::new() }
    }

    /// Adds the definition text of a type; `encoding` is `ros2msg` or `ros2idl`, or `unknown` for the schema
    /// of a service's events. It replaces an existing one.
    ///
    /// # Errors
    /// If the name, the encoding or the text is invalid.
    pub fn add(&mut self, name: &str, encoding: &str, text: &str) -> Result<(), Error> {
        let name: TypeName = name.parse()?;
        let catalog = catalog_of(&name, encoding, text, &format!("{}, {name}", self.description))?;
        self.catalogs.insert(name, catalog);
        Ok(())
    }
}

impl DefinitionSource for Schemas {
    fn description(&self) -> String {
        self.description.clone()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, Error> {
        Ok(find_complete(&self.catalogs, name, "it has"))
    }
}
