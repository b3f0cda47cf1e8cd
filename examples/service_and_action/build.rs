//! Generates the types of `gripper_msgs`.

fn main() {
    downbeat_msgs_generator::compile("gripper_msgs");
}
