fn main() {
    downbeat_msgs_generator::compile("my_msgs");
}
