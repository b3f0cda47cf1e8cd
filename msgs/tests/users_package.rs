//! Builds the crate in `examples/users_package` with cargo like a user, in a separate folder.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// One test, since its parts share a folder: dependencies are built only once.
#[test]
fn a_crate_with_its_own_interfaces_builds_runs_and_gets_clear_errors() {
    let users = UsersCrate::new();

    let output = users.cargo("run");
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines[0], "my_msgs/msg/Leg 112 bytes");
    assert_eq!(lines[1], hash("my_msgs/msg/Leg"));
    assert_eq!(lines[2], "my_msgs/srv/Kick KickRequest { side: 0, strength: 1.0 }");
    assert_eq!(lines[3], "my_msgs/action/Walk WalkGoal { steps: 3 }");
    let all = "lab_msgs/msg/Foot my_msgs/msg/Gait my_msgs/msg/Leg my_msgs/srv/Kick my_msgs/action/Walk";
    assert_eq!(lines[4], all, "INTERFACES contains all of them, including those of lab_msgs");

    // A change is noticed, and an error in it is reported with its location only.
    let path = users.folder.join("my_msgs/msg/Gait.msg");
    let gait = fs::read_to_string(&path).unwrap();
    fs::write(&path, gait.replace("Leg[]", "Arm[]")).unwrap();
    assert_eq!(
        users.errors(),
        [
            "error: users_package@0.1.0: my_msgs/msg/Gait.msg:2:1: field `legs` of my_msgs/msg/Gait has the unknown type `my_msgs/msg/Arm`"
        ]
    );
    fs::write(&path, gait.replace("Leg[] ", "sensor_msgs/Imu[] ")).unwrap();
    assert_eq!(
        users.errors(),
        [
            "error: users_package@0.1.0: my_msgs/msg/Gait.msg:2:1: field `legs` of my_msgs/msg/Gait has the type sensor_msgs/msg/Imu: enable the feature `sensor_msgs` of downbeat-msgs in Cargo.toml"
        ]
    );
    fs::write(&path, &gait).unwrap();

    // So is a new file.
    fs::write(users.folder.join("my_msgs/srv/Walk.srv"), "float64 speed\n").unwrap();
    let errors = users.errors();
    assert!(errors[0].starts_with("error: users_package@0.1.0: my_msgs/srv/Walk.srv"), "{errors:?}");
}

/// A copy of the example.
struct UsersCrate {
    folder: PathBuf,
}

impl UsersCrate {
    fn new() -> Self {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let example = here.join("examples/users_package");
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("users_package");
        let _ = fs::remove_dir_all(folder.join("my_msgs")); // Left by an earlier run.
        copy(&example, &folder);
        let manifest = fs::read_to_string(example.join("Cargo.toml")).unwrap();
        let manifest = manifest
            .replace("\"../..\"", &format!("{here:?}"))
            .replace("\"../../generator\"", &format!("{:?}", here.join("generator")));
        fs::write(folder.join("Cargo.toml"), manifest).unwrap();
        // Uses crates that are already downloaded.
        fs::copy(here.join("../Cargo.lock"), folder.join("Cargo.lock")).unwrap();
        Self { folder }
    }

    fn cargo(&self, command: &str) -> Output {
        Command::new(env!("CARGO"))
            .args([command, "--offline", "--quiet", "--color=never"])
            .current_dir(&self.folder)
            .env("CARGO_TARGET_DIR", self.folder.join("target"))
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env_remove("AMENT_PREFIX_PATH")
            .env_remove("RUSTFLAGS")
            .output()
            .unwrap()
    }

    /// The errors of a failing build, except the last, which only says that there were errors.
    fn errors(&self) -> Vec<String> {
        let output = self.cargo("check");
        assert!(!output.status.success());
        let text = String::from_utf8(output.stderr).unwrap();
        let errors = text.lines().filter(|line| line.starts_with("error"));
        let mut errors: Vec<String> = errors.map(str::to_owned).collect();
        assert_eq!(errors.pop().as_deref(), Some("error: build script logged errors"), "{text}");
        errors
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let from = entry.unwrap().path();
        let to = to.join(from.file_name().unwrap());
        if from.is_dir() {
            if from.file_name().unwrap() != "target" {
                copy(&from, &to);
            }
        } else {
            fs::copy(from, to).unwrap();
        }
    }
}

/// The hash computed from the definitions alone.
fn hash(name: &str) -> String {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut catalog = downbeat_msgs_definitions::Catalog::new();
    catalog.add_packages(&here.join("interfaces")).unwrap();
    catalog.add_package(&here.join("examples/users_package/my_msgs")).unwrap();
    catalog.add_package(&here.join("examples/users_package/lab/lab_msgs")).unwrap();
    catalog.type_hash(&name.parse().unwrap()).unwrap()
}
