//! The server for viewers of a running robot.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_executor::SettingValue;
use downbeat_msgs::qos::{Durability, History};
use downbeat_view::{Access, Token, ViewOptions, ViewServer, ViewTime};

use super::StartError;
use crate::robot::{ClockChoice, Direction, Robot, RobotFile, ViewAccess, ViewEntry};

/// Starts the server if the robot file has one.
pub(super) fn start(robot: &mut Robot, is_simulated: bool) -> Result<Option<ViewServer>, StartError> {
    let Some(entry) = robot.file.view.clone() else { return Ok(None) };
    let mut options = options(&robot.file, entry)?;
    for exposure in robot.exposed()?.topics {
        if exposure.message_type.is_raw() {
            options.raw.push((exposure.topic.clone(), exposure.message_type));
        }
        let profile = exposure.qos.profile().filter(|qos| qos.durability == Durability::TransientLocal);
        if let Some(profile) = profile.filter(|_| exposure.direction == Direction::Out) {
            let depth = match profile.history {
                History::KeepLast(depth) => usize::try_from(depth).unwrap_or(1),
                History::KeepAll => MOST_LATCHED,
            };
            options.latched.push((exposure.topic, depth.clamp(1, MOST_LATCHED)));
        }
    }
    if is_simulated || robot.file.expose.features.clock == ClockChoice::Follow {
        options.time = ViewTime::Core;
    }
    let server = ViewServer::start(&mut robot.core, &robot.file.catalog.interfaces, options)?;
    // Without the token: the log is published.
    tracing::info!("viewers connect to ws://{}/", server.address());
    Ok(Some(server))
}

/// Messages of a latched topic that are kept.
const MOST_LATCHED: usize = 100;

fn options(file: &RobotFile, entry: ViewEntry) -> Result<ViewOptions, StartError> {
    let ViewEntry { address, port, topics, access, token, packages } = entry;
    let mut options = ViewOptions::new(&file.name)?;
    (options.address, options.port) = (address, port);
    options.access = match (access, token) {
        (ViewAccess::Token, Some(token)) => Access::Token(Token::new(&token)?),
        (ViewAccess::Token, None) => options.access,
        (ViewAccess::ReadOnly, _) => Access::ReadOnly,
        (ViewAccess::Open, _) => Access::Open,
    };
    if let Some(patterns) = topics {
        options.topics = Arc::new(move |topic| patterns.iter().any(|pattern| pattern.matches(topic)));
    }
    options.packages = packages;
    options.packages.extend(description_folders(file).map(|folder| (file.name.clone(), folder)));
    Ok(options)
}

/// The folders of the robot's URDF files, which viewers reach as the package of the robot's name.
fn description_folders(file: &RobotFile) -> impl Iterator<Item = PathBuf> {
    let texts =
        file.modules.iter().filter_map(|module| match &module.settings.get("robot_description")?.value {
            SettingValue::Text(text) => Some(Path::new(text)),
            _ => None,
        });
    let files = texts.filter(|path| path.extension().is_some_and(|extension| extension == "urdf"));
    let folders = files.filter_map(|path| path.parent());
    // A file in the working directory has an empty folder.
    folders.map(|folder| Path::new(".").join(folder))
}
