//! Names of topics and services.

/// The name without a leading slash, or `None` if it is not a valid topic name.
pub(crate) fn canonical_name(name: &str) -> Option<&str> {
    let name = name.strip_prefix('/').unwrap_or(name);
    let is_valid = |part: &str| {
        !part.is_empty()
            && !part.starts_with(|c: char| c.is_ascii_digit())
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    name.split('/').all(is_valid).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_name_follows_the_rules_of_ros() {
        assert_eq!(canonical_name("/imu/data_raw"), Some("imu/data_raw"));
        for wrong in ["", "/", "a//b", "a/", "1st", "a b", "a-b"] {
            assert_eq!(canonical_name(wrong), None, "{wrong:?}");
        }
    }
}
