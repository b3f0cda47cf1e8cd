//! What to do about a Rust type that is not registered.

/// The call that registers a type with an app: `.interfaces(my_msgs::INTERFACES)`. `None` if that is no type of somebody's crate, so
/// that there is none.
///
/// Types that are generated lie in the modules `package::msg`, `package::srv` or `package::action` beside their set; any other
/// message is a set of itself.
pub(crate) fn registering_call(rust_type: &str) -> Option<String> {
    let parts: Vec<&str> = rust_type.split("::").collect();
    let is_path = parts.iter().all(|part| part.chars().all(|c| c.is_alphanumeric() || c == '_'));
    if parts.len() < 2 || !is_path || ["alloc", "core", "std"].contains(&parts[0]) {
        return None;
    }
    match parts.as_slice() {
        [place @ .., _package, "msg" | "srv" | "action", _name] if !place.is_empty() => {
            Some(format!(".interfaces({}::INTERFACES)", place.join("::")))
        }
        _ => Some(format!(".interfaces({rust_type}::INTERFACES)")),
    }
}

/// What is wrong with a type that ROS 2 is to see, and what to do: the end of a sentence that names the type.
pub(crate) fn unregistered(rust_type: &str, what: &str) -> String {
    match registering_call(rust_type) {
        Some(call) => format!("which is not registered: if it is a {what}, add `{call}` to the app"),
        None => format!("which is no {what}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_call_names_the_set_that_has_the_type() {
        for (rust_type, call) in [
            ("my_msgs::my_msgs::msg::Tilt", Some(".interfaces(my_msgs::INTERFACES)")),
            ("my_robot::seen::my_msgs::srv::LevelRequest", Some(".interfaces(my_robot::seen::INTERFACES)")),
            ("my_robot::head::Tilt", Some(".interfaces(my_robot::head::Tilt::INTERFACES)")),
            ("my_robot::Stamped<my_robot::Tilt>", None),
            ("alloc::string::String", None),
            ("u32", None),
            ("(u8, my_robot::Tilt)", None),
        ] {
            assert_eq!(registering_call(rust_type).as_deref(), call, "{rust_type}");
        }
    }
}
