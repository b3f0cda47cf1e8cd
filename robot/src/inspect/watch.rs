//! Fields of topics that a client of the inspection socket watches.

use std::any::TypeId;
use std::collections::{BTreeMap, VecDeque};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use downbeat_edge::{CoreAccess, Interfaces, KnownType, Offered, RawMessage, Sink};
use downbeat_executor::{CoreHandle, Inbox, Outlet, OutletInbox, Received, Time, TopicInfo};
use downbeat_msgs::definitions::suggestion;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, DynamicView};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::Unavailable;
use crate::table::{NumberField, Series, check_number, number_at, numbers_of};

/// The values of a watched topic since they were last requested.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TopicValues {
    /// The topic, without a leading slash.
    pub topic: String,
    /// How many messages since the last request were dropped, because they were not requested in time.
    pub missed: u64,
    /// The watched fields, in the order of the request.
    pub fields: Vec<FieldValues>,
}

/// The values of a watched field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldValues {
    /// The path of the field: `position[3]`.
    pub field: String,
    /// The values with the times of the cycles that published them.
    #[serde(flatten)]
    pub series: Series,
    /// Why the latest message has no number there.
    pub problem: Option<String>,
}

/// What one client watches. The outlets close when it is dropped.
pub struct Watch {
    core: CoreHandle,
    interfaces: Interfaces,
    inbox: OutletInbox,
    topics: BTreeMap<String, Watched>,
}

struct Watched {
    feed: Arc<Mutex<Feed>>,
    /// `None` for a topic whose messages pass as bytes, each with its own type.
    message_type: Option<DynamicType>,
    _outlet: Outlet,
}

/// How long the core may take to list its topics.
const PATIENCE: Duration = Duration::from_secs(5);

/// How many batches wait while the thread that reads them is busy; older ones are dropped.
const CAPACITY: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

impl Watch {
    /// The most topics of one client.
    pub const MOST_TOPICS: usize = 16;

    /// The most fields of one topic.
    pub const MOST_FIELDS: usize = 16;

    /// The most values of a field that wait until they are requested; older ones are dropped.
    pub const MOST_VALUES: usize = 4096;

    /// The most numbers of a message that are listed.
    pub const MOST_NUMBERS: usize = 2000;

    /// Watches nothing yet. Only messages of these interfaces, and those that pass as bytes, can be watched.
    #[must_use]
    pub fn new(core: CoreHandle, interfaces: Interfaces) -> Self {
        let inbox = OutletInbox::new("inspect", Inbox::KeepLast(CAPACITY));
        Self { core, interfaces, inbox, topics: BTreeMap::new() }
    }

    /// Watches these fields of a topic, and no others of it. Without fields, only the latest message is kept,
    /// for [`numbers`](Self::numbers).
    ///
    /// # Errors
    /// Returns a message if there is no such topic or no number at one of the fields, with the most similar
    /// name; if these are too many; or if the core does not answer. What was watched before stays.
    pub fn watch(&mut self, topic: &str, fields: &[String]) -> Result<(), String> {
        if fields.len() > Self::MOST_FIELDS {
            return Err(format!("at most {} fields of a topic can be watched", Self::MOST_FIELDS));
        }
        let topic = topic.trim_start_matches('/');
        if let Some(Watched { feed, message_type, .. }) = self.topics.get(topic) {
            check(topic, fields, message_type.as_ref())?;
            feed.lock().select(fields);
            return Ok(());
        }
        if self.topics.len() >= Self::MOST_TOPICS {
            return Err(format!("at most {} topics can be watched", Self::MOST_TOPICS));
        }
        let watched = self.open(topic, fields)?;
        self.topics.insert(topic.to_owned(), watched);
        Ok(())
    }

    /// Ends watching a topic; does nothing if it is not watched.
    pub fn unwatch(&mut self, topic: &str) {
        self.topics.remove(topic.trim_start_matches('/'));
    }

    /// Lists the numbers in the latest message of a watched topic, at most
    /// [`MOST_NUMBERS`](Self::MOST_NUMBERS); `None` if there was no message since it is watched.
    ///
    /// # Errors
    /// Returns a message if the topic is not watched, or its latest message cannot be read.
    pub fn numbers(&self, topic: &str) -> Result<Option<Vec<NumberField>>, String> {
        let topic = topic.trim_start_matches('/');
        let watched = self.topics.get(topic).ok_or_else(|| format!("{topic} is not watched"))?;
        let latest = watched.feed.lock().latest.clone();
        let Some((of, cdr)) = latest else { return Ok(None) };
        let of = of.map_err(no_definition)?;
        let message = DynamicMessage::from_cdr(&of, &cdr).map_err(|error| format!("{topic}: {error}"))?;
        Ok(Some(numbers_of(&message, Self::MOST_NUMBERS)))
    }

    /// Takes the values that have arrived since the last call, of all topics in the order of their names.
    pub fn values(&self) -> Vec<TopicValues> {
        let take = |(topic, watched): (&String, &Watched)| watched.feed.lock().take(topic);
        self.topics.iter().map(take).collect()
    }

    fn open(&self, topic: &str, fields: &[String]) -> Result<Watched, String> {
        let topics = self.core.topics().wait(PATIENCE).ok_or_else(|| Unavailable::NoAnswer.to_string())?;
        let known = topics.iter().find(|known| &*known.name == topic).ok_or_else(|| {
            let hint = suggestion(topic, topics.iter().map(|known| &known.name));
            format!("there is no topic \"{topic}\"{hint}")
        })?;
        let feed = Arc::new(Mutex::new(Feed::default()));
        feed.lock().select(fields);
        let mut core = CoreAccess::Running(&self.core);
        let into = Arc::clone(&feed);
        let (message_type, outlet) = if known.message_type_id == TypeId::of::<RawMessage>() {
            let take = move |raw: Received<'_, RawMessage>| {
                let mut feed = into.lock();
                feed.missed += u64::from(raw.missed());
                feed.add(raw.message_type(), raw.time(), raw.cdr().clone());
            };
            (None, core.outlet(topic, &self.inbox, take))
        } else {
            let known = self.known_type(known)?;
            let of = known.dynamic();
            check(topic, fields, of.as_ref())?;
            (of, known.outlet(&mut core, topic, &self.inbox, Reading { of: known, feed: into }))
        };
        Ok(Watched { feed, message_type, _outlet: outlet.map_err(|error| error.to_string())? })
    }

    fn known_type(&self, topic: &TopicInfo) -> Result<KnownType, String> {
        self.interfaces.message_in(topic).ok_or_else(|| {
            format!(
                "{} carries {}, which is no message of ROS 2 and has no fields",
                topic.name, topic.message_type
            )
        })
    }
}

fn check(topic: &str, fields: &[String], of: Option<&DynamicType>) -> Result<(), String> {
    let Some(of) = of else { return Ok(()) };
    fields.iter().try_for_each(|field| {
        check_number(of, field).map_err(|problem| format!("{topic} has no number at {field}: {problem}"))
    })
}

fn no_definition(type_name: &str) -> String {
    format!("the definition of {type_name} is not known")
}

/// Passes the messages of a topic to its feed, on the thread of the inbox. Only messages that are read are
/// serialized.
struct Reading {
    of: KnownType,
    feed: Arc<Mutex<Feed>>,
}

impl Sink for Reading {
    fn is_wanted(&mut self, message: Offered) -> bool {
        let mut feed = self.feed.lock();
        feed.missed += u64::from(message.missed);
        !feed.fields.is_empty() || message.is_last_of_cycle
    }

    fn take(&mut self, time: Time, cdr: Bytes) {
        self.feed.lock().add(self.of, time, cdr);
    }
}

/// The values of a topic that wait until they are requested.
#[derive(Default)]
struct Feed {
    fields: Vec<Field>,
    missed: u64,
    /// The type and the bytes of the latest message; the name of the type if its definition is unknown.
    latest: Option<(Result<DynamicType, &'static str>, Bytes)>,
    /// The type of the latest message.
    known: Option<KnownType>,
}

#[derive(Default)]
struct Field {
    path: String,
    /// Seconds, and values.
    values: VecDeque<(f64, f64)>,
    problem: Option<String>,
}

impl Feed {
    /// Keeps the values of fields that stay selected.
    fn select(&mut self, fields: &[String]) {
        let mut earlier = std::mem::take(&mut self.fields);
        self.fields = fields
            .iter()
            .map(|path| match earlier.iter().position(|field| field.path == *path) {
                Some(index) => earlier.swap_remove(index),
                None => Field { path: path.clone(), ..Field::default() },
            })
            .collect();
    }

    fn add(&mut self, known: KnownType, time: Time, cdr: Bytes) {
        // The definition is parsed once; that of a type that passes as bytes may become known later.
        let of = match self.latest.take() {
            Some((Ok(of), _)) if self.known == Some(known) => Ok(of),
            _ => known.dynamic().ok_or(known.name()),
        };
        self.known = Some(known);
        let view = match &of {
            Ok(of) => DynamicView::new(of, &cdr).map_err(|error| error.to_string()),
            Err(type_name) => Err(no_definition(type_name)),
        };
        let mut is_dropped = false;
        for field in &mut self.fields {
            let value = view.as_ref().map_err(Clone::clone).and_then(|view| number_at(view, &field.path));
            match value {
                Ok(value) => {
                    field.problem = None;
                    if field.values.len() >= Watch::MOST_VALUES {
                        field.values.pop_front();
                        is_dropped = true;
                    }
                    field.values.push_back((time.as_nanos() as f64 / 1e9, value));
                }
                Err(problem) => field.problem = Some(problem),
            }
        }
        self.missed += u64::from(is_dropped);
        drop(view);
        self.latest = Some((of, cdr));
    }

    fn take(&mut self, topic: &str) -> TopicValues {
        let take = |field: &mut Field| {
            let (times, values) = field.values.drain(..).unzip();
            let series = Series { times, values };
            FieldValues { field: field.path.clone(), series, problem: field.problem.clone() }
        };
        let fields = self.fields.iter_mut().map(take).collect();
        TopicValues { topic: topic.to_owned(), missed: std::mem::take(&mut self.missed), fields }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use downbeat_executor::Core;
    use downbeat_msgs::dynamic::{Definitions, Schemas};
    use downbeat_msgs::geometry_msgs::msg::Vector3;
    use downbeat_msgs::std_msgs::msg::Float64;

    use super::*;

    fn feed(fields: &[&str]) -> Feed {
        let mut feed = Feed::default();
        feed.select(&fields.iter().map(|field| (*field).to_owned()).collect::<Vec<_>>());
        feed
    }

    fn add(feed: &mut Feed, seconds: i64, x: f64) {
        let cdr = downbeat_msgs::cdr::to_vec(&Vector3 { x, ..Vector3::default() });
        feed.add(KnownType::of::<Vector3>(), Time::from_nanos(seconds * 1_000_000_000), cdr.into());
    }

    #[test]
    fn values_wait_in_bounded_memory_and_the_oldest_are_counted_as_missed() {
        let mut feed = feed(&["x", "y"]);
        let most = Watch::MOST_VALUES as i64;
        (0..most + 3).for_each(|second| add(&mut feed, second, second as f64));
        let values = feed.take("v");
        assert_eq!((values.topic.as_str(), values.missed), ("v", 3));
        let series = &values.fields[0].series;
        assert_eq!((series.values.len(), series.values[0]), (Watch::MOST_VALUES, 3.0));
        assert_eq!(series.times, series.values);
        assert_eq!(values.fields[1].field, "y");
        assert_eq!(feed.take("v").fields[0].series, Series::default(), "they are taken once");
    }

    #[test]
    fn a_field_that_stays_selected_keeps_its_values() {
        let mut feed = feed(&["x", "y"]);
        add(&mut feed, 1, 5.0);
        feed.select(&["z".to_owned(), "x".to_owned()]);
        add(&mut feed, 2, 6.0);
        let values = feed.take("v").fields;
        assert_eq!((values[0].field.as_str(), &values[0].series.times[..]), ("z", &[2.0][..]));
        assert_eq!((values[1].field.as_str(), &values[1].series.values[..]), ("x", &[5.0, 6.0][..]));
    }

    #[test]
    fn bytes_that_are_no_message_are_a_problem_of_the_field() {
        let mut feed = feed(&["x"]);
        add(&mut feed, 1, 5.0);
        for bytes in [&b""[..], b"\0\x01", b"\0\x01\0\0\x07", &[0xff; 64]] {
            feed.add(KnownType::of::<Vector3>(), Time::ZERO, Bytes::copy_from_slice(bytes));
            assert!(feed.fields[0].problem.is_some(), "{bytes:?}");
        }
        add(&mut feed, 2, 6.0);
        let values = feed.take("v");
        assert_eq!(values.fields[0].series.values, [5.0, 6.0]);
        assert_eq!(values.fields[0].problem, None);
    }

    #[test]
    fn messages_that_pass_as_bytes_are_read_by_their_definition() {
        let mut schemas = Schemas::new("a bag");
        schemas.add("legs/msg/Leg", "ros2msg", "float64[] angles\n").unwrap();
        let definitions = Definitions::new().with(schemas);
        let leg = KnownType::raw("legs/msg/Leg", &definitions).unwrap();
        let mut message = DynamicMessage::new(&leg.dynamic().unwrap());
        message.push("angles", 0.5).unwrap();

        let mut core = Core::new();
        let inlet = core.inlet::<RawMessage>("leg").unwrap();
        let _text = core.inlet::<String>("text").unwrap();
        let handle = core.handle();
        let running = std::thread::spawn(move || core.run());
        let mut watch = Watch::new(handle.clone(), Interfaces::carried());
        watch.watch("/leg", &["angles[0]".to_owned()]).unwrap();
        assert_eq!(watch.numbers("leg").unwrap(), None);
        inlet.publish(RawMessage::new(leg, message.to_cdr().into())).unwrap();
        let numbers = until(|| watch.numbers("leg").unwrap());
        assert_eq!(numbers[0].field, "angles[0]");
        assert_eq!(watch.values()[0].fields[0].series.values, [0.5]);
        let error = watch.watch("text", &[]).unwrap_err();
        assert!(error.contains("no message of ROS 2"), "{error}");
        handle.stop();
        running.join().unwrap().unwrap();
    }

    #[test]
    fn an_outlet_is_open_only_while_its_topic_is_watched() {
        let mut core = Core::new();
        let inlet = core.inlet::<Float64>("height").unwrap();
        let handle = core.handle();
        let running = std::thread::spawn(move || core.run());
        let outlets = || handle.snapshot().wait(PATIENCE).unwrap().outlets.len();
        let mut watch = Watch::new(handle.clone(), Interfaces::carried());
        assert_eq!(outlets(), 0);
        watch.watch("height", &["data".to_owned()]).unwrap();
        assert_eq!(outlets(), 1);
        inlet.publish(Float64 { data: 1.5 }).unwrap();
        let values = until(|| watch.values().pop().filter(|topic| !topic.fields[0].series.values.is_empty()));
        assert_eq!(values.fields[0].series.values, [1.5]);
        let refused = watch.watch("height", &["dta".to_owned()]).unwrap_err();
        assert!(refused.contains("height has no number at dta") && refused.contains("`data`"), "{refused}");
        assert_eq!(watch.values()[0].fields[0].field, "data", "what was watched before stays");
        watch.unwatch("height");
        until(|| (outlets() == 0).then_some(()));
        watch.watch("height", &[]).unwrap();
        drop(watch);
        until(|| (outlets() == 0).then_some(()));
        handle.stop();
        running.join().unwrap().unwrap();
    }

    #[test]
    fn requests_for_too_much_are_refused() {
        let mut core = Core::new();
        let open = |topic| core.inlet::<Float64>(&format!("height_{topic}")).unwrap();
        let _inlets: Vec<_> = (0..=Watch::MOST_TOPICS).map(open).collect();
        let handle = core.handle();
        let running = std::thread::spawn(move || core.run());
        let mut watch = Watch::new(handle.clone(), Interfaces::carried());
        let many = vec!["data".to_owned(); Watch::MOST_FIELDS + 1];
        assert_eq!(
            watch.watch("height_0", &many).unwrap_err(),
            "at most 16 fields of a topic can be watched"
        );
        (0..Watch::MOST_TOPICS).for_each(|topic| watch.watch(&format!("height_{topic}"), &[]).unwrap());
        assert_eq!(watch.watch("height_16", &[]).unwrap_err(), "at most 16 topics can be watched");
        handle.stop();
        running.join().unwrap().unwrap();
    }

    /// Polls: values arrive on the thread of the inbox.
    fn until<T>(mut poll: impl FnMut() -> Option<T>) -> T {
        let end = std::time::Instant::now() + Duration::from_secs(60);
        loop {
            if let Some(found) = poll() {
                return found;
            }
            assert!(std::time::Instant::now() < end, "gave up waiting");
            std::thread::yield_now();
        }
    }
}
