//! Generates the types of `robot_msgs`.

fn main() {
    downbeat_msgs_generator::compile("robot_msgs");
}
