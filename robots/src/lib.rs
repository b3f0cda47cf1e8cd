//! The robots of this folder, carried inside the program: `downbeat run darwin_op` needs no file.
//!
//! [`robots`] lists them, [`files_of`] finds what belongs to one, [`copy`] gives a user files of her own, and
//! [`unpack`] writes all of them into the cache, from where the program reads them.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// A file of this folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct File {
    /// The path within the folder, such as `servos/op3.toml`.
    pub path: &'static str,
    /// The content.
    pub text: &'static str,
}

/// A robot file, or the file of a match.
#[derive(Clone, Debug)]
pub struct Robot {
    /// What commands call it: the path without `.toml`, such as `darwin_op` or `football/player`.
    pub name: &'static str,
    /// What it is, in the words of its file.
    pub about: String,
    /// The command of the program that takes it: `run` or `match`.
    pub command: &'static str,
}

macro_rules! files {
    ($($path:literal)*) => {
        &[$(File { path: $path, text: include_str!(concat!("../", $path)) }),*]
    };
}

/// Everything that is carried.
pub const FILES: &[File] = files! {
    "ball_chaser.scxml" "ball_chaser.toml" "darwin_op.toml" "darwin_op.urdf" "darwin_op.xml" "darwin_op_physics.toml"
    "darwin_op_serial.toml" "darwin_op_walks.toml" "empty_goal.toml" "five_against_five.toml" "football/player.scxml" "football/player.toml"
    "football/seeing_player.toml" "football/shooter.scxml" "football/shooter.toml" "match.toml" "op3.toml" "op3.urdf"
    "op3_humanoid.toml" "op3_motions.toml" "op3_walks.toml" "px4_emulated.toml" "px4_offboard.toml" "seeing_match.toml" "seeing_teams.toml" "sensors.toml"
    "servos/op3.toml" "servos/so101.toml" "so101.toml" "so101_teleop.toml" "worlds/field.toml"
};

/// Why the files of a robot could not be written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No robot has this name.
    #[error("no robot \"{0}\" is carried")]
    Unknown(String),
    /// The environment names no folder for caches.
    #[error("neither XDG_CACHE_HOME nor HOME names a folder in which the files of carried robots can be")]
    NoCache,
    /// A file exists and would be replaced.
    #[error("{} exists already", .0.display())]
    Exists(PathBuf),
    /// A file cannot be written.
    #[error("cannot write {}: {error}", path.display())]
    Unwritable {
        /// The file, or its folder.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
}

/// The robots, in the order of their names.
pub fn robots() -> impl Iterator<Item = Robot> {
    FILES.iter().filter_map(|file| {
        let name = file.path.strip_suffix(".toml")?;
        let has = |line: &str| file.text.lines().any(|other| other.trim_end() == line);
        let command = if has("kind = \"football_match\"") { "match" } else { "run" };
        has("[robot]").then(|| Robot { name, about: about(file.text), command })
    })
}

/// The first paragraph of the comment at the start of a file.
fn about(text: &str) -> String {
    let comment = text.lines().map_while(|line| line.strip_prefix("# "));
    comment.map(str::trim).collect::<Vec<_>>().join(" ")
}

/// The file of a robot.
#[must_use]
pub fn find(name: &str) -> Option<&'static File> {
    let robot = robots().find(|robot| robot.name == name)?;
    FILES.iter().find(|file| file.path.strip_suffix(".toml") == Some(robot.name))
}

/// The file of a robot and all those that it names, directly or through others, in the order of their paths.
///
/// # Errors
/// If there is no such robot.
pub fn files_of(name: &str) -> Result<BTreeSet<&'static File>, Error> {
    let mut found = BTreeSet::new();
    let mut waiting = vec![find(name).ok_or_else(|| Error::Unknown(name.to_owned()))?];
    while let Some(file) = waiting.pop() {
        if found.insert(file) {
            waiting.extend(FILES.iter().filter(|other| names(file, other)));
        }
    }
    Ok(found)
}

/// The kinds of modules of a robot, in its file and those that it names.
///
/// # Errors
/// If there is no such robot.
pub fn kinds_of(name: &str) -> Result<BTreeSet<&'static str>, Error> {
    let files = files_of(name)?;
    let robots = files.iter().filter(|file| file.path.ends_with(".toml"));
    // Other tables, such as that of the launcher, have kinds too.
    let modules =
        robots.flat_map(|file| file.text.split("\n[").filter(|table| table.starts_with("[module]]")));
    let quoted = |line: &'static str| line.strip_prefix("kind = \"")?.split('"').next();
    Ok(modules.flat_map(|table| table.lines().filter_map(quoted)).collect())
}

/// True if a setting of the file is the path to the other one.
fn names(file: &File, other: &File) -> bool {
    if !file.path.ends_with(".toml") {
        return false;
    }
    let up = file.path.matches('/').count();
    let folder = file.path.rsplit_once('/').map_or("", |(folder, _)| folder);
    let relative = match other.path.strip_prefix(folder).and_then(|path| path.strip_prefix('/')) {
        Some(beside) if !folder.is_empty() => beside.to_owned(),
        _ => format!("{}{}", "../".repeat(up), other.path),
    };
    let without_comments = file.text.lines().filter(|line| !line.trim_start().starts_with('#'));
    let quoted = format!("\"{relative}\"");
    without_comments.into_iter().any(|line| line.contains(&quoted))
}

/// Writes the files of a robot into a folder, which is made if there is none, and returns their paths.
/// Existing files are only replaced if `replaces` is true.
///
/// # Errors
/// If there is no such robot, a file exists already, or one cannot be written.
pub fn copy(name: &str, folder: &Path, replaces: bool) -> Result<Vec<PathBuf>, Error> {
    let files = files_of(name)?;
    let existing = files.iter().map(|file| folder.join(file.path)).find(|path| path.exists());
    if let Some(path) = existing.filter(|_| !replaces) {
        return Err(Error::Exists(path));
    }
    files.into_iter().map(|file| write(folder, file)).collect()
}

/// Returns the path of a robot's file in the cache of the user, where it stands with all other carried files;
/// missing and changed ones are written.
///
/// # Errors
/// If there is no such robot, the environment names no cache, or a file cannot be written.
pub fn unpack(name: &str) -> Result<PathBuf, Error> {
    let file = find(name).ok_or_else(|| Error::Unknown(name.to_owned()))?;
    let folder = cache(|name| std::env::var_os(name)).ok_or(Error::NoCache)?.join(folder_name());
    unpack_into(&folder)?;
    Ok(folder.join(file.path))
}

fn unpack_into(folder: &Path) -> Result<(), Error> {
    for file in FILES {
        // Compared: an edited file in the cache is not the robot of that name.
        if fs::read(folder.join(file.path)).is_ok_and(|content| content == file.text.as_bytes()) {
            continue;
        }
        write(folder, file)?;
    }
    Ok(())
}

/// The folder for caches, by the XDG base directory specification.
fn cache(variable: impl Fn(&str) -> Option<std::ffi::OsString>) -> Option<PathBuf> {
    let absolute = |name| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
    absolute("XDG_CACHE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".cache"))).or_else(|| {
        // Windows
        absolute("LOCALAPPDATA")
    })
}

/// Another folder for other content, so that two versions do not replace each other's files.
fn folder_name() -> PathBuf {
    let mut hasher = DefaultHasher::new();
    FILES.hash(&mut hasher);
    Path::new("downbeat/robots").join(format!("{}-{:016x}", env!("CARGO_PKG_VERSION"), hasher.finish()))
}

/// Writes a file under another name and renames it, so that another program never reads half of it.
fn write(folder: &Path, file: &File) -> Result<PathBuf, Error> {
    let path = folder.join(file.path);
    let parent = path.parent().unwrap_or(folder);
    let written = fs::create_dir_all(parent).and_then(|()| {
        #[cfg_attr(not(unix), expect(unused_mut, reason = "files have no mode"))]
        let mut builder = tempfile::Builder::new();
        // As other new files, which the user's mask restricts.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut new = builder.tempfile_in(parent)?;
        new.write_all(file.text.as_bytes())?;
        new.persist(&path).map_err(|error| error.error)?;
        Ok(())
    });
    written.map_err(|error| Error::Unwritable { path: path.clone(), error })?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn paths(name: &str) -> Vec<&str> {
        files_of(name).unwrap().iter().map(|file| file.path).collect()
    }

    #[test]
    fn every_file_of_the_folder_is_carried() {
        fn walk(folder: &Path, found: &mut Vec<PathBuf>) {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { walk(&path, found) } else { found.push(path) }
            }
        }
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = Vec::new();
        walk(root, &mut found);
        let is_of_a_robot = |path: &&Path| {
            !path.starts_with("src") && ![Path::new("Cargo.toml"), Path::new("LICENSE")].contains(path)
        };
        let found = found.iter().map(|path| path.strip_prefix(root).unwrap()).filter(is_of_a_robot);
        let found: BTreeSet<&Path> = found.collect();
        assert_eq!(found, FILES.iter().map(|file| Path::new(file.path)).collect());
    }

    #[test]
    fn robots_and_matches_are_listed_and_their_parts_are_not() {
        let listed: Vec<(&str, &str)> = robots().map(|robot| (robot.name, robot.command)).collect();
        assert!(listed.contains(&("darwin_op", "run")), "{listed:?}");
        assert!(listed.contains(&("match", "match")), "{listed:?}");
        assert!(
            !listed.iter().any(|(name, _)| name.contains("motions") || name.contains("humanoid")),
            "{listed:?}"
        );
        assert!(robots().all(|robot| robot.about.ends_with('.')), "each begins with what it is");
    }

    #[test]
    fn what_a_robot_names_belongs_to_it() {
        assert_eq!(paths("so101"), ["servos/so101.toml", "so101.toml"]);
        assert_eq!(
            paths("op3_walks"),
            [
                "op3.urdf",
                "op3_humanoid.toml",
                "op3_motions.toml",
                "op3_walks.toml",
                "servos/op3.toml",
                "worlds/field.toml"
            ]
        );
        assert_eq!(
            paths("seeing_match"),
            ["darwin_op.urdf", "football/player.scxml", "football/seeing_player.toml", "seeing_match.toml"]
        );
        assert!(matches!(files_of("op3_motions"), Err(Error::Unknown(_))), "no robot");
    }

    #[test]
    fn the_kinds_of_a_robot_are_those_of_all_its_files() {
        let kinds = kinds_of("match").unwrap();
        assert!(kinds.contains("football_match") && kinds.contains("walk_to"), "{kinds:?}");
        assert!(!kinds.contains("pool"), "a launcher: {kinds:?}");
        assert!(!kinds_of("darwin_op").unwrap().contains("football_match"));
    }

    #[test]
    fn a_copy_replaces_nothing_unless_it_is_told_to() {
        let folder = tempfile::tempdir().unwrap();
        let copied = copy("so101", folder.path(), false).unwrap();
        assert_eq!(copied.len(), 2);
        let file = folder.path().join("so101.toml");
        fs::write(&file, "mine").unwrap();
        let error = copy("so101", folder.path(), false).unwrap_err();
        assert!(error.to_string().ends_with("servos/so101.toml exists already"), "{error}");
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
        copy("so101", folder.path(), true).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), find("so101").unwrap().text);
    }

    #[test]
    fn an_edited_file_in_the_cache_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        unpack_into(folder.path()).unwrap();
        let file = folder.path().join("darwin_op.toml");
        fs::write(&file, "[robot]\nname = \"other\"\n").unwrap();
        unpack_into(folder.path()).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), find("darwin_op").unwrap().text);
    }

    #[test]
    fn the_cache_is_where_the_environment_says() {
        let of = |variables: &'static [(&'static str, &'static str)]| {
            cache(|name| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| value.into()))
        };
        assert_eq!(of(&[("XDG_CACHE_HOME", "/c"), ("HOME", "/home/a")]), Some("/c".into()));
        assert_eq!(of(&[("XDG_CACHE_HOME", ""), ("HOME", "/home/a")]), Some("/home/a/.cache".into()));
        assert_eq!(of(&[]), None);
    }
}
