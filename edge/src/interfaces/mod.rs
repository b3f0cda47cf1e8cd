//! The registry of messages, services and actions.

use crate::learned::Learned;
use crate::{EncodedInlet, KnownAction, KnownService, KnownType, LearnError, RawMessage};
use downbeat_executor::{Core, Module, ServiceInfo, Setup, SetupError, TopicInfo};
use downbeat_msgs::definitions::{Error, Kind, TypeName, nearest};
use downbeat_msgs::description::Description;
use downbeat_msgs::dynamic::{AmentPrefixPath, Definitions, InterfaceDefinition, Schemas, TypeLookupError};
use downbeat_msgs::type_description_interfaces::msg::TypeDescription;
use downbeat_msgs::{Action, InterfaceSet, InterfaceVisitor, Message, Service};
use std::any::TypeId;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::path::Path;
use std::sync::{Arc, LazyLock, OnceLock};

/// The registry of message, service and action types, looked up by name, hash or Rust type: those that
/// `downbeat-msgs` carries, and those that the program registers. Clones share one table.
///
/// ```
/// use downbeat_edge::Interfaces;
/// use downbeat_msgs::Message;
///
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(name = "my_msgs/msg/Tilt")]
/// struct Tilt {
///     angle: f64,
/// }
///
/// let interfaces = Interfaces::carried().with(Tilt::INTERFACES)?;
/// assert_eq!(interfaces.message("my_msgs/msg/Tilt")?.hash(), Tilt::TYPE_HASH);
/// assert!(Interfaces::carried().message("my_msgs/msg/Tilt").is_err(), "nothing is global");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// A name has one definition. Two Rust types of the same name and hash, such as a `sensor_msgs/msg/Imu` that
/// another crate generated, count as one type, which is found by either Rust type.
#[derive(Clone)]
pub struct Interfaces {
    tables: Arc<Tables>,
    /// The definitions of what is registered, once they were read.
    registered: Arc<OnceLock<Arc<Schemas>>>,
    learned: Arc<Learned>,
}

/// A message, service or action as `get_type_description` describes it.
#[derive(Clone, Debug)]
pub struct Described {
    /// As in `sensor_msgs/msg/Imu`.
    pub type_name: String,
    /// The definition text with all dependencies.
    pub definition: Cow<'static, str>,
    /// The type and all that it refers to.
    pub message: TypeDescription,
}

/// A name was registered with two definitions.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{name} is registered with two definitions: {known} and {other}. On a ROS 2 network a name has one definition: rename one \
     of them, or use the Rust type of one crate in both places"
)]
pub struct InterfaceConflict {
    /// The name of the message, service or action.
    pub name: &'static str,
    /// The hash that was registered before.
    pub known: &'static str,
    /// The hash that was refused.
    pub other: &'static str,
}

/// A name of no registered message, service or action.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown {kind} type {name:?}{}", nearest.map(|name| format!(", did you mean {name:?}?")).unwrap_or_default())]
pub struct UnknownType {
    /// `message`, `service` or `action`.
    pub kind: &'static str,
    /// The unknown name.
    pub name: String,
    /// The most similar registered name, if one is similar.
    pub nearest: Option<&'static str>,
}

#[derive(Clone, Default)]
struct Tables {
    messages: BTreeMap<&'static str, KnownType>,
    services: BTreeMap<&'static str, KnownService>,
    actions: BTreeMap<&'static str, KnownAction>,
    message_types: HashMap<TypeId, KnownType>,
    /// By the types of request and response in a core.
    service_types: HashMap<(&'static str, &'static str), KnownService>,
    /// The same of the service `send_goal`.
    action_types: HashMap<(&'static str, &'static str), KnownAction>,
    /// By hash.
    descriptions: HashMap<&'static str, &'static Description>,
}

impl Interfaces {
    /// The interfaces that `downbeat-msgs` was built with.
    ///
    /// # Panics
    /// Never: these have distinct names.
    #[must_use]
    pub fn carried() -> Self {
        Self::of(Arc::clone(&CARRIED))
    }

    fn of(tables: Arc<Tables>) -> Self {
        Self { tables, registered: Arc::default(), learned: Arc::default() }
    }

    /// Returns these interfaces with those of a set added.
    ///
    /// # Errors
    /// [`InterfaceConflict`] if a name of the set is registered with another definition.
    pub fn with(&self, set: impl InterfaceSet) -> Result<Self, InterfaceConflict> {
        let tables = Tables::clone(&self.tables).with(set, OtherVersions::Refused)?;
        Ok(self.of_tables(tables))
    }

    /// Returns these interfaces with the Rust types of another version of packages that are known: modules
    /// may use them, while a name alone still means the known version.
    #[must_use]
    pub fn with_other_version(&self, set: impl InterfaceSet) -> Self {
        match Tables::clone(&self.tables).with(set, OtherVersions::Admitted) {
            Ok(tables) => self.of_tables(tables),
            Err(_) => self.clone(), // none is refused
        }
    }

    fn of_tables(&self, tables: Tables) -> Self {
        Self { tables: Arc::new(tables), registered: Arc::default(), learned: Arc::clone(&self.learned) }
    }

    /// The same interfaces for one robot of several in a program: what clones of these learn later is not
    /// known there, nor the other way round.
    #[must_use]
    pub fn separate(&self) -> Self {
        Self { learned: Arc::new(Learned::clone(&self.learned)), ..self.clone() }
    }

    /// Adds the definitions in a folder: of a package, of all packages below it, or of an ament prefix.
    /// Messages, services and actions of which only the definition is known pass through as bytes.
    ///
    /// # Errors
    /// If the folder has no interfaces or two packages of one name, or a definition is invalid or differs
    /// from a known one.
    pub fn learn_folder(&self, folder: &Path) -> Result<(), Error> {
        self.learned.add_folder(folder)
    }

    /// Adds a definition that a module carries: `text` is that of a message, service or action with all
    /// dependencies, as in bags.
    ///
    /// ```
    /// use downbeat_edge::Interfaces;
    ///
    /// let interfaces = Interfaces::carried();
    /// let rule = "=".repeat(80);
    /// interfaces.learn("my_srvs/srv/Level", &format!("{rule}\nSRV: my_srvs/srv/Level\nfloat64 angle\n---\nbool is_level\n"))?;
    /// assert_eq!(interfaces.service("my_srvs/srv/Level")?.name(), "my_srvs/srv/Level");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the text is no definition, or the name has another one.
    pub fn learn(&self, name: &str, text: &str) -> Result<(), LearnError> {
        let unusable = |problem: Box<dyn std::error::Error + Send + Sync>| LearnError::Text {
            name: name.to_owned(),
            problem,
        };
        let mut schemas = Schemas::new("it");
        schemas.add(name, "ros2msg", text).map_err(|error| unusable(error.into()))?;
        let carried = Definitions::new().with(schemas).find_interface(name);
        let carried = carried.map_err(|error| unusable(error.into()))?;
        let known = match self.registered_hash(name) {
            Some(hash) => Some((hash.to_owned(), "the program".to_owned())),
            None => {
                self.definition(&carried.name).ok().map(|known| (known.hash.clone(), known.place.clone()))
            }
        };
        match known {
            Some((known, _)) if known == carried.hash => Ok(()),
            Some((known, place)) => {
                Err(LearnError::Other { name: name.to_owned(), carried: carried.hash, known, place })
            }
            None => self.learned.add_text(name, text).map_err(|error| unusable(error.into())),
        }
    }

    /// The name and the definition text, with all dependencies, of the message, service or action that a name
    /// is of or a part of.
    ///
    /// # Errors
    /// If no definition is known.
    pub fn definition_text(&self, name: &str) -> Result<(String, String), TypeLookupError> {
        let parsed = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        let found = self.definition(&parsed)?;
        Ok((found.name.to_string(), found.text.clone()))
    }

    fn registered_hash(&self, name: &str) -> Option<&'static str> {
        let Tables { messages, services, actions, .. } = &*self.tables;
        let message = messages.get(name).map(|known| known.hash());
        let service = || services.get(name).map(|known| known.hash());
        message.or_else(service).or_else(|| actions.get(name).map(|known| known.hash()))
    }

    /// The definition of the whole that a name is a part of.
    fn definition(&self, name: &TypeName) -> Result<Arc<InterfaceDefinition>, TypeLookupError> {
        self.learned.definition(name, || self.definitions())
    }
    /// The message of that name, such as `sensor_msgs/msg/Imu`.
    ///
    /// # Errors
    /// [`UnknownType`] with the nearest name where there is none.
    pub fn message(&self, name: &str) -> Result<KnownType, UnknownType> {
        self.tables.messages.get(name).copied().ok_or_else(|| UnknownType {
            kind: "message",
            name: name.to_owned(),
            nearest: nearest(name, self.tables.messages.keys().copied()),
        })
    }

    /// The message of that name: a registered one, one of a registered action, or one of which only the
    /// definition is known, which passes through ([`KnownType::raw`]).
    ///
    /// # Errors
    /// [`UnknownType`] where there is none.
    pub fn find_message(&self, name: &str) -> Result<KnownType, UnknownType> {
        let unknown = match self.message(name) {
            Ok(known) => return Ok(known),
            Err(unknown) => unknown,
        };
        if let Some(Ok(action)) = name.strip_suffix("_FeedbackMessage").map(|action| self.action(action)) {
            return Ok(action.feedback());
        }
        let parsed = name.parse().ok().filter(|parsed: &TypeName| parsed.kind == Kind::Message);
        let raw = parsed.and_then(|parsed| {
            let definition = self.definition(&parsed).ok()?.message(name).ok()?;
            KnownType::defined(definition).ok()
        });
        raw.ok_or(unknown)
    }

    /// The hash of the message of that name; of a request, response or event of a service or action too.
    #[must_use]
    pub fn message_hash(&self, name: &str) -> Option<String> {
        let of_service =
            ["_Request", "_Response", "_Event"].into_iter().enumerate().find_map(|(index, part)| {
                let service = self.service(name.strip_suffix(part)?).ok()?;
                Some(service.message_hashes()[index].to_owned())
            });
        let of_message = || self.find_message(name).ok().map(|known| known.hash().to_owned());
        let found = of_service.or_else(of_message).filter(|hash| !hash.is_empty());
        found.or_else(|| self.definitions().find_text(name).ok().map(|(_, hash)| hash))
    }

    /// The type with which a module should use a topic: if the topic carries another Rust type of the same
    /// definition as `message`, that. The topic is named as the module names it, before remapping.
    #[must_use]
    pub fn message_on<M: Module>(
        &self,
        setup: &mut Setup<'_, M>,
        topic: &str,
        message: KnownType,
    ) -> KnownType {
        let topic = setup.remapped(topic);
        let on_topic = setup.topics().find(|known| *known.name == *topic.trim_start_matches('/'));
        let carried = on_topic.and_then(|topic| self.message_in(topic));
        carried.filter(|carried| *carried == message).unwrap_or(message)
    }

    /// The message whose Rust type is `type_id`, as
    /// [`TopicInfo::message_type_id`](downbeat_executor::TopicInfo::message_type_id) gives it.
    #[must_use]
    pub fn message_of(&self, type_id: TypeId) -> Option<KnownType> {
        self.tables.message_types.get(&type_id).copied()
    }

    /// The message that a topic of a core carries: a registered one, or one that passes through as bytes.
    #[must_use]
    pub fn message_in(&self, topic: &TopicInfo) -> Option<KnownType> {
        match topic.message_type_id == TypeId::of::<RawMessage>() {
            true => KnownType::met(topic.message_type, || self.find_message(topic.message_type).ok()),
            false => self.message_of(topic.message_type_id),
        }
    }

    /// Opens an inlet for serialized messages. If two Rust types have the definition of `message`, the one
    /// that the topic carries is used.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the topic carries another message.
    pub fn inlet(
        &self,
        core: &mut Core,
        topic: &str,
        message: KnownType,
    ) -> Result<EncodedInlet, SetupError> {
        let name = topic.strip_prefix('/').unwrap_or(topic);
        let found = core.topics().find(|found| *found.name == *name);
        let carried = found.and_then(|found| self.message_in(found));
        carried.filter(|carried| *carried == message).unwrap_or(message).inlet(core, topic)
    }

    /// Every message, by name.
    pub fn messages(&self) -> impl Iterator<Item = KnownType> {
        self.tables.messages.values().copied()
    }

    /// The service of that name, such as `std_srvs/srv/SetBool`: a registered one, one of an action, or one
    /// of which only the definition is known, whose requests and responses pass through as bytes.
    ///
    /// # Errors
    /// [`UnknownType`] with the nearest registered name where there is none.
    pub fn service(&self, name: &str) -> Result<KnownService, UnknownType> {
        let of_action = |part: &str, service: fn(KnownAction) -> KnownService| {
            self.tables.actions.get(name.strip_suffix(part)?).copied().map(service)
        };
        let by_definition = || {
            let parsed = name.parse().ok().filter(|parsed: &TypeName| parsed.kind != Kind::Message)?;
            let definition = self.definition(&parsed).ok()?;
            KnownService::defined(&definition, name).ok()
        };
        let registered = self.tables.services.get(name).copied();
        let registered = registered.or_else(|| of_action("_SendGoal", KnownAction::send_goal));
        let registered = registered.or_else(|| of_action("_GetResult", KnownAction::get_result));
        registered.or_else(by_definition).ok_or_else(|| UnknownType {
            kind: "service",
            name: name.to_owned(),
            nearest: nearest(name, self.tables.services.keys().copied()),
        })
    }

    /// The type of a service of a core, if its request and response types are registered or pass through as
    /// bytes.
    #[must_use]
    pub fn service_of(&self, service: &ServiceInfo) -> Option<KnownService> {
        let types = (service.request_type, service.response_type);
        self.tables.service_types.get(&types).copied().or_else(|| {
            let raw = self.service(types.0.strip_suffix("_Request")?).ok()?;
            (raw.types_in_core() == types).then_some(raw)
        })
    }

    /// The type of the service with this name in a core; the services of actions are found too.
    #[must_use]
    pub fn service_in(&self, core: &Core, service: &str) -> Option<KnownService> {
        self.service_found(service, |name| core.service(name))
    }

    /// The same where `find` knows the services of a core.
    #[must_use]
    pub fn service_found<'a>(
        &self,
        service: &str,
        find: impl Fn(&str) -> Option<&'a ServiceInfo>,
    ) -> Option<KnownService> {
        self.service_of(find(service)?).or_else(|| {
            let (action, part) = service.split_once("/_action/")?;
            let action = self.action_of(find(&format!("{action}/_action/send_goal"))?)?;
            match part {
                "send_goal" => Some(action.send_goal()),
                "get_result" => Some(action.get_result()),
                _ => None,
            }
        })
    }

    /// Every service, by name.
    pub fn services(&self) -> impl Iterator<Item = KnownService> {
        self.tables.services.values().copied()
    }

    /// The action of that name, such as `tf2_msgs/action/LookupTransform`: a registered one, or one of which
    /// only the definition is known.
    ///
    /// # Errors
    /// [`UnknownType`] with the nearest registered name where there is none.
    pub fn action(&self, name: &str) -> Result<KnownAction, UnknownType> {
        let by_definition = || {
            let parsed: TypeName =
                name.parse().ok().filter(|parsed: &TypeName| parsed.kind == Kind::Action)?;
            let definition = self.definition(&parsed).ok().filter(|found| found.name == parsed)?;
            KnownAction::defined(&definition).ok()
        };
        self.tables.actions.get(name).copied().or_else(by_definition).ok_or_else(|| UnknownType {
            kind: "action",
            name: name.to_owned(),
            nearest: nearest(name, self.tables.actions.keys().copied()),
        })
    }

    /// The type of an action of a core, by its service `send_goal`.
    #[must_use]
    pub fn action_of(&self, send_goal: &ServiceInfo) -> Option<KnownAction> {
        let types = (send_goal.request_type, send_goal.response_type);
        self.tables.action_types.get(&types).copied().or_else(|| {
            let raw = self.action(types.0.strip_suffix("_SendGoal_Request")?).ok()?;
            (raw.send_goal().types_in_core() == types).then_some(raw)
        })
    }

    /// Every action, by name.
    pub fn actions(&self) -> impl Iterator<Item = KnownAction> {
        self.tables.actions.values().copied()
    }

    /// The messages, services and actions that the program registered, by name: descriptions with the
    /// definition texts. Of a name with several versions, the one that it stands for.
    pub fn registered(&self) -> impl Iterator<Item = &'static Description> {
        let carried = Self::carried();
        let descriptions = self.tables.descriptions.iter();
        let registered = descriptions.filter(|(hash, description)| {
            !carried.tables.descriptions.contains_key(*hash)
                && self.tables.hash_of(description.type_name) == Some(**hash)
        });
        let mut registered: Vec<_> = registered.map(|(_, description)| *description).collect();
        registered.sort_unstable_by_key(|description| description.type_name);
        registered.into_iter()
    }

    /// The definitions of the interfaces that the program registered.
    #[must_use]
    pub fn registered_definitions(&self) -> Arc<Schemas> {
        let read = || {
            let mut registered = Schemas::new("the interfaces registered");
            for Description { type_name, definition, .. } in self.registered() {
                // A definition that a crate was compiled with is one.
                if let Err(error) = registered.add(type_name, "ros2msg", definition) {
                    tracing::error!("the definition of {type_name} cannot be read: {error}");
                }
            }
            Arc::new(registered)
        };
        Arc::clone(self.registered.get_or_init(read))
    }

    /// The places where definitions are looked up at run time: the registered interfaces, those that
    /// `downbeat-msgs` carries, the folders and modules that the program has learned from, and the ament
    /// prefixes of the environment.
    #[must_use]
    pub fn definitions(&self) -> Definitions {
        let built_in = Definitions::new().with(self.registered_definitions()).with_carried();
        self.learned.sources(built_in).with(AmentPrefixPath::from_environment())
    }

    /// The message, service or action with this hash, if it is registered or was looked up before.
    #[must_use]
    pub fn described(&self, hash: &str) -> Option<Described> {
        if let Some(found) = self.tables.descriptions.get(hash) {
            return Some(Described {
                type_name: found.type_name.to_owned(),
                definition: Cow::Borrowed(found.definition),
                message: found.to_message(),
            });
        }
        let (name, found) = self.learned.described(hash)?;
        Some(Described {
            type_name: name.to_string(),
            definition: Cow::Owned(found.described(&name.to_string()).ok()?.1),
            message: TypeDescription::from(&found.catalog.type_description(&name).ok()?),
        })
    }
}

/// The carried interfaces.
impl Default for Interfaces {
    fn default() -> Self {
        Self::carried()
    }
}

impl fmt::Debug for Interfaces {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Tables { messages, services, actions, .. } = &*self.tables;
        f.debug_struct("Interfaces")
            .field("messages", &messages.len())
            .field("services", &services.len())
            .field("actions", &actions.len())
            .finish()
    }
}

static CARRIED: LazyLock<Arc<Tables>> = LazyLock::new(|| {
    let tables = Tables::default().with(downbeat_msgs::INTERFACES, OtherVersions::Refused);
    Arc::new(tables.unwrap_or_else(|conflict| panic!("what is carried is wrong: {conflict}")))
});

impl Tables {
    /// The hash of what a name stands for.
    fn hash_of(&self, name: &str) -> Option<&'static str> {
        let message = self.messages.get(name).map(|known| known.hash());
        let service = || self.services.get(name).map(|known| known.hash());
        message.or_else(service).or_else(|| self.actions.get(name).map(|known| known.hash()))
    }

    fn with(self, set: impl InterfaceSet, other_versions: OtherVersions) -> Result<Self, InterfaceConflict> {
        let mut registration = Registration { tables: self, other_versions, conflict: None };
        set.visit(&mut registration);
        registration.conflict.map_or(Ok(registration.tables), Err)
    }
}

/// Whether a known name may come with another definition.
#[derive(Clone, Copy, PartialEq)]
enum OtherVersions {
    Refused,
    /// The name stays with the known one.
    Admitted,
}

/// Registers the interfaces of a set.
struct Registration {
    tables: Tables,
    other_versions: OtherVersions,
    conflict: Option<InterfaceConflict>,
}

impl Registration {
    /// Returns true if the name is new or has the same definition, or another one is admitted.
    fn admits(&mut self, hash: &'static str, known: Option<&'static str>, of: &'static Description) -> bool {
        match known.filter(|known| *known != hash) {
            Some(known) if self.other_versions == OtherVersions::Refused => {
                let conflict = InterfaceConflict { name: of.type_name, known, other: hash };
                self.conflict.get_or_insert(conflict);
                false
            }
            _ => {
                self.tables.descriptions.insert(hash, of);
                true
            }
        }
    }

    fn add_message(&mut self, message: KnownType, of: &'static Description) {
        let known = self.tables.messages.get(message.name()).map(|known| known.hash());
        if self.admits(message.hash(), known, of) {
            self.tables.messages.entry(message.name()).or_insert(message);
            self.tables.message_types.insert(message.rust_type(), message);
        }
    }

    fn add_service(&mut self, service: KnownService, of: &'static Description) {
        let known = self.tables.services.get(service.name()).map(|known| known.hash());
        if self.admits(service.hash(), known, of) {
            self.tables.services.entry(service.name()).or_insert(service);
            self.tables.service_types.insert(service.types_in_core(), service);
        }
    }

    fn add_action(&mut self, action: KnownAction, of: &'static Description) {
        let known = self.tables.actions.get(action.name()).map(|known| known.hash());
        if self.admits(action.hash(), known, of) {
            self.tables.actions.entry(action.name()).or_insert(action);
            self.tables.action_types.insert(action.send_goal().types_in_core(), action);
        }
    }
}

// One call each: they exist once per type.
impl InterfaceVisitor for Registration {
    fn message<T: Message>(&mut self) {
        self.add_message(KnownType::of::<T>(), T::DESCRIPTION);
    }

    fn service<S: Service>(&mut self) {
        self.add_service(KnownService::of::<S>(), S::DESCRIPTION);
    }

    fn action<A: Action>(&mut self) {
        self.add_action(KnownAction::of::<A>(), A::DESCRIPTION);
    }
}

#[cfg(test)]
mod tests;
