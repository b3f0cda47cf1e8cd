//! What a module in another language declares, as data.

use crate::{Interfaces, KnownType};
use downbeat_executor::{ModuleOptions, ServiceInfo, SettingValue, TopicCounter, TopicInfo};
use downbeat_msgs::dynamic::DynamicType;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::Duration;

/// What a module declares in its setup. Each declaration returns its number, by which [`Event`](super::Event)
/// and [`ForeignContext`](super::ForeignContext) name it; each sort of declarations counts from 0.
#[derive(Debug, Default)]
pub struct Declarations {
    pub(super) module_name: String,
    /// The values that settings were given where the module was added.
    pub(super) given: BTreeMap<String, SettingValue>,
    pub(super) items: Vec<Declaration>,
    pub(super) settings: Vec<SettingDeclaration>,
    pub(super) is_run_each_cycle: bool,
    pub(super) is_reloading: bool,
    pub(super) interfaces: Interfaces,
    counts: Counts,
}

/// A setting of a module in another language, see [`SettingInfo`](downbeat_executor::SettingInfo).
#[derive(Clone, Debug)]
pub struct SettingDeclaration {
    /// The name, unique in the module.
    pub name: String,
    /// Its purpose and unit.
    pub description: String,
    /// Its kind, and the value that it has unless it is given another.
    pub default: SettingValue,
    /// The numbers it may have; `None` for no limit.
    pub range: Option<RangeInclusive<f64>>,
    /// True if it does not change after the start.
    pub is_read_only: bool,
}

/// A port or a timer.
#[derive(Debug)]
pub(super) enum Declaration {
    Publish { topic: String, message: Named },
    Subscribe { topic: String, message: Named },
    Serve { service: String, of: Named },
    Client { service: String, of: Named, timeout: Duration },
    Every { period: Duration },
    Task,
}

/// A type by its name, and by its hash if the module was compiled with one.
#[derive(Debug)]
pub(super) struct Named {
    pub(super) name: String,
    pub(super) hash: Option<String>,
}

/// How many there are of each sort.
#[derive(Debug, Default)]
struct Counts {
    publishers: u32,
    subscriptions: u32,
    servers: u32,
    clients: u32,
    timers: u32,
    tasks: u32,
}

impl Declarations {
    /// Creates an empty list for a module that is added under `module_name` with these values of settings.
    #[must_use]
    pub fn new(module_name: &str, given: BTreeMap<String, SettingValue>) -> Self {
        Self { module_name: module_name.to_owned(), given, ..Self::default() }
    }

    /// The same with the interfaces of the robot, for [`definition`](Self::definition).
    #[must_use]
    pub fn with_interfaces(self, interfaces: Interfaces) -> Self {
        Self { interfaces, ..self }
    }

    /// The definition of a message, request, response, goal, result or feedback, such as
    /// `std_srvs/srv/SetBool_Request`: for modules that read messages field by field.
    ///
    /// # Errors
    /// If the robot has no such type.
    pub fn definition(&self, name: &str) -> Result<DynamicType, String> {
        if let Some(of) = self.interfaces.message(name).ok().and_then(KnownType::dynamic) {
            return Ok(of);
        }
        self.interfaces.definitions().find(name).map_err(|error| error.to_string())
    }

    /// Adds the definition of a message, service or action that the module carries, with the text of all that
    /// it refers to: what it declares next may be of this type, also if the robot does not know it.
    ///
    /// # Errors
    /// If the text is no definition, or the robot knows another definition of this name.
    pub fn define(&mut self, name: &str, text: &str) -> Result<(), String> {
        self.interfaces.learn(name, text).map_err(|error| error.to_string())
    }

    /// The definition text of the message, service or action that a name is of or a part of, with its name.
    ///
    /// # Errors
    /// If the robot does not know it.
    pub fn definition_text(&self, name: &str) -> Result<(String, String), String> {
        self.interfaces.definition_text(name).map_err(|error| error.to_string())
    }

    /// The name under which the module is added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.module_name
    }

    /// Declares that the module publishes messages of the type `message`, such as `sensor_msgs/msg/Imu`.
    /// `hash` is the `RIHS01_` hash of the definition that the module was compiled with, which is checked.
    pub fn publish(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        let message = Named::new(message, hash);
        self.items.push(Declaration::Publish { topic: topic.to_owned(), message });
        next(&mut self.counts.publishers)
    }

    /// Declares that the module receives the messages of a topic, as
    /// [`Event::Message`](super::Event::Message).
    pub fn subscribe(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        let message = Named::new(message, hash);
        self.items.push(Declaration::Subscribe { topic: topic.to_owned(), message });
        next(&mut self.counts.subscriptions)
    }

    /// Declares that the module serves a service of the type `service_type`, such as `std_srvs/srv/SetBool`,
    /// with [`Event::Request`](super::Event::Request).
    pub fn serve(&mut self, service: &str, service_type: &str, hash: Option<&str>) -> u32 {
        let of = Named::new(service_type, hash);
        self.items.push(Declaration::Serve { service: service.to_owned(), of });
        next(&mut self.counts.servers)
    }

    /// Declares that the module calls a service. Each call ends with one
    /// [`Event::Reply`](super::Event::Reply), after `timeout` at the latest.
    pub fn client(
        &mut self,
        service: &str,
        service_type: &str,
        hash: Option<&str>,
        timeout: Duration,
    ) -> u32 {
        let of = Named::new(service_type, hash);
        self.items.push(Declaration::Client { service: service.to_owned(), of, timeout });
        next(&mut self.counts.clients)
    }

    /// Declares a timer, see [`Event::Timer`](super::Event::Timer).
    pub fn every(&mut self, period: Duration) -> u32 {
        self.items.push(Declaration::Every { period });
        next(&mut self.counts.timers)
    }

    /// Declares something that can be scheduled, see [`Event::Task`](super::Event::Task).
    pub fn task(&mut self) -> u32 {
        self.items.push(Declaration::Task);
        next(&mut self.counts.tasks)
    }

    /// Requests [`Event::EachRun`](super::Event::EachRun) at the end of each run of the module.
    pub fn each_run(&mut self) {
        self.is_run_each_cycle = true;
    }

    /// Declares a setting. Returns its number, and the value that it has at the start.
    ///
    /// # Errors
    /// If it was given a value of another kind or out of its range.
    pub fn setting(&mut self, setting: SettingDeclaration) -> Result<(u32, SettingValue), String> {
        let SettingDeclaration { name, default, range, .. } = &setting;
        let value = self.given.get(name).unwrap_or(default).clone().into_kind_of(default);
        let value = value.map_err(|problem| format!("setting \"{name}\": {problem}"))?;
        let number = match &value {
            SettingValue::Integer(value) => Some(*value as f64),
            SettingValue::Double(value) => Some(*value),
            _ => None,
        };
        if let (Some(number), Some(range)) = (number, range)
            && !range.contains(&number)
        {
            let (start, end) = (range.start(), range.end());
            return Err(format!("setting \"{name}\": {number} is out of range, {start} to {end} is allowed"));
        }
        self.settings.push(setting);
        Ok((u32::try_from(self.settings.len() - 1).unwrap_or(u32::MAX), value))
    }

    /// The topics of the module in a core, once it joins with these options. Topics of types that the robot
    /// does not know are left out.
    #[must_use]
    pub fn topics(&self, options: &ModuleOptions) -> Vec<TopicInfo> {
        let topic = |item: &Declaration| {
            let (topic, message, is_published) = match item {
                Declaration::Publish { topic, message } => (topic, message, true),
                Declaration::Subscribe { topic, message } => (topic, message, false),
                _ => return None,
            };
            let message = self.interfaces.find_message(&message.name).ok()?;
            Some(TopicInfo {
                name: canonical(&options.resolved(topic)).into(),
                message_type: message.name(),
                message_type_id: message.rust_type(),
                is_published,
                counter: TopicCounter::default(),
            })
        };
        self.items.iter().filter_map(topic).collect()
    }

    /// The services that the module serves or calls, as [`topics`](Self::topics).
    #[must_use]
    pub fn services(&self, options: &ModuleOptions) -> Vec<ServiceInfo> {
        let service = |item: &Declaration| {
            let (service, of, is_served) = match item {
                Declaration::Serve { service, of } => (service, of, true),
                Declaration::Client { service, of, .. } => (service, of, false),
                _ => return None,
            };
            let (request_type, response_type) = self.interfaces.service(&of.name).ok()?.types_in_core();
            Some(ServiceInfo {
                name: canonical(&options.resolved(service)).into(),
                request_type,
                response_type,
                server: is_served.then(|| self.module_name.as_str().into()),
            })
        };
        self.items.iter().filter_map(service).collect()
    }

    /// Makes the core ask regularly for a [successor](super::Foreign::successor).
    pub fn reload(&mut self) {
        self.is_reloading = true;
    }
}

fn canonical(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

impl Named {
    fn new(name: &str, hash: Option<&str>) -> Self {
        Self { name: name.to_owned(), hash: hash.map(str::to_owned) }
    }
}

fn next(count: &mut u32) -> u32 {
    *count += 1;
    *count - 1
}
