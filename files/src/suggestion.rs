//! Suggestions for unknown names in error messages.

use std::fmt::Display;

/// The maximum number of names in a [`suggestion`].
const MOST_LISTED: usize = 16;

/// Longer names are not compared: the time grows with the square of the length.
const LONGEST_COMPARED: usize = 128;

/// Returns the candidate most similar to `name`, or `None` if none is similar. The comparison uses the part
/// after the last slash and ignores case.
pub fn nearest<T: Display>(name: &str, candidates: impl IntoIterator<Item = T>) -> Option<T> {
    let name = name.to_lowercase();
    let scored = candidates.into_iter().filter_map(|candidate| {
        let likeness = likeness(&name, &candidate.to_string().to_lowercase())?;
        Some((likeness, candidate))
    });
    // The first of equally similar ones.
    scored.reduce(|best, other| if other.0 > best.0 { other } else { best }).map(|(_, candidate)| candidate)
}

/// The end of an error message: `, did you mean "..."?` with the [`nearest`] candidate; `; there is ...` with
/// all candidates if none is like `name` and they are few; or an empty string.
pub fn suggestion<T: Display>(name: &str, candidates: impl IntoIterator<Item = T>) -> String {
    let candidates: Vec<T> = candidates.into_iter().collect();
    match nearest(name, &candidates) {
        Some(nearest) => format!(", did you mean \"{nearest}\"?"),
        None if (1..=MOST_LISTED).contains(&candidates.len()) => {
            let quoted: Vec<_> = candidates.iter().map(|name| format!("\"{name}\"")).collect();
            format!("; there is {}", quoted.join(", "))
        }
        None => String::new(),
    }
}

/// The similarity, up to 1 (equal); `None` if the parts after the last slash differ by more than a letter and
/// by more than about half.
fn likeness(name: &str, candidate: &str) -> Option<f64> {
    if name.len().max(candidate.len()) > LONGEST_COMPARED {
        return None;
    }
    let last = |name| str::rsplit_once(name, '/').map_or(name, |(_, last)| last);
    let (name_end, candidate_end) = (last(name), last(candidate));
    let of_ends = strsim::normalized_damerau_levenshtein(name_end, candidate_end);
    let is_similar = of_ends > 0.45 || strsim::damerau_levenshtein(name_end, candidate_end) <= 1;
    is_similar.then(|| (strsim::normalized_damerau_levenshtein(name, candidate) + of_ends) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::{nearest, suggestion};

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
            assert_eq!(nearest(wrong, known), meant, "{wrong}");
        }
    }

    #[test]
    fn the_nearest_name_is_suggested_and_far_ones_are_listed() {
        assert_eq!(suggestion("joint_sates", ["imu", "joint_states"]), ", did you mean \"joint_states\"?");
        assert_eq!(suggestion("xyz", ["imu", "joint_states"]), "; there is \"imu\", \"joint_states\"");
        assert_eq!(suggestion("xyz", [""; 0]), "");
    }

    #[test]
    fn names_that_nobody_writes_are_not_compared() {
        let long = "x".repeat(1 << 20);
        assert_eq!(nearest(&long, [&long]), None);
        assert_eq!(nearest("x", [&long]), None);
    }
}
