//! Generates Rust types from the interface files.

fn main() {
    downbeat_msgs_generator::compile("my_robot");
}
