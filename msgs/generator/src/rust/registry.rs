//! Lists of all types, for code that handles each of them.

use super::RustSource;
use downbeat_msgs_definitions::{Kind, TypeName};

impl RustSource<'_> {
    /// Modules that include the text of each [package](RustSource::package) from `<package>.rs` in the folder
    /// of the environment variable `OUT_DIR` at compile time.
    #[must_use]
    pub fn index(&self, packages: &[&str]) -> String {
        let mut source = String::new();
        for package in packages {
            source.push_str(&format!(
                "/// Interfaces of the package `{package}`.\n#[allow(clippy::all)]\npub mod {} {{\n    \
                 include!(concat!(env!(\"OUT_DIR\"), \"/{package}.rs\"));\n}}\n\n",
                super::names::identifier(package)
            ));
        }
        source
    }

    /// The macros `for_each_message`, `for_each_service` and `for_each_action`, and the constant
    /// `TYPE_NAMES`, for the given packages. They must be at the root of a crate that has the packages at its
    /// root.
    #[must_use]
    pub fn registry(&self, packages: &[&str]) -> String {
        let is_here = |name: &&TypeName| packages.contains(&name.package.as_str());
        let messages: Vec<&TypeName> =
            self.catalog.messages().map(|message| &message.name).filter(is_here).collect();
        let services: Vec<&TypeName> =
            self.catalog.services().map(|service| &service.name).filter(is_here).collect();
        let actions: Vec<&TypeName> =
            self.catalog.actions().map(|action| &action.name).filter(is_here).collect();
        let mut source =
            self.for_each("message", "including the messages of services and actions", &messages);
        source.push_str(&self.for_each("service", "including the services of actions", &services));
        source.push_str(&self.for_each("action", "those that implement `Action`", &actions));
        source.push_str(
            "/// The name of every message type here, in order.\npub const TYPE_NAMES: &[&str] = &[\n",
        );
        for name in messages {
            source.push_str(&format!("    \"{name}\",\n"));
        }
        source.push_str("];\n");
        source
    }

    /// The set `INTERFACES` of all messages, services and actions of the given packages. It must be next to
    /// their modules.
    #[must_use]
    pub fn interface_set(&self, packages: &[&str]) -> String {
        let runtime = &self.modules.runtime;
        let is_here = |name: &&TypeName| packages.contains(&name.package.as_str());
        // Services include their messages, actions include their messages and services.
        let messages = self.catalog.messages().map(|message| &message.name).filter(is_here);
        let messages = messages.filter(|name| name.kind == Kind::Message).map(|name| ("Message", name));
        let services = self.catalog.services().map(|service| &service.name).filter(is_here);
        let services = services.filter(|name| name.kind == Kind::Service).map(|name| ("Service", name));
        let actions = self.catalog.actions().map(|action| ("Action", &action.name));
        let actions = actions.filter(|(_, name)| is_here(name));
        let mut source = format!(
            "/// The messages, services and actions of {}, to register them.\n\
             #[derive(Clone, Copy, Debug)]\npub struct INTERFACES;\n\n\
             impl {runtime}::InterfaceSet for INTERFACES {{\n    \
                 fn visit(&self, visitor: &mut impl {runtime}::InterfaceVisitor) {{\n",
            packages.iter().map(|package| format!("`{package}`")).collect::<Vec<_>>().join(", ")
        );
        for (of, name) in messages.chain(services).chain(actions) {
            let path = self.full_path("self", name);
            source.push_str(&format!(
                "        {runtime}::InterfaceSet::visit(&<{path} as {runtime}::{of}>::INTERFACES, visitor);\n"
            ));
        }
        source + "    }\n}\n"
    }

    fn for_each(&self, what: &str, which: &str, names: &[&TypeName]) -> String {
        let mut source = format!(
            "/// Calls the macro `callback` once, with the path of every {what} type here ({which}), separated by commas.\n\
             ///\n/// The callback matches them with `($($path:ty),* $(,)?)`.\n\
             #[macro_export]\nmacro_rules! for_each_{what} {{\n    ($callback:ident) => {{\n        $callback! {{\n"
        );
        for name in names {
            source.push_str(&format!("            {},\n", self.full_path("$crate", name)));
        }
        source.push_str("        }\n    };\n}\n\n");
        source
    }
}
