//! The parameters of a node, and the answers to requests.

use super::{NodeSide, ParameterExposure, Request, own};
use crate::clock::SimTime;
use crate::edge::{parameter_type, parameter_value, setting_value};
use crate::limiter::Limiter;
use crate::ros::Reply;
use crate::worker::WorkerLink;
use downbeat_executor::{CoreHandle, Receipt, SettingInfo, SettingRefused, SettingValue};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::rcl_interfaces::msg::{
    FloatingPointRange, IntegerRange, ListParametersResult, Parameter as ParameterMessage,
    ParameterDescriptor, ParameterEvent, ParameterType, SetParametersResult,
};
use downbeat_msgs::rcl_interfaces::srv::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, SetParametersAtomicallyRequest, SetParametersAtomicallyResponse,
    SetParametersRequest, SetParametersResponse,
};
use downbeat_msgs::{Service, cdr};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Weak;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The reason of rclcpp for a value of another type (`format_type_reason` of `node_parameters.cpp`).
fn wrong_type(name: &str, own: u8, other: u8) -> String {
    let (own, other) = (type_name(own), type_name(other));
    format!(
        "Wrong parameter type, parameter {{{name}}} is of type {{{own}}}, setting it to {{{other}}} is not allowed."
    )
}

/// The name of a type in rclcpp (`to_string` of `parameter_value.cpp`).
fn type_name(parameter_type: u8) -> &'static str {
    match parameter_type {
        ParameterType::PARAMETER_BOOL => "bool",
        ParameterType::PARAMETER_INTEGER => "integer",
        ParameterType::PARAMETER_DOUBLE => "double",
        ParameterType::PARAMETER_STRING => "string",
        ParameterType::PARAMETER_BYTE_ARRAY => "byte_array",
        ParameterType::PARAMETER_BOOL_ARRAY => "bool_array",
        ParameterType::PARAMETER_INTEGER_ARRAY => "integer_array",
        ParameterType::PARAMETER_DOUBLE_ARRAY => "double_array",
        ParameterType::PARAMETER_STRING_ARRAY => "string_array",
        ParameterType::PARAMETER_NOT_SET => "not set",
        _ => "unknown type",
    }
}

/// How long the core may take to report values; it may be paused.
const TELL: Duration = Duration::from_secs(1);
/// How long a module may take to accept a value: a detached one does between two of its runs.
const ACCEPT: Duration = Duration::from_secs(5);

/// The parameters of one node.
pub(super) struct Parameters {
    core: CoreHandle,
    worker: WorkerLink,
    /// The name of the node.
    node_name: String,
    node: Weak<NodeSide>,
    exposure: ParameterExposure,
    has_followed: bool,
    shown: Shown,
    too_long: Limiter,
    unanswered: Limiter,
}

type Shown = BTreeMap<String, Parameter>;

#[derive(Clone, PartialEq)]
struct Parameter {
    /// The module whose setting it is; `None` for a parameter of the node itself.
    module: Option<String>,
    info: SettingInfo,
}

impl Parameters {
    pub(super) fn new(
        core: CoreHandle,
        worker: WorkerLink,
        node_name: String,
        node: Weak<NodeSide>,
        exposure: ParameterExposure,
        settings: &[(String, Vec<SettingInfo>)],
    ) -> Self {
        let (too_long, unanswered, shown) = (Limiter::default(), Limiter::default(), Shown::new());
        let mut parameters = Self {
            core,
            worker,
            node_name,
            node,
            exposure,
            has_followed: false,
            shown,
            too_long,
            unanswered,
        };
        parameters.has_followed = parameters.is_following();
        parameters.shown = parameters.select(settings.to_vec());
        parameters
    }

    /// Publishes an event with all parameters.
    pub(super) fn announce(&mut self) {
        self.publish_changes(&Shown::new());
    }

    /// Publishes what others have changed, if there are subscriptions.
    pub(super) async fn look_for_listeners(&mut self) {
        if self.node.upgrade().is_some_and(|node| node.events.is_subscribed()) {
            self.refresh().await;
        }
    }

    pub(super) async fn answer(&mut self, request: Request) {
        self.refresh().await;
        match request {
            Request::Get(request, reply) => self.send(reply, &self.get(&request)),
            Request::Types(request, reply) => self.send(reply, &self.types(&request)),
            Request::Describe(request, reply) => self.send(reply, &self.describe(&request)),
            Request::List(request, reply) => self.send(reply, &self.list(&request)),
            Request::Set(request, reply) => {
                let response = self.set(request).await;
                self.refresh().await;
                self.send(reply, &response);
            }
            Request::SetAtomically(request, reply) => {
                let response = self.set_atomically(request).await;
                self.refresh().await;
                self.send(reply, &response);
            }
        }
    }

    fn send<S: Service>(&self, reply: Reply<S>, response: &S::Response) {
        if let Err(error) = reply.send(response)
            && let Some(left_out) = self.unanswered.allow()
        {
            tracing::warn!(service = S::TYPE_NAME, "a request is not answered: {error}{left_out}");
        }
    }

    fn get(&self, request: &GetParametersRequest) -> GetParametersResponse {
        let mut length = 0;
        let value = |name| {
            let value = parameter_value(&self.shown.get(name)?.info.value);
            length += cdr::to_vec(&value).len();
            (length <= LONGEST_VALUES).then_some(value)
        };
        // As in rclcpp: nothing at all when one of them is not there.
        let values = request.names.iter().map(value).collect::<Option<_>>();
        if length > LONGEST_VALUES
            && let Some(left_out) = self.too_long.allow()
        {
            tracing::warn!(
                "a request for parameters of more than {LONGEST_VALUES} bytes was refused{left_out}"
            );
        }
        GetParametersResponse { values: values.unwrap_or_default() }
    }

    fn types(&self, request: &GetParameterTypesRequest) -> GetParameterTypesResponse {
        let types = request.names.iter().map(|name| Some(parameter_type(&self.shown.get(name)?.info.value)));
        GetParameterTypesResponse { types: types.collect::<Option<_>>().unwrap_or_default() }
    }

    fn describe(&self, request: &DescribeParametersRequest) -> DescribeParametersResponse {
        let descriptors =
            request.names.iter().map(|name| Some(descriptor(name, &self.shown.get(name)?.info)));
        DescribeParametersResponse { descriptors: descriptors.collect::<Option<_>>().unwrap_or_default() }
    }

    fn list(&self, request: &ListParametersRequest) -> ListParametersResponse {
        let ListParametersRequest { prefixes, depth } = request;
        let names = self.shown.keys().filter(|name| is_listed(name, prefixes, *depth));
        let mut result = ListParametersResult { names: names.cloned().collect(), prefixes: Vec::new() };
        for name in &result.names {
            if let Some((prefix, _)) = name.rsplit_once('.')
                && !result.prefixes.iter().any(|known| known == prefix)
            {
                result.prefixes.push(prefix.to_owned());
            }
        }
        ListParametersResponse { result }
    }

    async fn set(&self, request: SetParametersRequest) -> SetParametersResponse {
        let mut room = LONGEST_REASONS;
        let mut response = SetParametersResponse::default();
        for parameter in request.parameters {
            let result = result(self.set_one(parameter).await, room);
            room -= result.reason.len();
            response.results.push(result);
        }
        response
    }

    async fn set_atomically(
        &self,
        request: SetParametersAtomicallyRequest,
    ) -> SetParametersAtomicallyResponse {
        let mut names: Vec<String> = Vec::new();
        let mut outcome = Ok(());
        for parameter in request.parameters {
            let name = parameter.name.clone();
            outcome = self.set_one(parameter).await;
            if outcome.is_err() {
                break;
            }
            names.push(name);
        }
        if outcome.is_err() {
            // In reverse order, so that a value that was set twice ends as it began.
            for name in names.iter().rev() {
                if let Some(parameter) = self.shown.get(name)
                    && let Err(reason) = self.put(name, parameter, parameter.info.value.clone()).await
                {
                    tracing::warn!("parameter {name} could not be set back: {reason}");
                }
            }
        }
        SetParametersAtomicallyResponse { result: result(outcome, LONGEST_REASONS) }
    }

    /// # Errors
    /// Why the value is not accepted.
    async fn set_one(&self, message: ParameterMessage) -> Result<(), String> {
        let ParameterMessage { name, value } = message;
        let Some(parameter) = self.shown.get(&name) else {
            return Err(format!("parameter '{name}' cannot be set because it was not declared"));
        };
        if parameter.info.is_read_only {
            return Err(format!("parameter '{name}' cannot be set because it is read-only"));
        }
        let length = cdr::to_vec(&value).len();
        if length > LONGEST_VALUES {
            return Err(format!(
                "the value has {length} bytes, and parameters have at most {LONGEST_VALUES}: more could not be given to those who ask"
            ));
        }
        let wrong_type = wrong_type(&name, parameter_type(&parameter.info.value), value.r#type);
        if value.r#type == ParameterType::PARAMETER_NOT_SET {
            return Err(wrong_type);
        }
        let value = setting_value(value)?;
        let is_same_kind = parameter_type(&value) == parameter_type(&parameter.info.value);
        // Other conversions can only fail by the kind, except that of numbers to bytes.
        let is_bytes =
            matches!((&value, &parameter.info.value), (SettingValue::Integers(_), SettingValue::Bytes(_)));
        match value.into_kind_of(&parameter.info.value) {
            Ok(value) => self.put(&name, parameter, value).await,
            Err(reason) => Err(if is_same_kind || is_bytes { reason } else { wrong_type }),
        }
    }

    async fn put(&self, name: &str, parameter: &Parameter, value: SettingValue) -> Result<(), String> {
        match (&parameter.module, value) {
            (Some(module), value) => self.set_setting(module, &parameter.info.name, value).await,
            // Of a node's own parameters this one can be set.
            (None, SettingValue::Bool(is_on)) if name == own::USE_SIM_TIME => self.use_sim_time(is_on),
            (None, value) => Err(format!(
                "parameter '{name}' is {}, setting it to {value} is not allowed",
                parameter.info.value
            )),
        }
    }

    fn use_sim_time(&self, is_on: bool) -> Result<(), String> {
        let Some(node) = self.node.upgrade() else { return Err("the node was removed".to_owned()) };
        match &node.sim_time {
            Some(sim_time) => sim_time.set(is_on).map_err(|error| error.to_string()),
            None if !is_on => Ok(()),
            None => {
                Err("use_sim_time stays false: others follow the time of this node, on /clock".to_owned())
            }
        }
    }

    async fn set_setting(&self, module: &str, setting: &str, value: SettingValue) -> Result<(), String> {
        match self.receive(ACCEPT, self.core.set(module, setting, value)).await {
            Some(Ok(())) => Ok(()),
            Some(Err(SettingRefused::Refused { reason, .. })) => Err(reason),
            Some(Err(error)) => Err(error.to_string()),
            None => Err(format!("module \"{module}\" did not say within {ACCEPT:?} whether it accepts it")),
        }
    }

    /// What the core answers in time.
    async fn receive<T: 'static>(&self, time: Duration, receipt: Receipt<T>) -> Option<T> {
        self.worker.within(time, receipt).await.flatten()
    }

    /// Asks the core for all values, and publishes what has changed. If it does not answer, the known values
    /// stay.
    async fn refresh(&mut self) {
        self.has_followed |= self.is_following();
        let settings = self.ask_for_settings().await;
        let shown = self.select(settings);
        let before = std::mem::replace(&mut self.shown, shown);
        self.publish_changes(&before);
    }

    fn is_following(&self) -> bool {
        let node = self.node.upgrade();
        node.is_some_and(|node| node.sim_time.as_ref().is_some_and(SimTime::is_on))
    }

    async fn ask_for_settings(&self) -> Vec<(String, Vec<SettingInfo>)> {
        if self.exposure.settings.is_empty() {
            return Vec::new();
        }
        let Some(modules) = self.receive(TELL, self.core.modules()).await else {
            return self.known_settings();
        };
        let asked: Vec<_> = modules
            .iter()
            .map(|module| (module.name.to_string(), self.core.settings(&module.name)))
            .collect();
        let mut settings = Vec::with_capacity(asked.len());
        for (name, receipt) in asked {
            let infos = self.receive(TELL, receipt).await;
            let infos = infos.map_or_else(|| self.known_settings_of(&name), Option::unwrap_or_default);
            settings.push((name, infos));
        }
        settings
    }

    fn known_settings(&self) -> Vec<(String, Vec<SettingInfo>)> {
        let modules: BTreeSet<_> =
            self.shown.values().filter_map(|parameter| parameter.module.as_ref()).collect();
        modules.into_iter().map(|module| (module.clone(), self.known_settings_of(module))).collect()
    }

    fn known_settings_of(&self, module: &str) -> Vec<SettingInfo> {
        let is_of_module = |parameter: &&Parameter| parameter.module.as_deref() == Some(module);
        self.shown.values().filter(is_of_module).map(|parameter| parameter.info.clone()).collect()
    }

    fn select(&self, settings: Vec<(String, Vec<SettingInfo>)>) -> Shown {
        let own = own::parameters(self.is_following(), self.has_followed).into_iter();
        let mut shown: Shown =
            own.map(|info| (info.name.clone(), Parameter { module: None, info })).collect();
        let ParameterExposure { settings: patterns, of_module } = &self.exposure;
        for (module, infos) in settings {
            for info in infos {
                let full_name = format!("{module}.{}", info.name);
                let name = match of_module {
                    None => full_name.clone(),
                    Some(of) if *of == module => info.name.clone(),
                    Some(_) => continue,
                };
                if patterns.iter().any(|pattern| pattern.matches(&full_name)) {
                    shown.entry(name).or_insert_with(|| Parameter { module: Some(module.clone()), info });
                }
            }
        }
        shown
    }

    /// Publishes how the parameters differ from what they were.
    fn publish_changes(&self, before: &Shown) {
        let message = |(name, parameter): (&String, &Parameter)| ParameterMessage {
            name: name.clone(),
            value: parameter_value(&parameter.info.value),
        };
        let is_new = |(name, _): &(&String, &Parameter)| !before.contains_key(*name);
        let is_changed = |(name, parameter): &(&String, &Parameter)| {
            before.get(*name).is_some_and(|before| before.info.value != parameter.info.value)
        };
        let is_gone = |(name, _): &(&String, &Parameter)| !self.shown.contains_key(*name);
        let event = ParameterEvent {
            stamp: now(),
            node: self.node_name.clone(),
            new_parameters: self.shown.iter().filter(is_new).map(message).collect(),
            changed_parameters: self.shown.iter().filter(is_changed).map(message).collect(),
            deleted_parameters: before.iter().filter(is_gone).map(message).collect(),
        };
        let is_empty = event.new_parameters.is_empty()
            && event.changed_parameters.is_empty()
            && event.deleted_parameters.is_empty();
        if !is_empty
            && let Some(node) = self.node.upgrade()
            && let Err(error) = node.events.publish(cdr::to_vec(&event).into())
        {
            tracing::warn!(%error, "a change of parameters was not published");
        }
    }
}

/// The longest value, and those of one response together, in bytes: longer responses do not arrive in time,
/// and hold up those behind them. (Measured with Fast DDS as the client, on loopback of a busy machine: 1 MB
/// takes up to 4 s, 3 MB more than 10 s.)
const LONGEST_VALUES: usize = 1_000_000;

/// The longest reason for a refused value, and those of one response together, in bytes. Reasons repeat names
/// and values, and a response of megabytes, in fragments of 256 bytes, overflows the socket of the client: it
/// and the responses after it arrive too late.
const LONGEST_REASON: usize = 500;
const LONGEST_REASONS: usize = 50_000;

/// With a reason of at most `room` bytes.
fn result(outcome: Result<(), String>, room: usize) -> SetParametersResult {
    let is_successful = outcome.is_ok();
    let mut reason = outcome.err().unwrap_or_default();
    let room = room.min(LONGEST_REASON);
    if reason.len() > room {
        const CUT: &str = "…";
        let end = (0..=room.saturating_sub(CUT.len())).rev().find(|&end| reason.is_char_boundary(end));
        reason.truncate(end.unwrap_or(0));
        if room >= CUT.len() {
            reason.push_str(CUT);
        }
    }
    SetParametersResult { successful: is_successful, reason }
}

fn descriptor(name: &str, info: &SettingInfo) -> ParameterDescriptor {
    let mut descriptor = ParameterDescriptor {
        name: name.to_owned(),
        r#type: parameter_type(&info.value),
        description: info.description.clone(),
        read_only: info.is_read_only,
        ..ParameterDescriptor::default()
    };
    if let Some(range) = &info.range {
        let (from, to) = (*range.start(), *range.end());
        match info.value {
            // A step of 0 means that there is none.
            SettingValue::Integer(_) | SettingValue::Integers(_) => {
                let (from_value, to_value) = (from.ceil() as i64, to.floor() as i64);
                descriptor.integer_range = vec![IntegerRange { from_value, to_value, step: 0 }];
            }
            _ => {
                let (from_value, to_value) = (from, to);
                descriptor.floating_point_range =
                    vec![FloatingPointRange { from_value, to_value, step: 0.0 }];
            }
        }
    }
    descriptor
}

/// The rule of `NodeParameters::list_parameters`.
fn is_listed(name: &str, prefixes: &[String], depth: u64) -> bool {
    let is_within = |rest: &str| {
        depth == ListParametersRequest::DEPTH_RECURSIVE || (rest.matches('.').count() as u64) < depth
    };
    if prefixes.is_empty() {
        return is_within(name);
    }
    prefixes.iter().any(|prefix| {
        name == prefix
            || name
                .strip_prefix(prefix.as_str())
                .and_then(|rest| rest.strip_prefix('.'))
                .is_some_and(is_within)
    })
}

fn now() -> Time {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Time { sec: i32::try_from(now.as_secs()).unwrap_or(i32::MAX), nanosec: now.subsec_nanos() }
}

#[cfg(test)]
mod tests {
    use super::is_listed;

    #[test]
    fn parameters_are_listed_by_prefix_and_depth_as_in_rclcpp() {
        let listed = |prefixes: &[&str], depth| {
            let prefixes: Vec<_> = prefixes.iter().map(|prefix| (*prefix).to_owned()).collect();
            let names = ["use_sim_time", "arm.gain", "arm.left.gain", "armature.x"];
            names.into_iter().filter(|name| is_listed(name, &prefixes, depth)).collect::<Vec<_>>()
        };
        assert_eq!(listed(&[], 0).len(), 4);
        assert_eq!(listed(&[], 1), ["use_sim_time"]);
        assert_eq!(listed(&["arm"], 0), ["arm.gain", "arm.left.gain"]);
        assert_eq!(listed(&["arm"], 1), ["arm.gain"]);
        assert_eq!(listed(&["use_sim_time", "arm.left"], 1), ["use_sim_time", "arm.left.gain"]);
    }
}
