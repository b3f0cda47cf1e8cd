//! Generates the types of `my_msgs`.

fn main() {
    downbeat_msgs_generator::compile("my_msgs");
}
