//! The name of a project.

use std::path::Path;

use anyhow::bail;

/// A name that both cargo and ROS 2 accept for a package.
#[derive(Debug)]
pub(super) struct Name(String);

/// The name in the templates.
const TEMPLATE: &str = "my_robot";

/// Keywords of Rust, crates available in every program, and names that cargo rejects.
const TAKEN: &str = "abstract alloc as async await become box break build const continue core crate deps do downbeat \
    downbeat_actions downbeat_bags downbeat_bridge downbeat_darwin_op downbeat_device downbeat_executor downbeat_imu_filter \
    downbeat_kinematics downbeat_msgs downbeat_servos downbeat_transforms dyn else enum examples extern false final fn for gen if impl in incremental let loop macro main match mod move mut \
    override priv proc_macro pub ref return self static std struct super test tests trait true try type \
    typeof unsafe unsized use virtual where while yield";

impl Name {
    /// The last part of a path.
    pub(super) fn of_folder(folder: &Path) -> anyhow::Result<Self> {
        let Some(name) = folder.file_name() else {
            bail!(
                "{} does not end in a name; give the folder of the project, such as my_robot",
                folder.display()
            );
        };
        Self::parse(&name.to_string_lossy())
    }

    fn parse(name: &str) -> anyhow::Result<Self> {
        if TAKEN.split(' ').any(|taken| taken == name) || downbeat_msgs_has(name) {
            bail!(
                "a project cannot be named \"{name}\", which is used by Rust, ROS 2 or downbeat; did you mean \"my_{name}\"?"
            );
        }
        let nearest = nearest(name);
        if name != nearest {
            bail!(
                "\"{name}\" is not a valid ROS 2 package name: a name has two or more lower-case letters, digits and single \
                 underscores, and begins with a letter; did you mean \"{nearest}\"?"
            );
        }
        Ok(Self(nearest))
    }

    /// Replaces the template's name.
    pub(super) fn put_into(&self, text: &str) -> String {
        text.replace(TEMPLATE, &self.0)
    }
}

/// Returns whether downbeat has a built-in package of that name.
fn downbeat_msgs_has(name: &str) -> bool {
    downbeat_bridge::edge::Interfaces::carried()
        .messages()
        .any(|message| message.name().split_once('/').is_some_and(|(package, _)| package == name))
}

/// The nearest valid name.
fn nearest(name: &str) -> String {
    let lower = name.trim().to_lowercase();
    let words = lower.split(|c: char| !c.is_ascii_lowercase() && !c.is_ascii_digit());
    let joined = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_");
    match joined.as_bytes() {
        [] => TEMPLATE.to_owned(),
        [b'0'..=b'9', ..] | [_] => format!("robot_{joined}"),
        _ => joined,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_valid_for_cargo_and_ros_or_refused_with_the_nearest_one() {
        for name in ["my_robot", "nao6", "r2_d2", "ab"] {
            assert!(Name::parse(name).is_ok(), "{name}");
        }
        for (name, nearest) in [
            ("my-robot", "my_robot"),
            ("MyRobot", "myrobot"),
            ("my__robot_", "my_robot"),
            ("2nd", "robot_2nd"),
            ("x", "robot_x"),
            ("ro bot", "ro_bot"),
            ("größe", "gr_e"),
            ("...", "my_robot"),
            ("fn", "my_fn"),
            ("downbeat", "my_downbeat"),
            ("std_msgs", "my_std_msgs"),
        ] {
            let error = Name::parse(name).map(|_| ()).map_err(|error| error.to_string());
            let wanted = format!("did you mean \"{nearest}\"?");
            assert!(error.as_ref().is_err_and(|error| error.contains(&wanted)), "{name}: {error:?}");
        }
    }

    #[test]
    fn the_name_is_that_of_the_folder() {
        assert!(Name::of_folder("../robots/nao".as_ref()).is_ok_and(|name| name.0 == "nao"));
        assert!(Name::of_folder("..".as_ref()).is_err_and(|error| error.to_string().contains("my_robot")));
    }
}
