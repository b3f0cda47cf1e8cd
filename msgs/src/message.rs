//! The traits of generated types.

use std::fmt::Debug;
use std::marker::PhantomData;

use crate::builtin_interfaces::msg::Time;
use crate::cdr::Cdr;
use crate::description::{Description, Element, Field, FieldType, FieldValue, Shape};
use crate::service_msgs::msg::ServiceEventInfo;
use crate::type_description_interfaces::msg::TypeDescription;
use crate::unique_identifier_msgs::msg::UUID;

/// A ROS 2 message.
pub trait Message: Cdr + Clone + Default + Debug + PartialEq + Send + Sync + 'static {
    /// As in `sensor_msgs/msg/JointState`.
    const TYPE_NAME: &'static str;
    /// `RIHS01_` and 64 hexadecimal digits.
    const TYPE_HASH: &'static str;
    /// The `ros2msg` text with all dependencies, as rosbag2 stores it.
    const DEFINITION: &'static str;
    /// Its fields, in order.
    const FIELDS: &'static [Field];

    /// Name, fields and definition in one.
    const DESCRIPTION: &'static Description =
        &Description { type_name: Self::TYPE_NAME, definition: Self::DEFINITION, fields: Self::FIELDS };

    /// The interface set of this message, for registration.
    const INTERFACES: OneMessage<Self> = OneMessage::NEW;

    /// The type description that a node returns from `~/get_type_description`.
    #[must_use]
    fn type_description() -> TypeDescription {
        Self::DESCRIPTION.to_message()
    }
}

/// A ROS 2 service. Types that implement it have no values; they only name it.
pub trait Service: Sized + Send + Sync + 'static {
    /// As in `std_srvs/srv/SetBool`.
    const TYPE_NAME: &'static str;
    /// `RIHS01_` and 64 hexadecimal digits.
    const TYPE_HASH: &'static str;
    /// The definition text with all dependencies, as rosbag2 stores it for service events.
    const DEFINITION: &'static str;
    /// The message that a client sends.
    type Request: Message;
    /// The message that the server replies with.
    type Response: Message;
    /// The message that service introspection publishes.
    type Event: Message;

    /// Name, fields and definition in one: ROS 2 describes a service like a message with its three messages
    /// as fields.
    const DESCRIPTION: &'static Description = &Description {
        type_name: Self::TYPE_NAME,
        definition: Self::DEFINITION,
        fields: &[
            Field::of::<Self::Request>("request_message"),
            Field::of::<Self::Response>("response_message"),
            Field::of::<Self::Event>("event_message"),
        ],
    };

    /// The interface set of this service and its messages, for registration.
    const INTERFACES: OneService<Self> = OneService::NEW;

    /// The type description that a node returns from `~/get_type_description`.
    #[must_use]
    fn type_description() -> TypeDescription {
        Self::DESCRIPTION.to_message()
    }

    /// Creates the message that service introspection publishes.
    #[must_use]
    fn event(
        info: ServiceEventInfo,
        request: Option<Self::Request>,
        response: Option<Self::Response>,
    ) -> Self::Event;
}

/// The request of a service.
type Request<S> = <S as Service>::Request;

/// The response of a service.
type Response<S> = <S as Service>::Response;

/// A ROS 2 action. Types that implement it have no values; they only name it.
///
/// Its functions assemble and split the messages between client and server, for code that is generic over
/// actions.
pub trait Action: Sized + Send + Sync + 'static {
    /// As in `test_msgs/action/Fibonacci`.
    const TYPE_NAME: &'static str;
    /// `RIHS01_` and 64 hexadecimal digits.
    const TYPE_HASH: &'static str;
    /// The definition text with all dependencies.
    const DEFINITION: &'static str;
    /// The goal that a client sends.
    type Goal: Message;
    /// The final result of a goal.
    type Result: Message;
    /// The progress of a goal.
    type Feedback: Message;
    /// The service `<action>/_action/send_goal`.
    type SendGoal: Service;
    /// The service `<action>/_action/get_result`.
    type GetResult: Service;
    /// The message on the topic `<action>/_action/feedback`.
    type FeedbackMessage: Message;

    /// Name, fields and definition in one: ROS 2 describes an action like a message with its messages and
    /// services as fields.
    const DESCRIPTION: &'static Description = &Description {
        type_name: Self::TYPE_NAME,
        definition: Self::DEFINITION,
        fields: &[
            Field::of::<Self::Goal>("goal"),
            Field::of::<Self::Result>("result"),
            Field::of::<Self::Feedback>("feedback"),
            service_field("send_goal_service", <Self::SendGoal as Service>::DESCRIPTION),
            service_field("get_result_service", <Self::GetResult as Service>::DESCRIPTION),
            Field::of::<Self::FeedbackMessage>("feedback_message"),
        ],
    };

    /// The interface set of this action, its services and its messages, for registration.
    const INTERFACES: OneAction<Self> = OneAction::NEW;

    /// The type description that a node returns from `~/get_type_description`.
    #[must_use]
    fn type_description() -> TypeDescription {
        Self::DESCRIPTION.to_message()
    }

    /// A request of `send_goal`.
    #[must_use]
    fn send_goal_request(goal_id: UUID, goal: Self::Goal) -> Request<Self::SendGoal>;

    /// The goal of a request of `send_goal`, and its id.
    #[must_use]
    fn goal_of(request: Request<Self::SendGoal>) -> (UUID, Self::Goal);

    /// A response of `send_goal`: whether the goal was accepted, and when.
    #[must_use]
    fn send_goal_response(accepted: bool, stamp: Time) -> Response<Self::SendGoal>;

    /// Returns whether a goal was accepted, and when.
    #[must_use]
    fn acceptance_of(response: Response<Self::SendGoal>) -> (bool, Time);

    /// A request of `get_result`.
    #[must_use]
    fn get_result_request(goal_id: UUID) -> Request<Self::GetResult>;

    /// The goal whose result is requested.
    #[must_use]
    fn goal_id_of(request: Request<Self::GetResult>) -> UUID;

    /// A response of `get_result`; the status is one of `action_msgs/msg/GoalStatus`.
    #[must_use]
    fn get_result_response(status: i8, result: Self::Result) -> Response<Self::GetResult>;

    /// The status in which a goal ended, and its result.
    #[must_use]
    fn result_of(response: Response<Self::GetResult>) -> (i8, Self::Result);

    /// A message of the topic `feedback`.
    #[must_use]
    fn feedback_message(goal_id: UUID, feedback: Self::Feedback) -> Self::FeedbackMessage;

    /// The goal id and the feedback in a message of the topic `feedback`.
    #[must_use]
    fn feedback_of(message: &Self::FeedbackMessage) -> (UUID, &Self::Feedback);
}

/// The set of one message, [`Message::INTERFACES`].
pub struct OneMessage<T>(PhantomData<fn() -> T>);

/// The set of one service and its messages, [`Service::INTERFACES`].
pub struct OneService<S>(PhantomData<fn() -> S>);

/// The set of one action, its services and its messages, [`Action::INTERFACES`].
pub struct OneAction<A>(PhantomData<fn() -> A>);

impl<T> OneMessage<T> {
    const NEW: Self = Self(PhantomData);
}

impl<S> OneService<S> {
    const NEW: Self = Self(PhantomData);
}

impl<A> OneAction<A> {
    const NEW: Self = Self(PhantomData);
}

impl<T: Message> FieldValue for T {
    const FIELD_TYPE: FieldType =
        FieldType { element: Element::Message(T::DESCRIPTION), shape: Shape::Single };
}

const fn service_field(name: &'static str, service: &'static Description) -> Field {
    let field_type = FieldType { element: Element::Message(service), shape: Shape::Single };
    Field { name, field_type, default_value: "" }
}

#[cfg(test)]
mod tests {
    use super::{Message, Service};

    #[test]
    fn published_hashes_are_reproduced() {
        use crate::{geometry_msgs::msg::Twist, std_msgs::msg};
        assert_eq!(
            msg::String::TYPE_HASH,
            "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
        );
        assert_eq!(
            msg::Header::TYPE_HASH,
            "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"
        );
        assert_eq!(
            Twist::TYPE_HASH,
            "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
        );
    }

    #[test]
    fn a_service_names_its_messages() {
        type SetBool = crate::std_srvs::srv::SetBool;
        assert_eq!(SetBool::TYPE_NAME, "std_srvs/srv/SetBool");
        assert_eq!(<SetBool as Service>::Request::TYPE_NAME, "std_srvs/srv/SetBool_Request");
        let event = <SetBool as Service>::Event::DEFINITION;
        assert!(event.contains("\nstd_srvs/srv/SetBool_Request[<=1] request\n"), "{event}");
        assert!(event.contains("\nMSG: std_srvs/srv/SetBool_Request\nbool data"), "{event}");
    }

    #[test]
    fn an_event_holds_the_request_or_the_response() {
        use crate::service_msgs::msg::ServiceEventInfo;
        use crate::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
        let info = ServiceEventInfo { sequence_number: 7, ..ServiceEventInfo::default() };
        let (request, response) = (SetBoolRequest { data: true }, SetBoolResponse::default());
        let event = SetBool::event(info, Some(request), None);
        assert_eq!(
            (event.info.sequence_number, &event.request[..], event.response.len()),
            (7, &[request][..], 0)
        );
        let event = SetBool::event(info, None, Some(response.clone()));
        assert_eq!((event.request.len(), &event.response[..]), (0, &[response][..]));
    }

    #[cfg(feature = "test_msgs")]
    #[test]
    fn splitting_the_messages_of_an_action_returns_their_parts() {
        use super::Action;
        use crate::test_msgs::action::{Fibonacci, FibonacciFeedback, FibonacciGoal, FibonacciResult};
        use crate::{builtin_interfaces::msg::Time, unique_identifier_msgs::msg::UUID};
        let (id, stamp) = (UUID { uuid: [7; 16] }, Time { sec: 1, nanosec: 2 });
        let goal = FibonacciGoal { order: 9 };
        assert_eq!(Fibonacci::goal_of(Fibonacci::send_goal_request(id, goal)), (id, goal));
        assert_eq!(Fibonacci::acceptance_of(Fibonacci::send_goal_response(true, stamp)), (true, stamp));
        assert_eq!(Fibonacci::goal_id_of(Fibonacci::get_result_request(id)), id);
        let result = FibonacciResult { sequence: vec![0, 1, 1] };
        let response = Fibonacci::get_result_response(4, result.clone());
        assert_eq!(Fibonacci::result_of(response), (4, result));
        let feedback = FibonacciFeedback { sequence: vec![0, 1] };
        let message = Fibonacci::feedback_message(id, feedback.clone());
        assert_eq!(Fibonacci::feedback_of(&message), (id, &feedback));
    }

    #[test]
    fn defaults_are_those_of_the_definition() {
        let unit = crate::geometry_msgs::msg::Quaternion::default();
        assert_eq!((unit.x, unit.y, unit.z, unit.w), (0.0, 0.0, 0.0, 1.0));
    }

    #[test]
    fn the_registry_holds_every_type_once() {
        macro_rules! names {
            ($($message:ty),* $(,)?) => { [$(<$message>::TYPE_NAME),*] };
        }
        assert_eq!(for_each_message!(names), crate::TYPE_NAMES);
        let mut distinct = crate::TYPE_NAMES.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), crate::TYPE_NAMES.len());
        assert!(crate::TYPE_NAMES.contains(&"downbeat_interfaces/msg/BusExchange"));
    }
}
