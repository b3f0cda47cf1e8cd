//! The type that stands for an action.

use super::names::struct_name;
use super::values::text_literal;
use super::{RustSource, docs};
use downbeat_msgs_definitions::{ActionDefinition, Error};

impl RustSource<'_> {
    pub(super) fn action(&self, action: &ActionDefinition) -> Result<String, Error> {
        let name = struct_name(&action.name);
        let definition = self.catalog.definition_text(&action.name)?;
        let mut source = docs::doc(&[], &action.name.to_string(), "");
        // Without values: it is only ever named.
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
        source.push_str("}\n");
        Ok(source)
    }
}
