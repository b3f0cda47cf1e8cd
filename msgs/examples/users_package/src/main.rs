//! Writes and reads a message of this crate's own package `my_msgs`, and lists the interfaces to register.

use downbeat_msgs::{Action, InterfaceSet, InterfaceVisitor, Message, Service, cdr, geometry_msgs::msg::Point};

downbeat_msgs::include_interfaces!();

use lab_msgs::msg::Foot;
use my_msgs::action::{Walk, WalkGoal};
use my_msgs::{msg::Leg, srv::Kick};

/// The names of interfaces that are not part of another one.
#[derive(Default)]
struct Names(Vec<&'static str>);

impl InterfaceVisitor for Names {
    fn message<T: Message>(&mut self) {
        self.0.extend(T::TYPE_NAME.contains("/msg/").then_some(T::TYPE_NAME));
    }

    fn service<S: Service>(&mut self) {
        self.0.extend(S::TYPE_NAME.contains("/srv/").then_some(S::TYPE_NAME));
    }

    fn action<A: Action>(&mut self) {
        self.0.push(A::TYPE_NAME);
    }
}

fn main() -> Result<(), cdr::Error> {
    let foot = Foot { position: Point { z: -0.3, ..Point::default() }, contacts: vec!["heel".into()] };
    let leg = Leg { side: Leg::RIGHT, foot, ..Leg::default() };
    let bytes = cdr::to_vec(&leg);
    assert_eq!(cdr::from_slice::<Leg>(&bytes)?, leg);

    println!("{} {} bytes", Leg::TYPE_NAME, bytes.len());
    println!("{}", Leg::TYPE_HASH);
    println!("{} {:?}", Kick::TYPE_NAME, <Kick as Service>::Request::default());
    println!("{} {:?}", Walk::TYPE_NAME, WalkGoal { steps: 3 });
    let mut names = Names::default();
    INTERFACES.visit(&mut names);
    println!("{}", names.0.join(" "));
    Ok(())
}
