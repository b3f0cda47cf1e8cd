//! The types of services and actions, and the lists of all types.

use downbeat_msgs_definitions::{ActionDefinition, Error, Kind, ServiceDefinition, TypeName};

use super::names::struct_name;
use super::values::text_literal;
use super::{RustSource, docs};

impl RustSource<'_> {
    pub(super) fn service(&self, service: &ServiceDefinition) -> Result<String, Error> {
        let name = struct_name(&service.name);
        let definition = self.catalog.service_definition_text(&service.name)?;
        let mut source = docs::doc(&[], &service.name.to_string(), "");
        // Has no values: it is only named.
        source.push_str(&format!(
            "pub enum {name} {{}}\n\nimpl {}::Service for {name} {{\n",
            self.modules.runtime
        ));
        source.push_str(&format!("    const TYPE_NAME: &'static str = \"{}\";\n", service.name));
        source.push_str(&docs::hash_line(&self.catalog.type_hash(&service.name)?));
        source.push_str(&format!("    const DEFINITION: &'static str = {};\n", text_literal(&definition)));
        for part in ["Request", "Response", "Event"] {
            source.push_str(&format!("    type {part} = {name}{part};\n"));
        }
        let runtime = &self.modules.runtime;
        source.push_str(&format!(
            "\n    fn event(\n        \
                 info: {runtime}::service_msgs::msg::ServiceEventInfo,\n        \
                 request: ::core::option::Option<{name}Request>,\n        \
                 response: ::core::option::Option<{name}Response>,\n    ) -> {name}Event {{\n        \
                 {name}Event {{ info, request: request.into_iter().collect(), response: response.into_iter().collect() }}\n    \
                 }}\n"
        ));
        source.push_str("}\n");
        Ok(source)
    }
}

impl RustSource<'_> {
    pub(super) fn action(&self, action: &ActionDefinition) -> Result<String, Error> {
        let name = struct_name(&action.name);
        let definition = self.catalog.definition_text(&action.name)?;
        let mut source = docs::doc(&[], &action.name.to_string(), "");
        // Has no values: it is only named.
        source.push_str(&format!(
            "pub enum {name} {{}}\n\nimpl {}::Action for {name} {{\n",
            self.modules.runtime
        ));
        source.push_str(&format!("    const TYPE_NAME: &'static str = \"{}\";\n", action.name));
        source.push_str(&docs::hash_line(&self.catalog.type_hash(&action.name)?));
        source.push_str(&format!("    const DEFINITION: &'static str = {};\n", text_literal(&definition)));
        for part in ["Goal", "Result", "Feedback", "SendGoal", "GetResult", "FeedbackMessage"] {
            source.push_str(&format!("    type {part} = {name}{part};\n"));
        }
        source.push_str(&self.parts(&name));
        source.push_str("}\n");
        Ok(source)
    }

    /// The functions that assemble and split the messages of an action.
    fn parts(&self, name: &str) -> String {
        let uuid = format!("{}::unique_identifier_msgs::msg::UUID", self.modules.runtime);
        let time = format!("{}::builtin_interfaces::msg::Time", self.modules.runtime);
        let message = |part: &str| format!("{name}{part}");
        let mut source = String::new();
        for (part, make, take, first, second) in [
            (
                "SendGoalRequest",
                "send_goal_request",
                "goal_of",
                ("goal_id", &uuid),
                ("goal", &message("Goal")),
            ),
            (
                "SendGoalResponse",
                "send_goal_response",
                "acceptance_of",
                ("accepted", &"bool".into()),
                ("stamp", &time),
            ),
            (
                "GetResultResponse",
                "get_result_response",
                "result_of",
                ("status", &"i8".into()),
                ("result", &message("Result")),
            ),
        ] {
            let ((first, first_type), (second, second_type)) = (first, second);
            source.push_str(&format!(
                "\n    fn {make}({first}: {first_type}, {second}: {second_type}) -> {name}{part} {{\n        \
                     {name}{part} {{ {first}, {second} }}\n    }}\n\n    \
                     fn {take}(message: {name}{part}) -> ({first_type}, {second_type}) {{\n        \
                     (message.{first}, message.{second})\n    }}\n"
            ));
        }
        source.push_str(&format!(
            "\n    fn get_result_request(goal_id: {uuid}) -> {name}GetResultRequest {{\n        \
                 {name}GetResultRequest {{ goal_id }}\n    }}\n\n    \
                 fn goal_id_of(request: {name}GetResultRequest) -> {uuid} {{\n        request.goal_id\n    }}\n\n    \
                 fn feedback_message(goal_id: {uuid}, feedback: {name}Feedback) -> {name}FeedbackMessage {{\n        \
                 {name}FeedbackMessage {{ goal_id, feedback }}\n    }}\n\n    \
                 fn feedback_of(message: &{name}FeedbackMessage) -> ({uuid}, &{name}Feedback) {{\n        \
                 (message.goal_id, &message.feedback)\n    }}\n"
        ));
        source
    }
}

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
