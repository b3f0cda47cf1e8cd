//! Messages, services and actions for ROS 2 and downbeat, from the files in the folder `my_robot`.

downbeat_msgs::include_interfaces!();

#[cfg(test)]
mod tests {
    use downbeat_msgs::{Message, cdr};

    use crate::my_robot::msg::HeadTilt;

    #[test]
    fn a_message_round_trips() -> Result<(), cdr::Error> {
        let tilt = HeadTilt { angle: 0.25, ..HeadTilt::default() };
        assert_eq!(cdr::from_slice::<HeadTilt>(&cdr::to_vec(&tilt))?, tilt);
        assert_eq!(HeadTilt::TYPE_NAME, "my_robot/msg/HeadTilt");
        Ok(())
    }
}
