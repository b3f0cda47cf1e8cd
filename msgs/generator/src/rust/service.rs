//! The type of a service.

use super::names::struct_name;
use super::values::text_literal;
use super::{RustSource, docs};
use downbeat_msgs_definitions::{Error, ServiceDefinition};

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
