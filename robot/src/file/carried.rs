//! Robots that the program carries, by their names in place of paths.

use std::borrow::Cow;
use std::path::Path;

use downbeat_files::nearest;
use downbeat_files::toml::Error;
use downbeat_robots::robots;

use super::RobotFileError;

/// The path of a robot file that a user names: a path, or where no such file exists the name of a carried
/// robot, whose files are then written into the cache.
pub(super) fn located(path: &Path) -> Result<Cow<'_, Path>, RobotFileError> {
    let Some(name) = path.to_str().filter(|name| is_name(name)).filter(|_| !path.is_file()) else {
        return Ok(path.into());
    };
    let error = match downbeat_robots::unpack(name) {
        Ok(path) => return Ok(path.into()),
        Err(error) => error,
    };
    let remedy = match error {
        downbeat_robots::Error::Unknown(_) => match nearest(name, robots().map(|robot| robot.name)) {
            Some(nearest) => format!("; did you mean \"{nearest}\"?"),
            None => "; `downbeat robots list` names those that are".to_owned(),
        },
        _ => format!("; `downbeat robots copy {name} FOLDER` writes them where you like"),
    };
    if path.exists() {
        return Ok(path.into()); // a folder, which the reader reports
    }
    let reason = format!("there is no such file, and {error}{remedy}");
    Err(Error::Unreadable { what: "the robot file", path: path.to_owned(), reason }.into())
}

/// True for a text that may be the name of a carried robot, and is no path to a robot file: those end in
/// `.toml`.
fn is_name(text: &str) -> bool {
    text.split('/').all(|part| {
        !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    })
}
