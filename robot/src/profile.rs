//! What a kind of module is, for people and for editors: settings and ports, as a module of it declares them.

use std::collections::BTreeMap;

use downbeat_executor::{
    Core, GraphEdge, ModuleOptions, SettingInfo, SettingValue, SetupError, Synchrony, TopicInfo,
};
use serde::Serialize;
use serde_json::Value;

use super::actions::SEND_GOAL;
use super::{Catalog, Kind, ModuleSource};

/// The version of the JSON that [`KindProfile`] is written as. It grows when a reader of the version before
/// would misread it; new keys alone do not change it.
pub const PROFILE_SCHEMA: u32 = 1;

/// A kind of module as it describes itself.
///
/// ```
/// use downbeat_robot::{Catalog, ModuleSource};
///
/// let catalog = Catalog::built_in();
/// let mux = catalog.profile("joint_command_mux", &Default::default(), &ModuleSource::default()).unwrap();
/// assert!(mux.ports.iter().any(|port| port.name == "joint_goals"));
/// let settings = [("sources".to_owned(), vec!["walk".to_owned()].into())].into();
/// let mux = catalog.profile("joint_command_mux", &settings, &ModuleSource::default()).unwrap();
/// assert!(mux.ports.iter().any(|port| port.name == "walk"), "ports that depend on settings");
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KindProfile {
    /// The name in robot files.
    pub kind: String,
    /// What it is for, in one line.
    pub about: String,
    /// True if its data does not come from real hardware.
    pub is_emulated: bool,
    /// True if it drives a device.
    pub uses_device: bool,
    /// How its modules run by default.
    pub runs: Runs,
    /// The periods of its timers, in seconds.
    pub periods_s: Vec<f64>,
    /// The keys of `[[module]]` that only this kind has.
    pub keys: Vec<KeyProfile>,
    /// The settings, in the order of their declaration.
    pub settings: Vec<SettingProfile>,
    /// The topics, services and actions, under the names that the module has for them.
    pub ports: Vec<PortProfile>,
    /// The panel that it brings to the page of a robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub panel: Option<PanelProfile>,
    /// Why its ports are not known: what a module of it needs and was not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needs: Option<String>,
}

/// A panel of the page that shows a module.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PanelProfile {
    /// Its title.
    pub title: String,
    /// The topics that it shows, as the module names them.
    pub topics: Vec<String>,
}

/// How a module runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Runs {
    /// In the cycles in which it has work.
    WhenDue,
    /// In every cycle.
    EveryCycle,
    /// On its own thread.
    Detached,
}

/// A key of `[[module]]` that only one kind has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyProfile {
    /// The key.
    pub name: &'static str,
    /// True if a robot file must have it.
    pub is_required: bool,
}

/// A setting of a kind.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SettingProfile {
    /// The name.
    pub name: String,
    /// What it is for, with its unit.
    pub description: String,
    /// `bool`, `integer`, `double`, `text`, or a list of one of them (`bools`, `bytes`, `integers`,
    /// `doubles`, `texts`).
    #[serde(rename = "type")]
    pub value_type: &'static str,
    /// The value unless a robot file gives another; `None` if the setting exists only with settings that were
    /// given.
    pub default: Option<Value>,
    /// The numbers that are allowed, from and to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// The texts that are allowed; all if it is empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<String>,
    /// True if it does not change after the start.
    pub is_read_only: bool,
    /// True if it names a file, relative to the robot file.
    pub is_file: bool,
    /// True if a module without it is refused.
    pub is_required: bool,
}

/// A topic, service or action of a kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PortProfile {
    /// The name that the module has for it; `remap` puts another in its place.
    pub name: String,
    /// What it is.
    #[serde(rename = "is")]
    pub what: PortKind,
    /// What the module does with it.
    #[serde(rename = "does")]
    pub role: PortRole,
    /// The type of ROS 2, or the Rust path of a type that is not registered.
    #[serde(rename = "type")]
    pub type_name: String,
}

/// What a port is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PortKind {
    /// Messages.
    Topic,
    /// Requests and responses.
    Service,
    /// Goals with feedback and results.
    Action,
}

/// What a module does with a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PortRole {
    /// Sends messages.
    Publishes,
    /// Receives messages.
    Subscribes,
    /// Answers requests, or executes goals.
    Serves,
    /// Sends requests, or goals.
    Calls,
}

impl Catalog {
    /// Describes a kind with the settings and source of one module: it is added to a core that never runs,
    /// under the name in `source`, or that of the kind. `None` if there is no such kind.
    #[must_use]
    pub fn profile(
        &self,
        kind: &str,
        settings: &BTreeMap<String, SettingValue>,
        source: &ModuleSource,
    ) -> Option<KindProfile> {
        let kind = self.kind(kind)?;
        let plain = Draft::with_required(self, kind, &BTreeMap::new(), source);
        if settings.is_empty() {
            return Some(plain.profile(kind, &plain, settings));
        }
        Some(Draft::with_required(self, kind, settings, source).profile(kind, &plain, settings))
    }
}

/// How often a kind may ask for one more setting.
const MOST_REQUIRED: usize = 16;

/// A value that a module may accept in place of a setting that it requires.
fn placeholder(setting: &SettingInfo) -> SettingValue {
    let text = setting.name.clone();
    match &setting.value {
        SettingValue::Bool(_) => true.into(),
        SettingValue::Integer(_) => 1.into(),
        SettingValue::Double(_) => 1.0.into(),
        SettingValue::Text(_) => text.into(),
        SettingValue::Bools(_) => vec![true].into(),
        SettingValue::Bytes(_) => SettingValue::Bytes(vec![1]),
        SettingValue::Integers(_) => vec![1_i64].into(),
        SettingValue::Doubles(_) => vec![1.0].into(),
        SettingValue::Texts(_) => vec![text].into(),
    }
}

/// What a module of a kind declares in a core of its own.
struct Draft {
    settings: Vec<SettingInfo>,
    ports: Vec<PortProfile>,
    periods_s: Vec<f64>,
    problem: Option<SetupError>,
    /// The settings without which the module is refused, in the order in which it asks for them.
    required: Vec<String>,
}

impl Draft {
    fn of(
        catalog: &Catalog,
        kind: &Kind,
        settings: &BTreeMap<String, SettingValue>,
        source: &ModuleSource,
    ) -> Self {
        // Names of ports may begin with that of the module.
        let name = if source.module.is_empty() { kind.name() } else { &*source.module };
        let mut core = catalog.engage(Core::new());
        let options = ModuleOptions { settings: settings.clone().into_iter().collect(), ..kind.options() };
        let problem = kind.add_to(&mut core, name, options, source, &catalog.interfaces).err();
        let declared = core.settings(name);
        Self {
            settings: declared.unwrap_or_else(|| core.refused_settings().to_vec()),
            ports: ports(&core, catalog),
            periods_s: core
                .periods(name)
                .unwrap_or_default()
                .iter()
                .map(std::time::Duration::as_secs_f64)
                .collect(),
            problem,
            required: Vec::new(),
        }
    }

    /// The same with all settings that the module asks for: it refuses the first that is missing, and
    /// declares and asks for further ones only when that is given.
    fn with_required(
        catalog: &Catalog,
        kind: &Kind,
        settings: &BTreeMap<String, SettingValue>,
        source: &ModuleSource,
    ) -> Self {
        let mut draft = Self::of(catalog, kind, settings, source);
        let mut filled = settings.clone();
        let mut missing = refused_setting(draft.problem.as_ref());
        while let Some(setting) = missing.take()
            && draft.required.len() < MOST_REQUIRED
            && !filled.contains_key(&setting)
        {
            draft.required.push(setting.clone());
            let Some(info) = draft.settings.iter().find(|info| info.name == setting) else { break };
            // A placeholder names no file.
            if kind.files().contains(&setting) {
                break;
            }
            filled.insert(setting, placeholder(info));
            let next = Self::of(catalog, kind, &filled, source);
            for info in next.settings {
                if !draft.settings.iter().any(|known| known.name == info.name) {
                    draft.settings.push(info);
                }
            }
            missing = refused_setting(next.problem.as_ref());
        }
        draft
    }

    /// Why the module is refused, with everything that it asks for.
    fn needs(&self) -> Option<String> {
        let problem = self.problem.as_ref()?.to_string();
        let others: Vec<String> =
            self.required.iter().skip(1).map(|setting| format!("\"{setting}\"")).collect();
        Some(match others.is_empty() {
            true => problem,
            false => format!("{problem}; it also needs {}", others.join(", ")),
        })
    }

    /// `plain` is the draft without settings, this one that with those that are `given`.
    fn profile(&self, kind: &Kind, plain: &Self, given: &BTreeMap<String, SettingValue>) -> KindProfile {
        let [required, optional] = kind.keys();
        let key = |is_required| move |&name: &&'static str| KeyProfile { name, is_required };
        let setting = |info: &SettingInfo| {
            // What is not given has its default, also where it is declared only beside others.
            let default = match given.contains_key(&info.name) {
                true => plain.settings.iter().find(|known| known.name == info.name),
                false => Some(info),
            };
            SettingProfile {
                name: info.name.clone(),
                description: info.description.clone(),
                value_type: type_of(&info.value),
                default: default.map(|known| json_of(&known.value)),
                range: info.range.as_ref().map(|range| [*range.start(), *range.end()]),
                choices: info.choices.clone(),
                is_read_only: info.is_read_only,
                is_file: kind.files().contains(&info.name),
                is_required: plain.required.contains(&info.name) || self.required.contains(&info.name),
            }
        };
        KindProfile {
            kind: kind.name().to_owned(),
            about: kind.about().to_owned(),
            is_emulated: kind.is_emulated(),
            uses_device: kind.uses_device(),
            runs: match kind.synchrony() {
                Synchrony::EveryCycle => Runs::EveryCycle,
                Synchrony::Detached(_) => Runs::Detached,
                _ => Runs::WhenDue,
            },
            periods_s: self.periods_s.clone(),
            keys: required.iter().map(key(true)).chain(optional.iter().map(key(false))).collect(),
            settings: self.settings.iter().map(setting).collect(),
            ports: self.ports.clone(),
            panel: panel(kind),
            needs: self.needs(),
        }
    }
}

fn refused_setting(problem: Option<&SetupError>) -> Option<String> {
    match problem {
        Some(SetupError::SettingValue { setting, .. }) => Some(setting.clone()),
        _ => None,
    }
}

fn panel(kind: &Kind) -> Option<PanelProfile> {
    kind.panel().map(|panel| PanelProfile {
        title: panel.title.to_owned(),
        topics: panel.topics.iter().map(|&topic| topic.to_owned()).collect(),
    })
}

/// The ports of the only module of a core, without those of the executor and the parts of actions.
fn ports(core: &Core, catalog: &Catalog) -> Vec<PortProfile> {
    let graph = core.graph();
    let topics: Vec<TopicInfo> = core.topics().cloned().collect();
    let services: Vec<_> = core.services().collect();
    let interfaces = &catalog.interfaces;
    let topic = |index: usize, role| {
        let info = &topics.iter().find(|info| *info.name == *graph.topics[index].name)?;
        let known = interfaces.message_in(info);
        let is_own = !info.name.starts_with("executor/") && !info.name.contains("/_action/");
        is_own.then(|| PortProfile {
            name: info.name.to_string(),
            what: PortKind::Topic,
            role,
            type_name: known.map_or(info.message_type, |known| known.name()).to_owned(),
        })
    };
    let service = |index: usize, role| {
        let info = services.iter().find(|info| *info.name == *graph.services[index].name)?;
        if let Some(action) = info.name.strip_suffix(SEND_GOAL) {
            let known = interfaces.action_of(info).map(|known| known.name());
            return Some(PortProfile {
                name: action.to_owned(),
                what: PortKind::Action,
                role,
                type_name: known.unwrap_or(info.request_type).to_owned(),
            });
        }
        (!info.name.contains("/_action/")).then(|| PortProfile {
            name: info.name.to_string(),
            what: PortKind::Service,
            role,
            type_name: interfaces.service_of(info).map_or(info.request_type, |known| known.name()).to_owned(),
        })
    };
    let mut ports: Vec<PortProfile> = graph
        .edges
        .iter()
        .filter_map(|edge| match *edge {
            GraphEdge::Publishes { topic: index, .. } => topic(index, PortRole::Publishes),
            GraphEdge::Subscribes { topic: index, .. } => topic(index, PortRole::Subscribes),
            GraphEdge::Serves { service: index, .. } => service(index, PortRole::Serves),
            GraphEdge::Calls { service: index, .. } => service(index, PortRole::Calls),
            GraphEdge::Leaves { .. } => None,
        })
        .collect();
    ports.sort_by_key(|port| (port.what, port.role));
    ports.dedup();
    ports
}

fn type_of(value: &SettingValue) -> &'static str {
    match value {
        SettingValue::Bool(_) => "bool",
        SettingValue::Integer(_) => "integer",
        SettingValue::Double(_) => "double",
        SettingValue::Text(_) => "text",
        SettingValue::Bools(_) => "bools",
        SettingValue::Bytes(_) => "bytes",
        SettingValue::Integers(_) => "integers",
        SettingValue::Doubles(_) => "doubles",
        SettingValue::Texts(_) => "texts",
    }
}

fn json_of(value: &SettingValue) -> Value {
    match value {
        SettingValue::Bool(value) => (*value).into(),
        SettingValue::Integer(value) => (*value).into(),
        SettingValue::Double(value) => (*value).into(),
        SettingValue::Text(value) => value.as_str().into(),
        SettingValue::Bools(values) => values.clone().into(),
        SettingValue::Bytes(values) => values.clone().into(),
        SettingValue::Integers(values) => values.clone().into(),
        SettingValue::Doubles(values) => values.clone().into(),
        SettingValue::Texts(values) => values.clone().into(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn profile(kind: &str, settings: &[(&str, SettingValue)]) -> KindProfile {
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        Catalog::built_in().profile(kind, &settings, &ModuleSource::default()).unwrap()
    }

    #[test]
    fn a_kind_that_needs_a_setting_says_which_and_shows_all() {
        let lacking = profile("forward_command", &[]);
        assert!(lacking.needs.as_ref().unwrap().contains("\"joints\""), "{lacking:?}");
        let joints = lacking.settings.iter().find(|setting| setting.name == "joints").unwrap();
        assert!(joints.is_required && joints.value_type == "texts", "{joints:?}");

        let wrong = profile("forward_command", &[("interface_name", "torque".to_owned().into())]);
        let is_required =
            |name: &str| wrong.settings.iter().any(|setting| setting.name == name && setting.is_required);
        assert!(!is_required("interface_name"), "a wrong value is no missing one: {wrong:?}");

        let given = profile("forward_command", &[("joints", vec!["left".to_owned()].into())]);
        assert_eq!(given.needs, None);
        let interface = given.settings.iter().find(|setting| setting.name == "interface_name").unwrap();
        assert_eq!(interface.choices, ["position", "velocity", "effort"]);
        assert_eq!(interface.default, Some("position".into()));
        assert!(
            given.ports.iter().any(|port| port.role == PortRole::Publishes && port.what == PortKind::Topic)
        );
    }

    #[test]
    fn a_kind_that_needs_several_settings_names_all_of_them_at_once() {
        let lacking = profile("diff_drive", &[]);
        let required = |profile: &KindProfile| -> Vec<String> {
            let required = profile.settings.iter().filter(|setting| setting.is_required);
            required.map(|setting| setting.name.clone()).collect()
        };
        let all = ["left_wheel_names", "right_wheel_names", "wheel_separation", "wheel_radius"];
        assert_eq!(required(&lacking), all, "{lacking:?}");
        let needs = lacking.needs.unwrap();
        assert!(needs.contains("setting \"left_wheel_names\""), "{needs}");
        assert!(
            needs.ends_with("; it also needs \"right_wheel_names\", \"wheel_separation\", \"wheel_radius\""),
            "{needs}"
        );
        let given = profile("diff_drive", &[("left_wheel_names", vec!["l".to_owned()].into())]);
        assert_eq!(required(&given), all);
        let needs = given.needs.unwrap();
        assert!(needs.ends_with("; it also needs \"wheel_separation\", \"wheel_radius\""), "{needs}");
        let radius = given.settings.iter().find(|setting| setting.name == "wheel_radius").unwrap();
        assert_eq!(
            radius.default,
            lacking.settings.iter().find(|setting| setting.name == "wheel_radius").unwrap().default
        );
    }

    #[test]
    fn an_action_is_one_port() {
        let motions = profile("motions", &[]);
        let actions: Vec<_> = motions.ports.iter().filter(|port| port.what == PortKind::Action).collect();
        assert_eq!(actions.len(), 1, "{:?}", motions.ports);
        assert_eq!(actions[0].type_name, "downbeat_interfaces/action/PlayMotion");
        assert!(motions.ports.iter().all(|port| !port.name.contains("_action")), "{:?}", motions.ports);
        let falls = profile("falls", &[]);
        let play = falls.ports.iter().find(|port| port.what == PortKind::Action).unwrap();
        assert_eq!((play.name.as_str(), play.role), ("play_motion", PortRole::Calls));
    }

    #[test]
    fn defaults_are_those_without_the_given_settings() {
        let mux = profile("joint_command_mux", &[("hold_s", 0.5.into())]);
        let hold = mux.settings.iter().find(|setting| setting.name == "hold_s").unwrap();
        assert_eq!(hold.default, Some(2.0.into()));
    }

    #[test]
    fn the_profiles_of_all_kinds_are_json_of_one_form() {
        let catalog = Catalog::built_in();
        for kind in catalog.kinds() {
            let profile = profile(kind.name(), &[]);
            let json = serde_json::to_value(&profile).unwrap();
            for port in json["ports"].as_array().unwrap() {
                assert!(
                    port["type"].is_string() && port["is"].is_string() && port["does"].is_string(),
                    "{port}"
                );
            }
            assert_eq!(profile.runs == Runs::Detached, matches!(kind.synchrony(), Synchrony::Detached(_)));
            assert!(profile.needs.is_some() || !profile.ports.is_empty() || kind.is_emulated(), "{json}");
        }
    }
}
