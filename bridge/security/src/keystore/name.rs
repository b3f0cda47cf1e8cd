//! Names of enclaves, which are namespaces of ROS.

/// Why a text is no name of an enclave; `None` if it is one.
pub(super) fn problem(name: &str) -> Option<&'static str> {
    // The name becomes the common name of a certificate, which has no room for more (RFC 5280).
    const MAX_LENGTH: usize = 64;
    let Some(parts) = name.strip_prefix('/') else { return Some("it must begin with a slash") };
    let is_part = |part: &str| part.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    if name.len() > MAX_LENGTH {
        Some("it has more than 64 characters")
    } else if parts.is_empty() {
        None
    } else if parts.split('/').any(str::is_empty) {
        Some("it must not end with a slash or have two in a row")
    } else if !parts.split('/').all(is_part) {
        Some("only letters, digits, underscores and slashes may be in it")
    } else if parts.split('/').any(|part| part.starts_with(|letter: char| letter.is_ascii_digit())) {
        Some("none of its parts may begin with a digit")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_a_namespace_of_ros() {
        for name in ["/", "/talker", "/talker_listener/Talker2", "/_a"] {
            assert_eq!(problem(name), None, "{name}");
        }
        let long = format!("/{}", "a".repeat(64));
        let names = [
            ("", "it must begin with a slash"),
            ("talker", "it must begin with a slash"),
            ("/talker/", "it must not end with a slash or have two in a row"),
            ("//talker", "it must not end with a slash or have two in a row"),
            ("/../talker", "only letters, digits, underscores and slashes may be in it"),
            ("/tälker", "only letters, digits, underscores and slashes may be in it"),
            ("/a/2b", "none of its parts may begin with a digit"),
            (&long, "it has more than 64 characters"),
        ];
        for (name, expected) in names {
            assert_eq!(problem(name), Some(expected), "{name}");
        }
    }
}
