//! What robot files can name.

use std::collections::BTreeMap;
use std::sync::Arc;

use downbeat_edge::{InterfaceConflict, Interfaces};
use downbeat_executor::{Core, Launcher, Mechanism, ThreadOptions};
use downbeat_kind::Kind;
use downbeat_msgs::InterfaceSet;

/// The registry of an app: kinds of modules and launchers, which robot files name; types of messages,
/// services and actions; and mechanisms, which are added to every core.
///
/// Clones are cheap and share their contents.
#[derive(Clone, Default)]
pub struct Catalog {
    /// The registered messages, services and actions, including those of `downbeat-msgs`.
    pub interfaces: Interfaces,
    kinds: BTreeMap<Arc<str>, Kind>,
    launchers: BTreeMap<Arc<str>, Arc<MakeLauncher>>,
    mechanisms: Vec<Arc<Engage>>,
}

type MakeLauncher = dyn Fn(&ThreadOptions) -> Result<Box<dyn Launcher>, String> + Send + Sync;
type Engage = dyn Fn(Core) -> Core + Send + Sync;

/// A registration was refused because its name is in use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CatalogError {
    /// Two kinds with the same name.
    #[error("there are two kinds of modules named \"{0}\"; give one of them another name")]
    TwoKinds(String),
    /// Two launchers with the same name.
    #[error("there already is a launcher named \"{0}\"; choose another name")]
    TwoLaunchers(String),
    /// A variable of the environment has a wrong value.
    #[error("the environment variable {variable}: {problem}")]
    Environment {
        /// The variable.
        variable: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// Two definitions of one interface.
    #[error(transparent)]
    Interfaces(#[from] InterfaceConflict),
}

/// The launchers that every robot file can name.
const BUILT_IN_LAUNCHERS: [&str; 3] = ["linear", "pool", "threads"];

impl Catalog {
    /// Creates a catalog without kinds, with the launchers `linear`, `pool` and `threads` and the interfaces
    /// of `downbeat-msgs`.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a catalog with the built-in kinds of modules.
    #[must_use]
    pub fn built_in() -> Self {
        let kinds = crate::built_in::kinds().into_iter().map(|kind| (Arc::from(kind.name()), kind));
        let interfaces = Interfaces::carried();
        // No carried interface has the names of these.
        #[cfg(feature = "leagues")]
        let interfaces = interfaces.with(downbeat_football::INTERFACES).unwrap_or_default();
        #[cfg(feature = "physics")]
        let interfaces = interfaces.with_other_version(downbeat_physics::version_2::INTERFACES);
        // A wrong name is reported by `environment_problem`.
        #[cfg(feature = "px4")]
        let interfaces = {
            let newest = downbeat_px4::AllReleases { first: downbeat_px4::Release::default() };
            interfaces.with_other_version(downbeat_px4::AllReleases::from_environment().unwrap_or(newest))
        };
        #[cfg(feature = "sensors")]
        let interfaces = interfaces.with(downbeat_sensors::INTERFACES).unwrap_or_default();
        #[cfg(feature = "state_machine")]
        let interfaces = interfaces.with(downbeat_state_machine::INTERFACES).unwrap_or_default();
        Self { kinds: kinds.collect(), interfaces, ..Self::default() }
    }

    /// What is wrong with the variables of the environment on which [`built_in`](Self::built_in) depends.
    #[must_use]
    pub fn environment_problem() -> Option<CatalogError> {
        #[cfg(feature = "px4")]
        if let Err(error) = downbeat_px4::AllReleases::from_environment() {
            let variable = downbeat_px4::RELEASE_VARIABLE;
            return Some(CatalogError::Environment { variable, problem: error.to_string() });
        }
        None
    }

    /// Adds a kind of module.
    ///
    /// # Errors
    /// Returns an error if the name is in use.
    pub fn add_kind(&mut self, kind: Kind) -> Result<(), CatalogError> {
        if self.kinds.contains_key(kind.name()) {
            return Err(CatalogError::TwoKinds(kind.name().to_owned()));
        }
        self.kinds.insert(kind.name().into(), kind);
        Ok(())
    }

    /// Adds messages, services and actions, such as the `INTERFACES` of a crate.
    ///
    /// # Errors
    /// Returns an error if a name is registered with another definition. None of the set is then added.
    pub fn add_interfaces(&mut self, set: impl InterfaceSet) -> Result<(), CatalogError> {
        self.interfaces = self.interfaces.with(set)?;
        Ok(())
    }

    /// Adds a launcher. `make` is called for each core, with the CPUs and priorities that the robot file
    /// gives its threads.
    ///
    /// # Errors
    /// Returns an error if there is a launcher with this name.
    pub fn add_launcher<L: Launcher + 'static>(
        &mut self,
        name: &str,
        make: impl Fn(&ThreadOptions) -> Result<L, String> + Send + Sync + 'static,
    ) -> Result<(), CatalogError> {
        if BUILT_IN_LAUNCHERS.contains(&name) || self.launchers.contains_key(name) {
            return Err(CatalogError::TwoLaunchers(name.to_owned()));
        }
        let make = move |threads: &ThreadOptions| Ok(Box::new(make(threads)?) as Box<dyn Launcher>);
        self.launchers.insert(name.into(), Arc::new(make));
        Ok(())
    }

    /// Adds a mechanism. `make` is called for each core.
    pub fn add_mechanism<M: Mechanism>(&mut self, make: impl Fn() -> M + Send + Sync + 'static) {
        self.mechanisms.push(Arc::new(move |core: Core| core.with_mechanism(make())));
    }

    /// Iterates over the kinds, by name.
    pub fn kinds(&self) -> impl Iterator<Item = &Kind> {
        self.kinds.values()
    }

    /// Returns the kind with this name.
    #[must_use]
    pub fn kind(&self, name: &str) -> Option<&Kind> {
        self.kinds.get(name)
    }

    /// Iterates over the names of all launchers.
    pub fn launchers(&self) -> impl Iterator<Item = &str> {
        BUILT_IN_LAUNCHERS.into_iter().chain(self.launchers.keys().map(|name| &**name))
    }

    /// Creates the added launcher with this name.
    pub(super) fn make_launcher(
        &self,
        name: &str,
        threads: &ThreadOptions,
    ) -> Option<Result<Box<dyn Launcher>, String>> {
        self.launchers.get(name).map(|make| make(threads))
    }

    /// Adds the mechanisms to a core.
    pub(super) fn engage(&self, core: Core) -> Core {
        self.mechanisms.iter().fold(core, |core, engage| engage(core))
    }
}

/// The call that registers a type with an app: `.interfaces(my_msgs::INTERFACES)`. `None` if the type is not
/// in a user's crate.
///
/// Generated types are in the modules `package::msg`, `package::srv` or `package::action` next to their set;
/// any other message is its own set.
fn registering_call(rust_type: &str) -> Option<String> {
    let parts: Vec<&str> = rust_type.split("::").collect();
    let is_path = parts.iter().all(|part| part.chars().all(|c| c.is_alphanumeric() || c == '_'));
    if parts.len() < 2 || !is_path || ["alloc", "core", "std"].contains(&parts[0]) {
        return None;
    }
    match parts.as_slice() {
        [place @ .., _package, "msg" | "srv" | "action", _name] if !place.is_empty() => {
            Some(format!(".interfaces({}::INTERFACES)", place.join("::")))
        }
        _ => Some(format!(".interfaces({rust_type}::INTERFACES)")),
    }
}

/// The problem with a type that should be exposed to ROS 2, with a hint: the end of a sentence that names the
/// type.
pub(crate) fn unregistered(rust_type: &str, what: &str) -> String {
    match registering_call(rust_type) {
        Some(call) => format!("which is not registered: if it is a {what}, add `{call}` to the app"),
        None => format!("which is not a {what}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_call_names_the_set_that_has_the_type() {
        for (rust_type, call) in [
            ("my_msgs::my_msgs::msg::Tilt", Some(".interfaces(my_msgs::INTERFACES)")),
            ("my_robot::seen::my_msgs::srv::LevelRequest", Some(".interfaces(my_robot::seen::INTERFACES)")),
            ("my_robot::head::Tilt", Some(".interfaces(my_robot::head::Tilt::INTERFACES)")),
            ("my_robot::Stamped<my_robot::Tilt>", None),
            ("alloc::string::String", None),
            ("u32", None),
            ("(u8, my_robot::Tilt)", None),
        ] {
            assert_eq!(registering_call(rust_type).as_deref(), call, "{rust_type}");
        }
    }
}
