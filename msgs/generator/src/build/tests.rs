#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::environment::Environment;
use super::{Build, BuildError};

/// A folder with `carried/std_msgs`, `carried/nav_msgs` (not enabled) and `ament/share/lab_msgs`; tests add
/// files.
struct Space {
    folder: TempDir,
    environment: Environment,
}

impl Space {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let environment = Environment {
            out: folder.path().into(),
            carried: folder.path().join("carried"),
            enabled: ["std_msgs".to_owned()].into(),
            ament_prefixes: vec![folder.path().join("empty"), folder.path().join("ament")],
        };
        let space = Self { folder, environment };
        space.write("carried/std_msgs/msg/Header.msg", "string frame_id\n");
        space.write("carried/nav_msgs/msg/Path.msg", "std_msgs/Header header\n");
        space.write("ament/share/lab_msgs/msg/Leg.msg", "std_msgs/Header header\nFoot foot\n");
        space.write("ament/share/lab_msgs/msg/Foot.msg", "float32 force # [N]\n");
        space
    }

    fn write(&self, path: &str, text: &str) {
        let path = self.path(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    /// Returns the generated source and the paths that cargo watches, relative to the space's folder.
    fn build(&self, build: &Build) -> Result<(String, Vec<String>), BuildError> {
        let mut watched = Vec::new();
        let source = build.source(&self.environment, &mut |line| watched.push(self.short(&line)))?;
        Ok((source, watched))
    }

    fn error(&self, build: &Build) -> String {
        self.short(&self.build(build).unwrap_err().to_string())
    }

    fn short(&self, text: &str) -> String {
        text.replace(&format!("{}/", self.folder.path().display()), "")
    }
}

#[test]
fn built_in_packages_are_referred_to_and_installed_ones_are_generated() {
    let space = Space::new();
    space.write("my_msgs/msg/Robot.msg", "std_msgs/Header header\nlab_msgs/Leg[2] legs\n");
    let (source, watched) = space.build(&Build::new().package(space.path("my_msgs"))).unwrap();
    assert!(source.contains("pub header: ::downbeat_msgs::std_msgs::msg::Header,"), "{source}");
    assert!(source.contains("pub legs: [super::super::lab_msgs::msg::Leg; 2],"), "{source}");
    assert!(source.contains("pub mod lab_msgs {") && source.contains("/// \\[N\\]"), "{source}");
    assert!(!source.contains("pub mod std_msgs {"), "{source}");
    assert!(
        source.contains("<self::my_msgs::msg::Robot as ::downbeat_msgs::Message>::INTERFACES"),
        "{source}"
    );
    assert!(
        source.contains("<self::lab_msgs::msg::Leg as ::downbeat_msgs::Message>::INTERFACES"),
        "{source}"
    );
    assert!(!source.contains("std_msgs::msg::Header as"), "built-in types are already registered: {source}");
    assert_eq!(
        watched,
        [
            "rerun-if-env-changed=AMENT_PREFIX_PATH",
            "rerun-if-changed=my_msgs",
            "rerun-if-changed=ament/share/lab_msgs"
        ]
    );
}

#[test]
fn the_package_of_a_crate_that_is_one_is_watched_without_the_rest_of_it() {
    let space = Space::new();
    space.write("my_msgs/msg/A.msg", "int8 a\n");
    space.write("my_msgs/Cargo.toml", "");
    let (_, watched) = space.build(&Build::new().package(space.path("my_msgs"))).unwrap();
    assert_eq!(watched[1..], ["rerun-if-changed=my_msgs/msg"]);
}

#[test]
fn every_package_below_a_folder_is_taken_and_other_folders_are_not() {
    let space = Space::new();
    space.write("vendor/a_msgs/msg/A.msg", "b_msgs/B b\n");
    space.write("vendor/b_msgs/msg/B.msg", "int8 b\n");
    space.write("vendor/docs/README.md", "");
    let (source, _) = space.build(&Build::new().packages(space.path("vendor"))).unwrap();
    assert_eq!(source.matches("pub mod a_msgs").count() + source.matches("pub mod b_msgs").count(), 2);
    assert!(source.contains("pub b: super::super::b_msgs::msg::B,"), "{source}");
}

#[test]
fn installed_packages_are_found_by_name() {
    let space = Space::new();
    let (source, _) = space.build(&Build::new().installed("lab_msgs").runtime("crate::msgs")).unwrap();
    assert!(source.contains("pub header: crate::msgs::std_msgs::msg::Header,"), "{source}");
    assert_eq!(
        space
            .error(&Build::new().installed("no_msgs"))
            .replace(&space.folder.path().display().to_string(), ""),
        "no package `no_msgs` with interfaces is installed: searched `share` below empty, ament; source the setup file of \
         the workspace that has it, or, if colcon builds that package and this one, name it in a <depend> of package.xml"
    );
}

#[test]
fn errors_say_where_and_what_to_do() {
    let space = Space::new();
    let my_msgs = Build::new().package(space.path("my_msgs"));
    assert_eq!(
        space.error(&my_msgs),
        "my_msgs: there is no interface here: the folder of a package holds `msg/*.msg`, `srv/*.srv` or \
         `action/*.action`"
            .replace("my_msgs", &space.short(&space.path("my_msgs").display().to_string()))
    );
    for (text, error) in [
        ("int8 a\nint7 b\n", "my_msgs/msg/A.msg:2:1: `int7` is neither a primitive type"),
        (
            "int8 a\n nav_msgs/Path path\n",
            "my_msgs/msg/A.msg:2:2: field `path` of my_msgs/msg/A has the type nav_msgs/msg/Path: enable the feature \
             `nav_msgs` of downbeat-msgs in Cargo.toml",
        ),
        (
            "no_msgs/No no\n",
            "my_msgs/msg/A.msg:1:1: field `no` of my_msgs/msg/A has the unknown type `no_msgs/msg/No`: no interface of \
             the package no_msgs is known",
        ),
        (
            "std_msgs/Heeder header\n",
            "my_msgs/msg/A.msg:1:1: field `header` of my_msgs/msg/A has the unknown type",
        ),
    ] {
        space.write("my_msgs/msg/A.msg", text);
        let found = space.error(&my_msgs);
        assert!(found.starts_with(error), "{found}");
    }
}

#[test]
fn two_types_with_one_rust_name_are_refused() {
    let space = Space::new();
    space.write("carried/service_msgs/msg/ServiceEventInfo.msg", "");
    space.write("carried/builtin_interfaces/msg/Time.msg", "");
    space.write("my_msgs/srv/Kick.srv", "---\n");
    space.write("my_msgs/srv/KickRequest.srv", "---\n");
    let mut build = space.environment.clone();
    build.enabled.insert("service_msgs".into());
    let space = Space { environment: build, ..space };
    assert_eq!(
        space.error(&Build::new().package(space.path("my_msgs"))),
        "my_msgs/srv/KickRequest and my_msgs/srv/Kick_Request would have the same name in Rust, where underscores are \
         left out: rename one of them"
    );
}

#[test]
fn a_built_in_package_is_refused() {
    let space = Space::new();
    space.write("mine/std_msgs/msg/Header.msg", "int8 seq\n");
    let error = space.error(&Build::new().package(space.path("mine/std_msgs")));
    assert!(error.starts_with("mine/std_msgs: downbeat-msgs is built with a package `std_msgs`"), "{error}");
}

#[test]
fn another_version_of_a_built_in_package_is_generated_on_request() {
    let space = Space::new();
    space.write("other/std_msgs/msg/Header.msg", "string frame_id\nuint32 seq\n");
    space.write("other/std_msgs/msg/Stamped.msg", "Header header\n");
    let (source, watched) = space.build(&Build::new().other_version(space.path("other/std_msgs"))).unwrap();
    assert!(source.contains("pub seq: u32") && source.contains("pub header: Header"), "{source}");
    assert!(watched.contains(&"rerun-if-changed=other/std_msgs".to_owned()), "{watched:?}");
}

#[test]
fn errors_returned_by_main_print_their_message() {
    let error = BuildError::NoInterfaces { folder: Path::new("a").into() };
    assert_eq!(format!("{error:?}"), error.to_string());
}
