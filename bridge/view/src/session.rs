//! What one viewer asks for.

use crate::client::Client;
use crate::connection::{Ended, Proof, Reader};
use crate::graph::Connections;
use crate::options::Access;
use crate::outbox::{Closed, Frame};
use crate::page::{self, Ask};
use crate::parameters::{Settings, parameter, settings, wanted};
use crate::protocol::{
    BinaryRequest, ClientChannel, Level, Parameter, Request, Subscription, answer, asset_error, asset_head,
    call_failure, status,
};
use crate::shared::Shared;
use crate::source::CoreSource;
use crate::subscribed::Subscribed;
use downbeat_edge::{CoreAccess, EncodedInlet, KnownType, Waiting};
use downbeat_msgs::encoding::{Codec, Encoding};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tungstenite::Message;

/// How long the core may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// The requests of one viewer.
pub(crate) struct Session<'a> {
    shared: &'a Arc<Shared>,
    client: &'a Client,
    proof: Proof,
    subscriptions: HashMap<u32, Subscribed>,
    publications: HashMap<u32, Publication>,
    open_calls: Arc<AtomicUsize>,
    open_asks: Arc<AtomicUsize>,
}

/// A topic on which the viewer publishes.
struct Publication {
    inlet: EncodedInlet,
    /// From JSON to CDR.
    codec: Option<Codec>,
    failures: Failures,
}

/// The messages of a publication that were refused. Each reason is reported, but not for each message.
#[derive(Default)]
struct Failures {
    /// When each reason was reported last.
    reported: HashMap<String, Instant>,
    /// How many messages have been refused since without a report.
    silent: u64,
}

impl Failures {
    /// What to report of a message that was refused at that time, if anything.
    fn report(&mut self, reason: String, now: Instant) -> Option<String> {
        let is_recent = |reported: &Instant| now.saturating_duration_since(*reported) < REPORT_PERIOD;
        self.reported.retain(|_, reported| is_recent(reported));
        if self.reported.contains_key(&reason) || self.reported.len() >= MOST_REASONS {
            self.silent = self.silent.saturating_add(1);
            return None;
        }
        let others = match std::mem::take(&mut self.silent) {
            0 => String::new(),
            silent => format!(" ({silent} more were refused since the last report)"),
        };
        let report = format!("a message was not published: {reason}{others}");
        self.reported.insert(reason, now);
        Some(report)
    }
}

impl<'a> Session<'a> {
    pub(crate) fn new(shared: &'a Arc<Shared>, client: &'a Client, proof: Proof) -> Self {
        let (subscriptions, publications) = (HashMap::new(), HashMap::new());
        Self {
            shared,
            client,
            proof,
            subscriptions,
            publications,
            open_calls: Arc::default(),
            open_asks: Arc::default(),
        }
    }

    /// Serves the viewer until it leaves or is disconnected.
    pub(crate) fn run(&mut self, reader: &mut Reader) -> Ended {
        if self.proof == Proof::WrongToken {
            let text = "the token in the URL is not that of this server: this viewer may only look";
            if self.report(Level::Error, text).is_err() {
                return STALLED;
            }
        }
        loop {
            let message = match reader.next() {
                Ok(message) => message,
                Err(ended) => return ended,
            };
            let served = match &message {
                Message::Text(text) => self.text(text),
                Message::Binary(bytes) => self.binary(bytes),
                _ => Ok(()),
            };
            if served.is_err() {
                return STALLED;
            }
        }
    }

    fn text(&mut self, text: &str) -> Result<(), Closed> {
        let request = match serde_json::from_str(text) {
            Ok(request) => request,
            Err(error) => return self.report(Level::Error, &format!("a request cannot be read: {error}")),
        };
        match request {
            Request::Subscribe { subscriptions } => {
                subscriptions.into_iter().try_for_each(|subscription| self.subscribe(&subscription))
            }
            Request::Unsubscribe { subscription_ids } => {
                subscription_ids.into_iter().for_each(|id| self.unsubscribe(id));
                Ok(())
            }
            Request::Advertise { channels } => channels.iter().try_for_each(|channel| {
                if self.publications.contains_key(&channel.id) {
                    // As the server of Foxglove's SDK answers; the protocol only says that ids may be reused
                    // once unadvertised.
                    let text = format!(
                        "channel {} is advertised already: this advertisement is ignored",
                        channel.id
                    );
                    return self.report(Level::Warning, &text);
                }
                match self.advertise(channel) {
                    Ok(publication) => {
                        self.publications.insert(channel.id, publication);
                        Ok(())
                    }
                    Err(reason) => {
                        self.report(Level::Error, &format!("cannot publish on {}: {reason}", channel.topic))
                    }
                }
            }),
            Request::Unadvertise { channel_ids } => {
                channel_ids.iter().try_for_each(|id| match self.publications.remove(id) {
                    Some(_) => Ok(()),
                    None => {
                        let text = format!("channel {id} is not advertised: this unadvertisement is ignored");
                        self.report(Level::Warning, &text)
                    }
                })
            }
            Request::GetParameters { parameter_names, id } => {
                self.get_parameters(&parameter_names, id.as_deref())
            }
            Request::SetParameters { parameters, id } => self.set_parameters(&parameters, id.as_deref()),
            Request::SubscribeParameterUpdates { parameter_names } => {
                let mut watched = self.client.watched.lock();
                for name in parameter_names {
                    if watched.parameters.len() < MOST_PARAMETERS {
                        watched.parameters.entry(name).or_default();
                    }
                }
                drop(watched);
                self.shared.look_now();
                Ok(())
            }
            Request::UnsubscribeParameterUpdates { parameter_names } => {
                let mut watched = self.client.watched.lock();
                watched.parameters.retain(|name, _| !parameter_names.contains(name));
                Ok(())
            }
            Request::SubscribeConnectionGraph => {
                self.client.watched.lock().connections = Some(Connections::default());
                self.shared.look_now();
                Ok(())
            }
            Request::UnsubscribeConnectionGraph => {
                self.client.watched.lock().connections = None;
                Ok(())
            }
            Request::FetchAsset { uri, request_id } => {
                let frame = match self.shared.assets.read(&uri) {
                    Ok(contents) => Frame::Parts(asset_head(request_id), contents.into()),
                    Err(reason) => Frame::Binary(asset_error(request_id, &reason)),
                };
                self.answer(frame)
            }
            Request::Ask { id, ask, arguments } => self.ask(id, ask, arguments),
        }
    }

    /// Answers on another thread: some questions take seconds, and a viewer has several open.
    fn ask(&self, id: u32, name: String, arguments: Value) -> Result<(), Closed> {
        if self.shared.options.page.is_none() {
            return self.report(Level::Error, "questions are answered on the port of the page");
        }
        if self.open_asks.fetch_add(1, Ordering::Relaxed) >= MOST_ASKS {
            self.open_asks.fetch_sub(1, Ordering::Relaxed);
            let refused = Err(format!("{MOST_ASKS} questions of this viewer wait for an answer already"));
            return self.answer(Frame::Text(answer(id, refused)));
        }
        let (shared, outbox) = (Arc::clone(self.shared), Arc::clone(&self.client.outbox));
        let (open, may_change) = (Arc::clone(&self.open_asks), self.proof == Proof::Full);
        let asked = std::thread::Builder::new().name("view ask".into()).spawn(move || {
            if let Some(page) = &shared.options.page {
                let ask = Ask { name: &name, arguments: &arguments, may_change };
                let answered = page::answer(&shared, page, ask);
                // A viewer that does not read is disconnected by the next announcement.
                let _ = outbox.answer(Frame::Text(answer(id, answered)), shared.options.limits.stall);
            }
            open.fetch_sub(1, Ordering::Relaxed);
        });
        asked.map(drop).or_else(|error| {
            self.open_asks.fetch_sub(1, Ordering::Relaxed);
            self.answer(Frame::Text(answer(id, Err(format!("no thread can be started: {error}")))))
        })
    }

    fn binary(&mut self, bytes: &[u8]) -> Result<(), Closed> {
        match BinaryRequest::read(bytes) {
            Ok(BinaryRequest::Publish { channel_id, data }) => self.publish(channel_id, data),
            Ok(BinaryRequest::Playback(control)) => match self.shared.source.bag() {
                Some(bag) => {
                    bag.control(control);
                    Ok(())
                }
                None => self.report(Level::Error, "this is a running robot: its time cannot be chosen"),
            },
            Ok(BinaryRequest::Call { service_id, call_id, encoding, data }) => {
                let called = self.call(service_id, call_id, encoding, data);
                called.or_else(|reason| self.answer(Frame::Text(call_failure(service_id, call_id, &reason))))
            }
            Err(reason) => self.report(Level::Error, &reason),
        }
    }

    fn subscribe(&mut self, &Subscription { id, channel_id }: &Subscription) -> Result<(), Closed> {
        let limit = self.shared.options.limits.subscriptions;
        let refused = if self.subscriptions.contains_key(&id) {
            format!("subscription {id} exists already")
        } else if self.subscriptions.len() >= limit {
            format!("a viewer may have {limit} subscriptions")
        } else {
            match self.shared.source.subscribe(self.client, id, channel_id) {
                Ok(subscribed) => {
                    self.client.watched.lock().topics.insert(id, Arc::clone(&subscribed.topic));
                    self.subscriptions.insert(id, subscribed);
                    return Ok(());
                }
                Err(reason) => reason,
            }
        };
        self.report(Level::Error, &format!("cannot subscribe: {refused}"))
    }

    fn unsubscribe(&mut self, id: u32) {
        if self.subscriptions.remove(&id).is_some() {
            self.client.outbox.forget(id);
            self.client.watched.lock().topics.remove(&id);
        }
    }

    fn advertise(&self, channel: &ClientChannel) -> Result<Publication, String> {
        self.check_access()?;
        let limit = self.shared.options.limits.publications;
        if self.publications.len() >= limit {
            return Err(format!("a viewer may publish on {limit} topics"));
        }
        let topic = channel.topic.trim_start_matches('/');
        if !(self.shared.options.topics)(topic) {
            return Err("the server does not show this topic".to_owned());
        }
        let source = self.shared.source.core()?;
        let message_type = self.type_of(source, topic, &channel.schema_name)?;
        let codec = match channel.encoding.as_str() {
            "cdr" => None,
            "json" => {
                let codec = Encoding::Json.codec_of_text(message_type.name(), message_type.definition());
                Some(codec.map_err(|error| error.to_string())?)
            }
            other => return Err(format!("the encoding \"{other}\" is neither \"cdr\" nor \"json\"")),
        };
        let mut core = CoreAccess::Running(&source.handle);
        let inlet =
            message_type.inlet_with(&mut core, topic, Waiting::All).map_err(|error| error.to_string())?;
        tracing::info!("a viewer publishes on /{topic} [{message_type}]");
        Ok(Publication { inlet, codec, failures: Failures::default() })
    }

    /// The type that the topic carries, or if it is a new topic that of the name.
    fn type_of(&self, core: &CoreSource, topic: &str, name: &str) -> Result<KnownType, String> {
        let CoreSource { handle, channels, .. } = core;
        // Viewers write both `std_msgs/Bool` and `std_msgs/msg/Bool`.
        let name = match name.split_once('/') {
            Some((package, rest)) if !rest.contains('/') => format!("{package}/msg/{rest}"),
            _ => name.to_owned(),
        };
        let topics = handle.topics().wait(PATIENCE).ok_or(NO_ANSWER)?;
        match topics.iter().find(|info| *info.name == *topic) {
            Some(info) => match channels.message_type(info, &self.shared.options) {
                Some(carried) if carried.name() == name => Ok(carried),
                Some(carried) => Err(format!("it carries {carried}, not {name}")),
                None => Err(format!("it carries {}, which is no ROS 2 type", info.message_type)),
            },
            None => channels.interfaces().find_message(&name).map_err(|error| error.to_string()),
        }
    }

    fn publish(&mut self, channel_id: u32, data: &[u8]) -> Result<(), Closed> {
        let Some(publication) = self.publications.get_mut(&channel_id) else {
            return self.report(Level::Error, &format!("channel {channel_id} was not advertised"));
        };
        let published = match &publication.codec {
            None => publication.inlet.publish(data).map_err(|error| error.to_string()),
            Some(codec) => codec.decode(data).map_err(|error| error.to_string()).and_then(|cdr| {
                publication.inlet.publish_shared(&cdr.into()).map_err(|error| error.to_string())
            }),
        };
        match published {
            Err(reason) => match publication.failures.report(reason, Instant::now()) {
                Some(report) => self.report(Level::Error, &report),
                None => Ok(()),
            },
            Ok(()) => Ok(()),
        }
    }

    fn call(&self, service_id: u32, call_id: u32, encoding: &str, data: &[u8]) -> Result<(), String> {
        self.check_access()?;
        let services = self.shared.source.services();
        let service = services.iter().find(|service| service.id() == service_id);
        let service = service.ok_or_else(|| format!("there is no service {service_id}"))?;
        if encoding != "cdr" {
            return Err(format!("requests are read in \"cdr\", not in \"{encoding}\""));
        }
        let limit = self.shared.options.limits.calls;
        if self.open_calls.load(Ordering::Relaxed) >= limit {
            return Err(format!("{limit} calls of this viewer wait for a response already"));
        }
        service.call(call_id, data, &self.client.outbox, &self.open_calls);
        Ok(())
    }

    fn get_parameters(&self, names: &[String], id: Option<&str>) -> Result<(), Closed> {
        match self.settings() {
            Ok(settings) => self.send_parameters(
                &settings,
                |name| names.is_empty() || names.iter().any(|n| n == name),
                id,
            ),
            Err(reason) => self.report(Level::Error, &reason),
        }
    }

    fn set_parameters(&self, parameters: &[Parameter], id: Option<&str>) -> Result<(), Closed> {
        let before = match self.settings() {
            Ok(before) => before,
            Err(reason) => return self.report(Level::Error, &reason),
        };
        for parameter in parameters {
            if let Err(reason) = self.set(parameter, &before) {
                self.report(
                    Level::Error,
                    &format!("the parameter {} was not set: {reason}", parameter.name),
                )?;
            }
        }
        self.shared.look_now();
        let after = self.settings().unwrap_or(before);
        // Also after a refusal: the viewer shows the value in force.
        self.send_parameters(&after, |name| parameters.iter().any(|parameter| parameter.name == name), id)
    }

    fn settings(&self) -> Result<Settings, String> {
        settings(&self.shared.source.core()?.handle, PATIENCE).ok_or_else(|| NO_ANSWER.to_owned())
    }

    fn set(&self, parameter: &Parameter, present: &Settings) -> Result<(), String> {
        self.check_access()?;
        let (module, info) = present.get(&parameter.name).ok_or("no module has this setting")?;
        let value = wanted(parameter, &info.value)?;
        let set = self.shared.source.core()?.handle.set(module, &info.name, value).wait(PATIENCE);
        set.ok_or(NO_ANSWER)?.map_err(|refused| refused.to_string())
    }

    fn send_parameters(
        &self,
        settings: &Settings,
        is_meant: impl Fn(&str) -> bool,
        id: Option<&str>,
    ) -> Result<(), Closed> {
        let meant = settings.iter().filter(|(name, _)| is_meant(name));
        let values: Vec<_> = meant.map(|(name, (_, info))| parameter(name, &info.value)).collect();
        let mut message = json!({ "op": "parameterValues", "parameters": values });
        if let Some(id) = id {
            message["id"] = json!(id);
        }
        self.answer(Frame::Text(message.to_string()))
    }

    fn check_access(&self) -> Result<(), String> {
        match (self.proof, &self.shared.options.access) {
            (Proof::Full, _) => Ok(()),
            (_, Access::ReadOnly) => Err("the server is read-only".to_owned()),
            _ => Err(
                "this viewer may only look: connect with the token that the server printed at its start, \
                      ws://ADDRESS:PORT/?token=TOKEN"
                    .to_owned(),
            ),
        }
    }

    fn report(&self, level: Level, text: &str) -> Result<(), Closed> {
        self.answer(Frame::Text(status(level, text)))
    }

    fn answer(&self, frame: Frame) -> Result<(), Closed> {
        self.client.outbox.answer(frame, self.shared.options.limits.stall)
    }
}

/// How long a reason is not reported again, and how many reasons are reported in that time.
const REPORT_PERIOD: Duration = Duration::from_secs(5);
const MOST_REASONS: usize = 32;

/// Questions of one viewer that wait for an answer.
const MOST_ASKS: usize = 16;

/// Parameters that one viewer may watch.
const MOST_PARAMETERS: usize = 10_000;

const NO_ANSWER: &str = "the core does not answer: it has stopped or is held, or a module does not return";

const STALLED: Ended = Ended::Refused(1008, "the viewer does not read what it is sent");
