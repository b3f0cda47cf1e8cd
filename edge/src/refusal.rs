//! How a response of a service type says that its request was refused.
//!
//! ROS 2 has no refusals: a client waits until a response comes. So every refusal becomes a response, and the
//! fields of the type decide how much of it a client sees. They are found by their names in the definition,
//! so types that are known only at run time are treated alike.

use crate::KnownService;
use downbeat_msgs::action_msgs::msg::GoalStatus;
use downbeat_msgs::action_msgs::srv::CancelGoalResponse;
use downbeat_msgs::definitions::{Element, Primitive, Shape};
use downbeat_msgs::dynamic::{DynamicField, DynamicMessage, DynamicType, Value};
use std::fmt;

/// Names of a `bool` that is true if the request was granted, the most usual first.
const GRANTED: &[&str] = &[
    "success",
    "successful",
    "succeeded",
    "ok",
    "accepted",
    "granted",
    "is_success",
    "is_successful",
    "is_ok",
];

/// The same, of fields of the response itself only: in a message within it they are data.
const GRANTED_OUTSIDE: &[&str] = &["result", "status", "done", "valid", "is_valid"];

/// Names of a `bool` that is true if the request was not granted.
const REFUSED_OUTSIDE: &[&str] = &[
    "error",
    "failed",
    "failure",
    "refused",
    "rejected",
    "denied",
    "is_error",
    "has_error",
    "is_failed",
    "has_failed",
];

/// Names of a text for the reason, the most usual first.
const REASON: &[&str] = &[
    "message",
    "status_message",
    "error_message",
    "error_string",
    "failure_reason",
    "reason",
    "error_msg",
    "error_text",
    "error_description",
    "status_string",
    "status_text",
    "status_msg",
    "result_message",
    "error",
];

/// The same, of fields of the response itself only.
const REASON_OUTSIDE: &[&str] =
    &["msg", "status", "info", "description", "details", "text", "result", "response"];

/// How deep fields are looked for: `result.error_message` of simulation_interfaces is one level down.
const DEEPEST: usize = 2;

/// How a service type answers a request that was refused, see [`KnownService::refusals`].
#[derive(Clone, Debug)]
pub struct Refusals {
    /// `None` if the definition is unknown or no definition.
    response: Option<DynamicType>,
    /// Fields with the values that say no, by path.
    verdicts: Vec<(String, Value)>,
    /// The text that has the reason, by path.
    reason: Option<String>,
}

impl KnownService {
    /// How responses of this type say that a request was refused.
    #[must_use]
    pub fn refusals(self) -> Refusals {
        Refusals::of(self.name(), self.response_type())
    }
}

impl Refusals {
    fn of(service_type: &str, response: Option<DynamicType>) -> Self {
        let (mut verdicts, mut reason) = (Vec::new(), None);
        if service_type == "action_msgs/srv/CancelGoal" {
            verdicts.push(("return_code".to_owned(), Value::Int8(CancelGoalResponse::ERROR_REJECTED)));
        } else if is_part(service_type, "_GetResult") {
            // The goal is lost with its server.
            verdicts.push(("status".to_owned(), Value::Int8(GoalStatus::STATUS_ABORTED)));
            if let Some(result) = response.as_ref().and_then(|response| message_in(response, "result")) {
                let fields = Fields::of(&result);
                let within = |path: String| format!("result.{path}");
                let verdict = fields.verdict();
                reason = fields.reason(verdict.is_some()).map(within);
                verdicts.extend(verdict.map(|(path, value)| (within(path), value)));
            }
        } else if is_part(service_type, "_SendGoal") {
            verdicts.push(("accepted".to_owned(), Value::Bool(false)));
        } else if let Some(response) = &response {
            let fields = Fields::of(response);
            verdicts = fields.verdict().into_iter().collect();
            reason = fields.reason(!verdicts.is_empty());
        }
        Self { response, verdicts, reason }
    }

    /// Whether a client can tell a refusal from a response with default values.
    #[must_use]
    pub fn are_visible(&self) -> bool {
        self.response.is_some() && (!self.verdicts.is_empty() || self.reason.is_some())
    }

    /// The serialized response to a request that was refused for `reason`: all other fields have their
    /// defaults. Without a definition it is empty.
    #[must_use]
    pub fn response(&self, reason: &str) -> Vec<u8> {
        let Some(response) = &self.response else { return vec![0, 1, 0, 0] };
        let mut message = DynamicMessage::new(response);
        for (path, value) in &self.verdicts {
            // Found in the type with this very shape.
            let set = message.set(path, value.clone());
            debug_assert!(set.is_ok(), "{set:?}");
        }
        if let Some(path) = &self.reason {
            set_text(&mut message, path, reason);
        }
        message.to_cdr()
    }
}

/// The type of a field that is one message.
fn message_in(of: &DynamicType, name: &str) -> Option<DynamicType> {
    of.fields().find(|field| field.name == name)?.message
}

/// Sets a text that may be bounded: a long reason is cut.
fn set_text(message: &mut DynamicMessage, path: &str, reason: &str) {
    // A text in CDR ends at its first zero.
    let reason: String = reason.chars().filter(|letter| *letter != '\0').collect();
    let mut ends = reason.char_indices().map(|(at, _)| at).chain([reason.len()]).collect::<Vec<_>>();
    if message.set(path, reason.as_str()).is_ok() {
        return;
    }
    // The longest start that the bound admits.
    let (mut low, mut high) = (0, ends.len().saturating_sub(1));
    while low < high {
        let middle = (low + high).div_ceil(2);
        match message.set(path, &reason[..ends[middle]]) {
            Ok(()) => low = middle,
            Err(_) => high = middle - 1,
        }
    }
    ends.truncate(low + 1);
    let _ = message.set(path, &reason[..ends.last().copied().unwrap_or(0)]);
}

fn is_part(service_type: &str, part: &str) -> bool {
    service_type.contains("/action/") && service_type.ends_with(part)
}

impl fmt::Display for Refusals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.are_visible() {
            return f.write_str("default values, the type has no field for a refusal");
        }
        let mut separator = "";
        for (path, value) in &self.verdicts {
            let value = match value {
                Value::Bool(value) => value.to_string(),
                Value::Int8(value) => value.to_string(),
                value => format!("{value:?}"),
            };
            write!(f, "{separator}{path}: {value}")?;
            separator = ", ";
        }
        if let Some(path) = &self.reason {
            write!(f, "{separator}{path}: the reason")?;
        }
        Ok(())
    }
}

/// A field that is one `bool` or one text.
struct Leaf {
    path: String,
    name: String,
    depth: usize,
    is_text: bool,
}

/// The fields of a response that may say something about a refusal, the outermost first.
struct Fields(Vec<Leaf>);

impl Fields {
    fn of(response: &DynamicType) -> Self {
        let mut leaves = Vec::new();
        let mut level = vec![(String::new(), response.clone())];
        for depth in 0..=DEEPEST {
            let mut next = Vec::new();
            for (prefix, message) in &level {
                for DynamicField { name, field_type, message } in message.fields() {
                    if field_type.shape != Shape::Single {
                        continue;
                    }
                    let path = format!("{prefix}{name}");
                    let is_text = match (&field_type.element, message) {
                        (Element::Primitive(Primitive::Bool), _) => false,
                        (Element::String { .. } | Element::WString { .. }, _) => true,
                        (Element::Message(_), Some(message)) if depth < DEEPEST => {
                            next.push((format!("{path}."), message));
                            continue;
                        }
                        _ => continue,
                    };
                    leaves.push(Leaf { path, name: name.to_owned(), depth, is_text });
                }
            }
            level = next;
        }
        Self(leaves)
    }

    /// The outermost field with one of the names; `outside` are those that count in the response itself only.
    fn named(&self, names: &[&str], outside: &[&str], is_text: bool) -> Option<&Leaf> {
        let find = |name: &&str, depth| {
            let mut leaves = self.0.iter().filter(|leaf| leaf.depth == depth && leaf.is_text == is_text);
            leaves.find(|leaf| leaf.name.eq_ignore_ascii_case(name))
        };
        let inside = (1..=DEEPEST).flat_map(|depth| names.iter().map(move |name| (name, depth)));
        let outside = names.iter().chain(outside).map(|name| (name, 0));
        outside.chain(inside).find_map(|(name, depth)| find(name, depth))
    }

    /// The only field of its kind in the response itself.
    fn only(&self, is_text: bool) -> Option<&Leaf> {
        let mut found = self.0.iter().filter(|leaf| leaf.depth == 0 && leaf.is_text == is_text);
        found.next().filter(|_| found.next().is_none())
    }

    fn verdict(&self) -> Option<(String, Value)> {
        if let Some(leaf) = self.named(GRANTED, GRANTED_OUTSIDE, false) {
            return Some((leaf.path.clone(), Value::Bool(false)));
        }
        if let Some(leaf) = self.named(&[], REFUSED_OUTSIDE, false) {
            return Some((leaf.path.clone(), Value::Bool(true)));
        }
        self.only(false).map(|leaf| (leaf.path.clone(), Value::Bool(false)))
    }

    /// A text of an unusual name next to a verdict is the reason as well; alone, it may be what was asked
    /// for.
    fn reason(&self, has_verdict: bool) -> Option<String> {
        let only = || self.only(true).filter(|_| has_verdict);
        self.named(REASON, REASON_OUTSIDE, true).or_else(only).map(|leaf| leaf.path.clone())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::Interfaces;
    use downbeat_msgs::{Message, cdr};

    fn refusals(definition: &str) -> Refusals {
        let name = "my_msgs/srv/Ask_Response";
        let response = DynamicType::from_definition_text(name, "ros2msg", definition).unwrap();
        Refusals::of("my_msgs/srv/Ask", Some(response))
    }

    fn carried(name: &str) -> Refusals {
        Interfaces::carried().service(name).unwrap().refusals()
    }

    #[track_caller]
    fn assert_says<T: Message>(service: &str, expected: &T) {
        assert_eq!(&cdr::from_slice::<T>(&carried(service).response("why")).unwrap(), expected);
    }

    #[test]
    fn what_a_type_has_for_a_refusal_is_filled() {
        for (definition, expected) in [
            ("bool success\nstring message\n", "success: false, message: the reason"),
            ("bool success true\nstring<=4 message\nint32 count 7\n", "success: false, message: the reason"),
            ("int32 error_code\nstring error_string\n", "error_string: the reason"),
            ("string status\n", "status: the reason"),
            ("wstring status\nbool ok\n", "ok: false, status: the reason"),
            ("bool failed\nstring why\n", "failed: true, why: the reason"),
            ("bool is_door_open\n", "is_door_open: false"),
            ("string urdf\n", "default values, the type has no field for a refusal"),
            ("bool[] success\nstring[] message\n", "default values, the type has no field for a refusal"),
            (
                "my_msgs/Outcome outcome\nstring name\n===\nMSG: my_msgs/Outcome\nuint8 code\nbool success\nstring reason\n",
                "outcome.success: false, outcome.reason: the reason",
            ),
        ] {
            let definition = definition.replace("===\n", &format!("{}\n", "=".repeat(80)));
            assert_eq!(refusals(&definition).to_string(), expected, "{definition}");
        }
    }

    #[test]
    fn all_other_fields_have_their_defaults_and_a_long_reason_is_cut() {
        let refusals = refusals("bool success true\nstring<=5 message\nint32 count 7\n");
        let message =
            DynamicMessage::from_cdr(refusals.response.as_ref().unwrap(), &refusals.response("zähe\0s Öl"));
        let message = message.unwrap();
        assert_eq!(message.get("success").unwrap().as_bool(), Some(false));
        assert_eq!(message.get("message").unwrap().as_str(), Some("zähe"));
        assert_eq!(message.get("count").unwrap().as_i64(), Some(7));
    }

    #[test]
    fn every_carried_type_answers_with_a_response_of_its_type() {
        use downbeat_msgs::{
            composition_interfaces, nav_msgs, rcl_interfaces, simulation_interfaces, std_srvs,
        };
        assert_says("std_srvs/srv/Empty", &std_srvs::srv::EmptyResponse {});
        let response = std_srvs::srv::TriggerResponse { success: false, message: "why".into() };
        assert_says("std_srvs/srv/Trigger", &response);
        assert_says("nav_msgs/srv/SetMap", &nav_msgs::srv::SetMapResponse { success: false });
        assert_says(
            "composition_interfaces/srv/LoadNode",
            &composition_interfaces::srv::LoadNodeResponse {
                error_message: "why".into(),
                ..composition_interfaces::srv::LoadNodeResponse::default()
            },
        );
        let mut atomically = rcl_interfaces::srv::SetParametersAtomicallyResponse::default();
        atomically.result.reason = "why".into();
        assert_says("rcl_interfaces/srv/SetParametersAtomically", &atomically);
        let mut reset = simulation_interfaces::srv::ResetSimulationResponse::default();
        reset.result.error_message = "why".into();
        assert_says("simulation_interfaces/srv/ResetSimulation", &reset);
    }

    #[test]
    fn a_goal_is_rejected_and_its_result_is_that_of_a_goal_that_was_aborted() {
        use downbeat_msgs::control_msgs::action::{FollowJointTrajectory, FollowJointTrajectoryResult};
        use downbeat_msgs::{Action, Service};
        type Response<S> = <S as Service>::Response;
        let action = crate::KnownAction::of::<FollowJointTrajectory>();
        let rejected: Response<<FollowJointTrajectory as Action>::SendGoal> =
            cdr::from_slice(&action.send_goal().refusals().response("why")).unwrap();
        assert!(!FollowJointTrajectory::acceptance_of(rejected).0);
        let aborted: Response<<FollowJointTrajectory as Action>::GetResult> =
            cdr::from_slice(&action.get_result().refusals().response("why")).unwrap();
        let result = FollowJointTrajectoryResult { error_string: "why".into(), ..Default::default() };
        assert_eq!(FollowJointTrajectory::result_of(aborted), (GoalStatus::STATUS_ABORTED, result));
        let said = action.get_result().refusals().to_string();
        assert_eq!(said, "status: 6, result.error_string: the reason");
        let cancel: CancelGoalResponse =
            cdr::from_slice(&action.cancel_goal().refusals().response("why")).unwrap();
        assert_eq!(cancel.return_code, CancelGoalResponse::ERROR_REJECTED);
    }
}
