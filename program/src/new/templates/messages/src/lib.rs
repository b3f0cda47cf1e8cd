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

    #[test]
    fn ros_builds_every_interface() -> Result<(), std::io::Error> {
        let listed = std::fs::read_to_string("my_robot/CMakeLists.txt")?;
        for folder in ["msg", "srv", "action"].map(|kind| format!("my_robot/{kind}")) {
            for file in std::fs::read_dir(folder)? {
                let path = file?.path().to_string_lossy().replace("my_robot/", "");
                assert!(
                    listed.contains(&format!("\"{path}\"")),
                    "my_robot/CMakeLists.txt does not list {path}"
                );
            }
        }
        Ok(())
    }
}
