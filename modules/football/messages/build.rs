//! Generates the types of the messages in `interfaces`.

fn main() {
    downbeat_msgs_generator::Build::new().packages("interfaces").compile();
}
