//! Makes Rust types of the interface files.

fn main() {
    downbeat_msgs_generator::compile("my_robot");
}
