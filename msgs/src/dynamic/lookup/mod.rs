//! Looking up the definition of a type by its name.

mod ament;
mod described;
mod folders;
mod recorded;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use downbeat_msgs_definitions::{Catalog, Element, Error as DefinitionError, Kind, TypeName, nearest};

use super::{DynamicType, TypeError};
use crate::carried;
pub use ament::AmentPrefixPath;
pub use described::{DescribedTypes, Schemas};
pub use folders::InterfaceFolders;
pub use recorded::RecordedDefinition;

/// Sources of definitions, searched in the order in which they were added.
///
/// ```
/// use downbeat_msgs::dynamic::{Definitions, Schemas};
///
/// let mut schemas = Schemas::new("walk.mcap");
/// schemas.add("legs/msg/Leg", "ros2msg", "float64[] angles\n")?;
/// let definitions = Definitions::new().with(schemas).with_carried();
///
/// assert_eq!(definitions.find("legs/msg/Leg")?.fields().count(), 1);
/// assert_eq!(definitions.find("std_msgs/msg/Header")?.fields().count(), 2);
/// assert_eq!(
///     definitions.find("legs/msg/Knee").unwrap_err().to_string(),
///     "found no definition of legs/msg/Knee. Looked in walk.mcap: it has legs/msg/Leg of that package; in the \
///      built-in interfaces: they have nothing of that package"
/// );
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// References are resolved in the same order, except in sources whose definitions are complete, such as bags:
/// then all referenced definitions come from that source.
#[derive(Default)]
pub struct Definitions {
    sources: Vec<Box<dyn DefinitionSource>>,
}

/// A type, with the definition text and hash that bags store.
#[derive(Clone, Debug)]
pub struct TypeDefinition {
    /// The type.
    pub message_type: DynamicType,
    /// The `ros2msg` text with all dependencies, as rosbag2 stores it.
    pub text: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub hash: String,
}

/// A message, service or action, from [`Definitions::find_interface`].
#[derive(Clone, Debug)]
pub struct InterfaceDefinition {
    /// Its name.
    pub name: TypeName,
    /// The definition text with all dependencies, as rosbag2 stores it.
    pub text: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub hash: String,
    /// The definition, and all that it refers to, perhaps with others.
    pub catalog: Catalog,
    /// The source that has it.
    pub place: String,
}

impl InterfaceDefinition {
    /// The hash and the definition text of the interface, one of its parts or a type that it refers to.
    ///
    /// # Errors
    /// Returns an error if there is no such part.
    pub fn described(&self, name: &str) -> Result<(String, String), TypeLookupError> {
        let name: TypeName = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        let unusable = |problem: DefinitionError| unusable(&name, &self.place, problem.into());
        let hash = self.catalog.type_hash(&name).map_err(unusable)?;
        Ok((hash, self.catalog.definition_text(&name).map_err(unusable)?))
    }

    /// One of its messages, or a message that it refers to.
    ///
    /// # Errors
    /// Returns an error if there is no such part, or it cannot be used.
    pub fn message(&self, name: &str) -> Result<TypeDefinition, TypeLookupError> {
        let name: TypeName = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        let unusable = |problem: TypeError| unusable(&name, &self.place, problem);
        Ok(TypeDefinition {
            message_type: DynamicType::new(&self.catalog, &name).map_err(unusable)?,
            text: self.catalog.definition_text(&name).map_err(|error| unusable(error.into()))?,
            hash: self.catalog.type_hash(&name).map_err(|error| unusable(error.into()))?,
        })
    }
}

/// A source of definitions.
pub trait DefinitionSource: Send + Sync {
    /// Its name in errors: `walk.mcap`.
    fn description(&self) -> String;

    /// Looks up one type.
    ///
    /// # Errors
    /// Returns an error if there is a definition but it cannot be read. Then no other source is searched.
    fn find(&self, name: &TypeName) -> Result<Found<'_>, DefinitionError>;
}

impl<S: DefinitionSource + ?Sized> DefinitionSource for Arc<S> {
    fn description(&self) -> String {
        (**self).description()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, DefinitionError> {
        (**self).find(name)
    }
}

/// The result of searching a [`DefinitionSource`].
#[derive(Debug)]
pub enum Found<'a> {
    /// The definition and all definitions it refers to.
    Complete(&'a Catalog),
    /// The definition alone, or the service or action the message belongs to.
    Alone(Box<Catalog>),
    /// Nothing; the text describes what the source has instead, as the end of a sentence.
    Nothing(String),
}

/// Why a type was not found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TypeLookupError {
    /// No source has it.
    #[error("found no definition of {name}{}. Looked {}", needed_by(owner.as_deref()), looked.join("; "))]
    NotFound {
        /// The type that was not found.
        name: Box<TypeName>,
        /// The message with a field of this type, if it is not the requested type.
        owner: Option<Box<TypeName>>,
        /// The searched sources and what they contain.
        looked: Vec<String>,
    },
    /// A source has it, but it cannot be used.
    #[error("cannot use the definition of {name} from {place}: {problem}")]
    Unusable {
        /// The type.
        name: Box<TypeName>,
        /// The source.
        place: String,
        /// The reason.
        problem: Box<TypeError>,
    },
    /// The name is invalid.
    #[error(transparent)]
    Name(Box<DefinitionError>),
}

impl Definitions {
    /// Starts without sources.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Searches the interfaces built into this crate, then those installed below the prefixes in
    /// `AMENT_PREFIX_PATH`.
    #[must_use]
    pub fn from_environment() -> Self {
        Self::new().with_carried().with(AmentPrefixPath::from_environment())
    }

    /// Adds a source, which is searched if those before it do not have a type.
    #[must_use]
    pub fn with(mut self, source: impl DefinitionSource + 'static) -> Self {
        self.sources.push(Box::new(source));
        self
    }

    /// Adds the interfaces built into this crate.
    #[must_use]
    pub fn with_carried(self) -> Self {
        self.with(Carried)
    }

    /// Returns the type of that name: a message, possibly one of a service or an action. Keep it: each lookup
    /// compiles the type again.
    ///
    /// # Errors
    /// Returns an error if no source has it or a type it refers to; the error lists what was found where.
    /// Also if it cannot be used.
    pub fn find(&self, name: &str) -> Result<DynamicType, TypeLookupError> {
        let (name, place, catalog) = self.gather(name)?;
        DynamicType::new(&catalog, &name).map_err(|problem| unusable(&name, &place, problem))
    }

    /// The definition text of the type of that name, as stored in bags, and its RIHS01 hash.
    ///
    /// ```
    /// use downbeat_msgs::Message;
    /// use downbeat_msgs::dynamic::Definitions;
    /// use downbeat_msgs::std_msgs::msg::Header;
    ///
    /// let (text, hash) = Definitions::new().with_carried().find_text("std_msgs/msg/Header")?;
    /// assert_eq!((text.as_str(), hash.as_str()), (Header::DEFINITION, Header::TYPE_HASH));
    /// # Ok::<(), downbeat_msgs::dynamic::TypeLookupError>(())
    /// ```
    ///
    /// # Errors
    /// See [`Definitions::find`].
    pub fn find_text(&self, name: &str) -> Result<(String, String), TypeLookupError> {
        let (name, place, catalog) = self.gather(name)?;
        let unusable = |problem: DefinitionError| unusable(&name, &place, problem.into());
        let text = catalog.definition_text(&name).map_err(unusable)?;
        Ok((text, catalog.type_description(&name).map_err(unusable)?.hash()))
    }

    /// The type of that name with its definition text as stored in bags and its hash.
    ///
    /// # Errors
    /// See [`Definitions::find`].
    pub fn describe(&self, name: &str) -> Result<TypeDefinition, TypeLookupError> {
        let message_type = self.find(name)?;
        let (text, hash) = self.find_text(name)?;
        Ok(TypeDefinition { message_type, text, hash })
    }

    /// The message, service or action of that name, with everything that it refers to.
    ///
    /// ```
    /// use downbeat_msgs::Service;
    /// use downbeat_msgs::dynamic::Definitions;
    /// use downbeat_msgs::std_srvs::srv::SetBool;
    ///
    /// let found = Definitions::new().with_carried().find_interface("std_srvs/srv/SetBool")?;
    /// assert_eq!((found.text.as_str(), found.hash.as_str()), (SetBool::DEFINITION, SetBool::TYPE_HASH));
    /// # Ok::<(), downbeat_msgs::dynamic::TypeLookupError>(())
    /// ```
    ///
    /// # Errors
    /// See [`Definitions::find`].
    pub fn find_interface(&self, name: &str) -> Result<InterfaceDefinition, TypeLookupError> {
        let parsed: TypeName = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        // Services and actions are found by a message that belongs to them.
        let parts: &[&str] = match parsed.kind {
            Kind::Message => &[""],
            Kind::Service => &["_Request", ""],
            Kind::Action => &["_Goal", "_Request", ""],
        };
        let mut problem = None;
        for part in parts {
            let (_, place, catalog) = match self.gather(&format!("{name}{part}")) {
                Ok(found) => found,
                Err(error) => {
                    problem.get_or_insert(error);
                    continue;
                }
            };
            let unusable = |problem: DefinitionError| unusable(&parsed, &place, problem.into());
            let text = catalog.definition_text(&parsed).map_err(unusable)?;
            let hash = catalog.type_hash(&parsed).map_err(unusable)?;
            return Ok(InterfaceDefinition {
                name: parsed,
                text,
                hash,
                catalog: catalog.into_owned(),
                place,
            });
        }
        Err(problem.unwrap_or_else(|| TypeLookupError::NotFound {
            name: Box::new(parsed),
            owner: None,
            looked: Vec::new(),
        }))
    }

    /// Returns a catalog with the type and all types it refers to, and the source of the type.
    fn gather(&self, name: &str) -> Result<(TypeName, String, Cow<'_, Catalog>), TypeLookupError> {
        let name: TypeName = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        let mut gathered = Catalog::new();
        let mut asked = BTreeSet::from([name.clone()]);
        let mut wanted: Vec<(TypeName, Option<TypeName>)> = vec![(name.clone(), None)];
        let mut first_place = String::new();
        while let Some((next, owner)) = wanted.pop() {
            let (place, found) = self.ask(&next, owner)?;
            let unusable = |problem: DefinitionError| unusable(&next, &place, problem.into());
            if first_place.is_empty() {
                first_place.clone_from(&place);
            }
            match found {
                Found::Complete(catalog) if next == name => return Ok((name, place, Cow::Borrowed(catalog))),
                Found::Complete(catalog) => {
                    gathered.add_message_from(catalog, &next).map_err(unusable)?;
                }
                Found::Alone(catalog) => {
                    if next == name {
                        // With the service or action that the message belongs to.
                        gathered = (*catalog).clone();
                    }
                    for owner in catalog.messages() {
                        if next != name {
                            gathered.add_message_from(&catalog, &owner.name).map_err(unusable)?;
                        }
                        for field in &owner.fields {
                            if let Element::Message(inner) = &field.field_type.element
                                && catalog.message(inner).is_err()
                                && asked.insert(inner.clone())
                            {
                                wanted.push((inner.clone(), Some(owner.name.clone())));
                            }
                        }
                    }
                }
                Found::Nothing(_) => {}
            }
        }
        Ok((name, first_place, Cow::Owned(gathered)))
    }

    /// Returns the result of the first source that has the type, and the name of the source.
    fn ask(&self, name: &TypeName, owner: Option<TypeName>) -> Result<(String, Found<'_>), TypeLookupError> {
        let mut looked = Vec::new();
        for source in &self.sources {
            let place = source.description();
            match source.find(name) {
                Ok(Found::Nothing(instead)) => looked.push(format!("in {place}: {instead}")),
                Ok(found) => return Ok((place, found)),
                Err(problem) => {
                    let problem = Box::new(problem.into());
                    return Err(TypeLookupError::Unusable { name: Box::new(name.clone()), place, problem });
                }
            }
        }
        if looked.is_empty() {
            looked.push("nowhere: there are no sources".into());
        }
        Err(TypeLookupError::NotFound { name: Box::new(name.clone()), owner: owner.map(Box::new), looked })
    }
}

impl fmt::Debug for Definitions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.sources.iter().map(|source| source.description())).finish()
    }
}

/// The interfaces built into this crate.
struct Carried;

impl DefinitionSource for Carried {
    fn description(&self) -> String {
        "the built-in interfaces".into()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, DefinitionError> {
        if carried().message(name).is_ok() {
            return Ok(Found::Complete(carried()));
        }
        Ok(Found::Nothing(instead("they have", [carried()].into_iter(), name)))
    }
}

/// Searches complete definitions: the one of that name, or one that refers to it.
fn find_complete<'a>(catalogs: &'a BTreeMap<TypeName, Catalog>, name: &TypeName, subject: &str) -> Found<'a> {
    let own = catalogs.get(name).into_iter();
    match own.chain(catalogs.values()).find(|catalog| catalog.message(name).is_ok()) {
        Some(catalog) => Found::Complete(catalog),
        None => Found::Nothing(instead(subject, catalogs.values(), name)),
    }
}

/// Describes what is known of the package of a missing type.
fn instead<'a>(subject: &str, catalogs: impl Iterator<Item = &'a Catalog>, name: &TypeName) -> String {
    let names: BTreeSet<&TypeName> = catalogs
        .flat_map(Catalog::messages)
        .map(|message| &message.name)
        .filter(|other| other.package == name.package)
        .collect();
    match nearest(&name.to_string(), &names).or(names.first()) {
        Some(nearest) => format!("{subject} {nearest} of that package"),
        None => format!("{subject} nothing of that package"),
    }
}

fn unusable(name: &TypeName, place: &str, problem: TypeError) -> TypeLookupError {
    TypeLookupError::Unusable {
        name: Box::new(name.clone()),
        place: place.to_owned(),
        problem: Box::new(problem),
    }
}

fn needed_by(owner: Option<&TypeName>) -> String {
    owner.map_or_else(String::new, |owner| format!(", the type of a field of {owner}"))
}
