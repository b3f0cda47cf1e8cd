fn main() {
    downbeat_msgs_generator::Build::new().package("my_msgs").packages("lab").compile();
}
