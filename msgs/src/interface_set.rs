//! Sets of interfaces, which a crate of messages passes to a program that exposes, records and shows them.

use crate::message::{Action, Message, OneAction, OneMessage, OneService, Service};

/// A set of messages, services and actions, for code that handles each of them, such as a bridge or a
/// recorder.
///
/// [`include_interfaces!`](crate::include_interfaces) declares the set of everything it includes,
/// [`interfaces!`](crate::interfaces) a set of the given types, and every message, service and action has a
/// set of itself: `Leg::INTERFACES`. A tuple of sets is a set.
///
/// ```
/// use downbeat_msgs::{InterfaceSet, InterfaceVisitor, Message, Service, Action, std_msgs, std_srvs};
///
/// /// Collects names.
/// #[derive(Default)]
/// struct Names(Vec<&'static str>);
///
/// impl InterfaceVisitor for Names {
///     fn message<T: Message>(&mut self) {
///         self.0.push(T::TYPE_NAME);
///     }
///     fn service<S: Service>(&mut self) {
///         self.0.push(S::TYPE_NAME);
///     }
///     fn action<A: Action>(&mut self) {
///         self.0.push(A::TYPE_NAME);
///     }
/// }
///
/// let mut names = Names::default();
/// (std_msgs::msg::Header::INTERFACES, std_srvs::srv::Empty::INTERFACES).visit(&mut names);
/// assert_eq!(names.0, [
///     "std_msgs/msg/Header",
///     "std_srvs/srv/Empty",
///     "std_srvs/srv/Empty_Request",
///     "std_srvs/srv/Empty_Response",
///     "std_srvs/srv/Empty_Event",
/// ]);
/// ```
pub trait InterfaceSet {
    /// Calls the visitor for each interface: a service before its messages, an action before its messages and
    /// services. Duplicates are visited twice.
    fn visit(&self, visitor: &mut impl InterfaceVisitor);
}

/// Handles every interface of a set.
pub trait InterfaceVisitor {
    /// Visits a message, possibly one of a service or an action.
    fn message<T: Message>(&mut self);

    /// Visits a service, possibly one of an action.
    fn service<S: Service>(&mut self);

    /// Visits an action.
    fn action<A: Action>(&mut self);
}

impl<T: Message> InterfaceSet for OneMessage<T> {
    fn visit(&self, visitor: &mut impl InterfaceVisitor) {
        visitor.message::<T>();
    }
}

impl<S: Service> InterfaceSet for OneService<S> {
    fn visit(&self, visitor: &mut impl InterfaceVisitor) {
        visitor.service::<S>();
        visitor.message::<S::Request>();
        visitor.message::<S::Response>();
        visitor.message::<S::Event>();
    }
}

impl<A: Action> InterfaceSet for OneAction<A> {
    fn visit(&self, visitor: &mut impl InterfaceVisitor) {
        visitor.action::<A>();
        visitor.message::<A::Goal>();
        visitor.message::<A::Result>();
        visitor.message::<A::Feedback>();
        A::SendGoal::INTERFACES.visit(visitor);
        A::GetResult::INTERFACES.visit(visitor);
        visitor.message::<A::FeedbackMessage>();
    }
}

impl<S: InterfaceSet> InterfaceSet for &S {
    fn visit(&self, visitor: &mut impl InterfaceVisitor) {
        (**self).visit(visitor);
    }
}

macro_rules! tuple {
    ($($set:ident $index:tt),*) => {
        impl<$($set: InterfaceSet),*> InterfaceSet for ($($set,)*) {
            fn visit(&self, visitor: &mut impl InterfaceVisitor) {
                $(self.$index.visit(visitor);)*
            }
        }
    };
}
tuple!(A 0);
tuple!(A 0, B 1);
tuple!(A 0, B 1, C 2);
tuple!(A 0, B 1, C 2, D 3);
tuple!(A 0, B 1, C 2, D 3, E 4);
tuple!(A 0, B 1, C 2, D 3, E 4, F 5);

/// Declares a set of messages, services and actions that a program registers, for example for a crate with
/// derived messages.
///
/// ```
/// use downbeat_msgs::Message;
///
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(name = "my_msgs/msg/Tilt")]
/// pub struct Tilt {
///     pub angle: f64,
/// }
///
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(name = "my_msgs/msg/Reach")]
/// pub struct Reach {
///     pub distance: f64,
/// }
///
/// downbeat_msgs::interfaces! {
///     /// The messages of this robot.
///     pub INTERFACES: Tilt, Reach
/// }
/// # fn register(_: impl downbeat_msgs::InterfaceSet) {}
/// register(INTERFACES);
/// ```
#[macro_export]
macro_rules! interfaces {
    ($(#[$attribute:meta])* $visibility:vis $name:ident: $($interface:ty),* $(,)?) => {
        $(#[$attribute])*
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)] // Used as a constant.
        #[derive(Clone, Copy, Debug)]
        $visibility struct $name;

        impl $crate::InterfaceSet for $name {
            fn visit(&self, visitor: &mut impl $crate::InterfaceVisitor) {
                #[allow(unused_imports)]
                use $crate::{Action as _, InterfaceSet as _, Message as _, Service as _};
                let _ = &visitor;
                $(<$interface>::INTERFACES.visit(visitor);)*
            }
        }
    };
}
