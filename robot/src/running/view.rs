//! The servers for viewers of a running robot.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_bags::Recording;
use downbeat_bridge::expose::Exposure;
use downbeat_executor::{SettingValue, TopicInfo};
use downbeat_msgs::qos::{Durability, History};
use downbeat_view::{
    Access, CoreLink, ModuleProfile, PageOptions, Panel, PanelScript, Token, ViewError, ViewOptions,
    ViewServer, ViewTime,
};
use parking_lot::Mutex;

use super::page_host::{ModuleFiles, PageHost};
use super::recording::Recordable;
use super::{NodeLog, StartError};
use crate::recorder::RecorderError;
use crate::{ClockChoice, Direction, ModuleEntry, Robot, RobotFile, ViewAccess};

/// What shows a running robot to viewers: what its robot file asks for, and a page that is opened later.
pub(crate) struct RobotView {
    link: CoreLink,
    /// Without doors.
    options: ViewOptions,
    page: PageOptions,
    host: Arc<PageHost>,
    server: Option<ViewServer>,
    later: Mutex<Option<ViewServer>>,
}

impl RobotView {
    /// Starts the servers that the robot file asks for.
    pub(super) fn start(
        robot: &mut Robot,
        is_simulated: bool,
        log: Option<&NodeLog>,
        recording: Option<&Recording>,
    ) -> Result<Self, StartError> {
        let options = options(robot, is_simulated)?;
        let recordable = Recordable::of(robot, is_simulated, None).map_err(|error| error.to_string());
        let tail = log.map(|log| log.tail.clone());
        let latencies = robot.latencies.clone();
        let files = files(&robot.file);
        let host = PageHost::new(robot.core.handle(), recordable, tail, latencies, recording, files);
        let host = Arc::new(host);
        let page = page(&robot.file, Arc::clone(&host));
        let link = CoreLink::of(&mut robot.core, &robot.file.catalog.interfaces)?;
        let mut view = Self { link, options, page, host, server: None, later: Mutex::default() };
        let asked = &robot.file.view;
        if asked.foxglove.is_some() || asked.page.is_some() {
            let page = asked.page.map(|port| PageOptions { port, ..view.page.clone() });
            let options = ViewOptions { foxglove: asked.foxglove, page, ..view.options.clone() };
            let server = ViewServer::start(&mut robot.core, &robot.file.catalog.interfaces, options)?;
            // Without the token: the log is published.
            if let Some(address) = server.foxglove_address() {
                tracing::info!("viewers connect to ws://{address}/");
            }
            if let Some(address) = server.page_address() {
                tracing::info!("the page is http://{address}/");
            }
            view.server = Some(server);
        }
        Ok(view)
    }

    pub(super) fn server(&self) -> Option<&ViewServer> {
        self.server.as_ref()
    }

    /// Opens the page if it is not open, and returns its URL.
    pub(crate) fn open_page(&self) -> Result<String, ViewError> {
        if let Some(url) = self.server.as_ref().and_then(ViewServer::page_url) {
            return Ok(url);
        }
        let mut later = self.later.lock();
        if later.is_none() {
            let options = ViewOptions { page: Some(self.page.clone()), ..self.options.clone() };
            *later = Some(ViewServer::start_from(self.link.clone(), options)?);
        }
        Ok(later.as_ref().and_then(ViewServer::page_url).unwrap_or_default())
    }

    /// Takes in topics that modules bring while the robot runs: for recordings that the page begins.
    pub(super) fn extend_recordings(
        &self,
        topics: &[TopicInfo],
        exposed: &[Exposure],
    ) -> Result<(), RecorderError> {
        self.host.extend(topics, exposed)
    }

    /// Finishes the recording that the page began.
    pub(super) fn finish_recording(&self) {
        self.host.finish();
    }

    /// Ends the servers.
    pub(super) fn close(&self) {
        drop(self.later.lock().take());
    }
}

/// Messages of a latched topic that are kept.
const MOST_LATCHED: usize = 100;

/// What viewers see, without a door through which they come.
fn options(robot: &Robot, is_simulated: bool) -> Result<ViewOptions, StartError> {
    let file = &robot.file;
    let entry = file.view.clone();
    let mut options = ViewOptions::new(&file.name)?;
    (options.address, options.foxglove) = (entry.address, None);
    options.access = match (entry.access, entry.token) {
        (ViewAccess::Token, Some(token)) => Access::Token(Token::new(&token)?),
        (ViewAccess::Token, None) => options.access,
        (ViewAccess::ReadOnly, _) => Access::ReadOnly,
        (ViewAccess::Open, _) => Access::Open,
    };
    if let Some(patterns) = entry.topics {
        options.topics = Arc::new(move |topic| patterns.iter().any(|pattern| pattern.matches(topic)));
    }
    options.packages = entry.packages;
    options.packages.extend(description_folders(file).map(|folder| (file.name.clone(), folder)));
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
    if is_simulated || file.expose.features.clock == ClockChoice::Follow {
        options.time = ViewTime::Core;
    }
    Ok(options)
}

fn page(file: &RobotFile, host: Arc<PageHost>) -> PageOptions {
    let profile = |module: &ModuleEntry| {
        let source = module.kind.source_files(&module.source).into_iter().next();
        let profile = ModuleProfile {
            kind: module.kind.name().to_owned(),
            source,
            description: Some(module.kind.about().to_owned()),
        };
        (module.name.clone(), profile)
    };
    PageOptions {
        hosts: file.view.hosts.clone(),
        modules: file.modules.iter().map(profile).collect(),
        panels: file.modules.iter().filter_map(panel).collect(),
        host: Some(host),
        ..PageOptions::default()
    }
}

/// The files that settings of modules name.
fn files(file: &RobotFile) -> ModuleFiles {
    let of_module = |module: &ModuleEntry| {
        let named = module.kind.files().iter().filter_map(|setting| {
            let SettingValue::Text(path) = &module.settings.get(setting)?.value else { return None };
            (!path.is_empty()).then(|| ((module.name.clone(), setting.clone()), PathBuf::from(path)))
        });
        named.collect::<Vec<_>>()
    };
    file.modules.iter().flat_map(of_module).collect()
}

/// The panel that a module brings: that of its kind, or one beside its file.
fn panel(module: &ModuleEntry) -> Option<Panel> {
    let (title, script, topics) = if let Some(panel) = module.kind.panel() {
        let options = module.options();
        let renamed = |topic: &&str| {
            let topic = match topic.strip_prefix("~/") {
                Some(own) => format!("{}/{own}", module.name),
                None => (*topic).to_owned(),
            };
            options.resolved(&topic)
        };
        let title = match options.namespace.as_str() {
            "" => panel.title.to_owned(),
            namespace => format!("{} {namespace}", panel.title),
        };
        (title, PanelScript::Text(panel.script.into()), panel.topics.iter().map(renamed).collect())
    } else {
        let source = module.kind.source_files(&module.source).into_iter().next()?;
        let script = source.with_extension("panel.js");
        script.is_file().then(|| (module.name.clone(), PanelScript::File(script), Vec::new()))?
    };
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let name = module.name.chars().map(|c| if is_plain(c) { c } else { '-' }).collect();
    Some(Panel { name, title, module: module.name.clone(), script, topics })
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
