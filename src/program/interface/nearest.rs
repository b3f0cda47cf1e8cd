//! The name that was meant.

/// The candidate most like `name`, if one is at all like it. The part behind the last slash says most.
pub(super) fn nearest(name: &str, candidates: impl Iterator<Item = String>) -> Option<String> {
    let scored = candidates.map(|candidate| (likeness(name, &candidate), candidate));
    let (score, candidate) = scored.max_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (score > 0.9).then_some(candidate)
}

/// From 0, nothing alike, to 2, the same.
fn likeness(name: &str, candidate: &str) -> f64 {
    let short = |name: &str| name.rsplit('/').next().unwrap_or(name).to_lowercase();
    strsim::normalized_damerau_levenshtein(name, candidate)
        + strsim::normalized_damerau_levenshtein(&short(name), &short(candidate))
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn the_part_behind_the_last_slash_decides_and_far_names_are_no_answer() {
        let known = ["std_msgs/msg/String", "std_msgs/msg/Int8", "sensor_msgs/msg/Imu"];
        for (wrong, meant) in [
            ("std_msgs/String", Some("std_msgs/msg/String")),
            ("string", Some("std_msgs/msg/String")),
            ("std_msgs/msg/Strnig", Some("std_msgs/msg/String")),
            ("sensor_msgs/srv/Imu", Some("sensor_msgs/msg/Imu")),
            ("xyz", None),
        ] {
            assert_eq!(nearest(wrong, known.iter().map(ToString::to_string)).as_deref(), meant, "{wrong}");
        }
    }
}
