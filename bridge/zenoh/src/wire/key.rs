//! Key expressions of topics and services.

/// Stands for the hash of a type whose definition is not known, as `rmw_zenoh_cpp` of Humble writes it.
pub const NO_HASH: &str = "TypeHashNotSupported";

/// The key of a topic or service: `0/robot/chatter/std_msgs::msg::dds_::String_/RIHS01_…`. `name` is
/// absolute, `type_name` as on DDS, for a service without `_Request_`, and `hash` that of the message or the
/// service.
#[must_use]
pub fn key(domain_id: u16, name: &str, type_name: &str, hash: Option<&str>) -> String {
    format!("{domain_id}/{}/{type_name}/{}", name.trim_matches('/'), hash.unwrap_or(NO_HASH))
}

/// Selects the keys of a topic whatever the hash of its type.
#[must_use]
pub fn keys_of_any_hash(domain_id: u16, name: &str, type_name: &str) -> String {
    key(domain_id, name, type_name, Some("*"))
}
