//! Looking up the definition of a type by its name.

mod ament;
mod described;
mod schemas;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use downbeat_msgs_definitions::{Catalog, Element, Error as DefinitionError, TypeName, nearest};

use super::{DynamicType, TypeError};
use crate::carried;

pub use ament::AmentPrefixPath;
pub use described::DescribedTypes;
pub use schemas::Schemas;

/// Places in which definitions are looked up, one after another: in the order in which they were added.
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
///      interfaces carried: they have nothing of that package"
/// );
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// What a definition refers to is looked up in the same order, but for sources that have definitions with all that they
/// refer to, as a bag has: there all comes from one place, whatever the others say.
#[derive(Default)]
pub struct Definitions {
    sources: Vec<Box<dyn DefinitionSource>>,
}

/// A type, and what is kept of it beside messages.
#[derive(Clone, Debug)]
pub struct TypeDefinition {
    /// The type.
    pub message_type: DynamicType,
    /// The `ros2msg` text with all dependencies, as rosbag2 stores it.
    pub text: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub hash: String,
}

/// Where definitions can be found.
pub trait DefinitionSource: Send + Sync {
    /// What to call it in an error: `walk.mcap`.
    fn description(&self) -> String;

    /// Looks up one type.
    ///
    /// # Errors
    /// If there is a definition but it cannot be read. Then no other source is asked.
    fn find(&self, name: &TypeName) -> Result<Found<'_>, DefinitionError>;
}

/// What a [`DefinitionSource`] has.
#[derive(Debug)]
pub enum Found<'a> {
    /// The definition and all that it refers to.
    Complete(&'a Catalog),
    /// The definition alone, or the service or action the message belongs to.
    Alone(Box<Catalog>),
    /// None, and what there is instead, as the end of a sentence.
    Nothing(String),
}

/// Why a type was not found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LookupError {
    /// No source has it.
    #[error("found no definition of {name}{}. Looked {}", needed_by(owner.as_deref()), looked.join("; "))]
    NotFound {
        /// The type that was not found.
        name: Box<TypeName>,
        /// The message that has a field of it, if it is not the type that was asked for.
        owner: Option<Box<TypeName>>,
        /// Where it was looked for, and what is there.
        looked: Vec<String>,
    },
    /// A source has it, but it cannot be used.
    #[error("cannot use the definition of {name} from {place}: {problem}")]
    Unusable {
        /// The type.
        name: Box<TypeName>,
        /// Where it is.
        place: String,
        /// Why not.
        problem: Box<TypeError>,
    },
    /// The name is none.
    #[error(transparent)]
    Name(Box<DefinitionError>),
}

impl Definitions {
    /// No places yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The interfaces this crate carries, then those installed below the prefixes in `AMENT_PREFIX_PATH`.
    #[must_use]
    pub fn from_environment() -> Self {
        Self::new().with_carried().with(AmentPrefixPath::from_environment())
    }

    /// Adds a place, to be asked when those before it do not have a type.
    #[must_use]
    pub fn with(mut self, source: impl DefinitionSource + 'static) -> Self {
        self.sources.push(Box::new(source));
        self
    }

    /// Adds the interfaces this crate carries.
    #[must_use]
    pub fn with_carried(self) -> Self {
        self.with(Carried)
    }

    /// The type of that name: a message, be it one that belongs to a service or an action. Keep it: looking up again
    /// compiles again.
    ///
    /// # Errors
    /// If no place has it or something it refers to; the error says what was found where. Or if it cannot be used.
    pub fn find(&self, name: &str) -> Result<DynamicType, LookupError> {
        let (name, place, catalog) = self.gather(name)?;
        DynamicType::new(&catalog, &name).map_err(|problem| unusable(&name, &place, problem))
    }

    /// The definition text of the type of that name, as a bag holds it, and its RIHS01 hash.
    ///
    /// ```
    /// use downbeat_msgs::Message;
    /// use downbeat_msgs::dynamic::Definitions;
    /// use downbeat_msgs::std_msgs::msg::Header;
    ///
    /// let (text, hash) = Definitions::new().with_carried().find_text("std_msgs/msg/Header")?;
    /// assert_eq!((text.as_str(), hash.as_str()), (Header::DEFINITION, Header::TYPE_HASH));
    /// # Ok::<(), downbeat_msgs::dynamic::LookupError>(())
    /// ```
    ///
    /// # Errors
    /// As those of [`Definitions::find`].
    pub fn find_text(&self, name: &str) -> Result<(String, String), LookupError> {
        let (name, place, catalog) = self.gather(name)?;
        let unusable = |problem: DefinitionError| unusable(&name, &place, problem.into());
        let text = catalog.definition_text(&name).map_err(unusable)?;
        Ok((text, catalog.type_description(&name).map_err(unusable)?.hash()))
    }

    /// The type of that name with the text that a bag has of it and its hash.
    ///
    /// # Errors
    /// As those of [`Definitions::find`].
    pub fn describe(&self, name: &str) -> Result<TypeDefinition, LookupError> {
        let message_type = self.find(name)?;
        let (text, hash) = self.find_text(name)?;
        Ok(TypeDefinition { message_type, text, hash })
    }

    /// A catalog that has the type and all it refers to, and where the type was found.
    fn gather(&self, name: &str) -> Result<(TypeName, String, Cow<'_, Catalog>), LookupError> {
        let name: TypeName = name.parse().map_err(|error| LookupError::Name(Box::new(error)))?;
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

    /// What the first source that has the type has, and what the source is called.
    fn ask(&self, name: &TypeName, owner: Option<TypeName>) -> Result<(String, Found<'_>), LookupError> {
        let mut looked = Vec::new();
        for source in &self.sources {
            let place = source.description();
            match source.find(name) {
                Ok(Found::Nothing(instead)) => looked.push(format!("in {place}: {instead}")),
                Ok(found) => return Ok((place, found)),
                Err(problem) => {
                    let problem = Box::new(problem.into());
                    return Err(LookupError::Unusable { name: Box::new(name.clone()), place, problem });
                }
            }
        }
        if looked.is_empty() {
            looked.push("nowhere: no place to look in was given".into());
        }
        Err(LookupError::NotFound { name: Box::new(name.clone()), owner: owner.map(Box::new), looked })
    }
}

impl fmt::Debug for Definitions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.sources.iter().map(|source| source.description())).finish()
    }
}

/// The interfaces this crate carries.
struct Carried;

impl DefinitionSource for Carried {
    fn description(&self) -> String {
        "the interfaces carried".into()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, DefinitionError> {
        if carried().message(name).is_ok() {
            return Ok(Found::Complete(carried()));
        }
        Ok(Found::Nothing(instead("they have", [carried()].into_iter(), name)))
    }
}

/// What a source finds that has definitions with all that they refer to: its own of that name, or one that refers to it.
fn find_complete<'a>(catalogs: &'a BTreeMap<TypeName, Catalog>, name: &TypeName, subject: &str) -> Found<'a> {
    let own = catalogs.get(name).into_iter();
    match own.chain(catalogs.values()).find(|catalog| catalog.message(name).is_ok()) {
        Some(catalog) => Found::Complete(catalog),
        None => Found::Nothing(instead(subject, catalogs.values(), name)),
    }
}

/// What there is of the package of a type that is not there.
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

fn unusable(name: &TypeName, place: &str, problem: TypeError) -> LookupError {
    LookupError::Unusable {
        name: Box::new(name.clone()),
        place: place.to_owned(),
        problem: Box::new(problem),
    }
}

fn needed_by(owner: Option<&TypeName>) -> String {
    owner.map_or_else(String::new, |owner| format!(", which {owner} has a field of"))
}
