//! Writes and reads a message of this crate's own package `my_msgs`.

use downbeat_msgs::{Action, Message, Service, cdr, geometry_msgs::msg::Point};

downbeat_msgs::include_interfaces!();

use lab_msgs::msg::Foot;
use my_msgs::action::{Walk, WalkGoal};
use my_msgs::{msg::Leg, srv::Kick};

fn main() -> Result<(), cdr::Error> {
    let foot = Foot { position: Point { z: -0.3, ..Point::default() }, contacts: vec!["heel".into()] };
    let leg = Leg { side: Leg::RIGHT, foot, ..Leg::default() };
    let bytes = cdr::to_vec(&leg);
    assert_eq!(cdr::from_slice::<Leg>(&bytes)?, leg);

    println!("{} {} bytes", Leg::TYPE_NAME, bytes.len());
    println!("{}", Leg::TYPE_HASH);
    println!("{} {:?}", Kick::TYPE_NAME, <Kick as Service>::Request::default());
    println!("{} {:?}", Walk::TYPE_NAME, WalkGoal { steps: 3 });
    Ok(())
}
