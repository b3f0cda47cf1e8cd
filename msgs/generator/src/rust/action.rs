//! The type of an action.

use super::names::struct_name;
use super::values::text_literal;
use super::{RustSource, docs};
use downbeat_msgs_definitions::{ActionDefinition, Error};

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
