//! Generates the types of the messages in `interfaces`.

fn main() {
    downbeat_msgs_generator::Build::new().other_version("interfaces/simulation_interfaces").compile();
}
