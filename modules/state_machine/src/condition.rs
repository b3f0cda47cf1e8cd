//! Conditions on the latest messages of topics, in the language of charts.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

use downbeat_executor::Time;
use downbeat_files::suggestion;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use rhai::Scope;

use crate::check::unknown_field;
use crate::expressions::{Evaluator, Program, Syntax, functions};
use crate::values::to_map;

/// An expression over the latest messages of topics, such as `battery_state.voltage < 11`.
///
/// A topic is written with `_` in place of `/`: `imu_data_raw.angular_velocity.z` is of `imu/data_raw`. The
/// functions are those of charts (docs/state_machine.md), apart from those of states. The condition does not
/// hold before each of its topics has had a message.
///
/// ```
/// use downbeat_executor::Time;
/// use downbeat_msgs::cdr;
/// use downbeat_msgs::dynamic::DynamicType;
/// use downbeat_msgs::std_msgs::msg::Float64;
/// use downbeat_state_machine::Condition;
///
/// let number = DynamicType::of::<Float64>()?;
/// let types = [("range/front", number.clone()), ("range/back", number)];
/// let mut near = Condition::new("range_front.data < 0.2", types)?;
/// assert_eq!(near.topics().collect::<Vec<_>>(), ["range/front"]);
/// let mut is_near = |seconds: u64, data: f64| {
///     let now = Time::from_nanos(seconds as i64 * 1_000_000_000);
///     near.take("range/front", now, &cdr::to_vec(&Float64 { data }));
///     near.becomes_true(now)
/// };
/// let seen = [(1, 0.1), (2, 0.1), (3, 1.0), (4, 0.1)].map(|(seconds, data)| is_near(seconds, data));
/// assert_eq!(seen, [Ok(true), Ok(false), Ok(false), Ok(true)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Condition {
    program: Program,
    evaluator: Evaluator,
    scope: Scope<'static>,
    /// The topics that it names, with their variables.
    topics: BTreeMap<String, Named>,
    held: bool,
}

struct Named {
    variable: String,
    of: DynamicType,
    has_message: bool,
}

impl Condition {
    /// Reads an expression. `types` are the topics that there are, without the leading slash.
    ///
    /// # Errors
    /// Returns a sentence that names what is wrong: the syntax, or a topic, field or function that does not
    /// exist.
    pub fn new<'a>(
        expression: &str,
        types: impl IntoIterator<Item = (&'a str, DynamicType)>,
    ) -> Result<Self, String> {
        let known: BTreeMap<String, (&str, DynamicType)> =
            types.into_iter().map(|(topic, of)| (topic.replace('/', "_"), (topic, of))).collect();
        let program = read(expression)?;
        let mut topics = BTreeMap::new();
        for (variable, fields) in named(&program) {
            let Some((topic, of)) = known.get(&variable) else {
                let hint = suggestion(&variable, known.keys());
                return Err(wrong(expression, &format!("there is no topic \"{variable}\"{hint}")));
            };
            if let Some(problem) = unknown_field(of, &fields) {
                return Err(wrong(expression, &problem));
            }
            topics.insert((*topic).to_owned(), Named { variable, of: of.clone(), has_message: false });
        }
        let evaluator = Evaluator::new();
        for Named { variable, .. } in topics.values() {
            evaluator.world.write().received.insert(variable.clone(), None);
        }
        Ok(Self { program, evaluator, scope: Scope::new(), topics, held: false })
    }

    /// What an expression names as topics, with `_` for `/`, where it is not known yet which topics there
    /// are.
    ///
    /// # Errors
    /// As for [`new`](Self::new), apart from topics and fields.
    pub fn variables(expression: &str) -> Result<BTreeSet<String>, String> {
        let program = read(expression)?;
        Ok(named(&program).into_iter().map(|(variable, _)| variable).collect())
    }

    /// The topics that it names.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.topics.keys().map(String::as_str)
    }

    /// Takes a message of a topic, as CDR. Those of other topics, and those that are not of its type, change
    /// nothing.
    pub fn take(&mut self, topic: &str, time: Time, cdr: &[u8]) {
        let Some(named) = self.topics.get_mut(topic) else { return };
        let Ok(message) = DynamicMessage::from_cdr(&named.of, cdr) else { return };
        named.has_message = true;
        self.scope.set_value(named.variable.clone(), to_map(message.as_message()));
        let received = Some(since_epoch(time));
        self.evaluator.world.write().received.insert(named.variable.clone(), received);
    }

    /// Whether it holds.
    ///
    /// # Errors
    /// Returns a sentence if it cannot be evaluated, or is neither true nor false.
    pub fn holds(&mut self, now: Time) -> Result<bool, String> {
        if self.topics.values().any(|named| !named.has_message) {
            return Ok(false);
        }
        self.evaluator.begin(since_epoch(now));
        self.evaluator.holds(&self.program, &mut self.scope).map_err(|problem| problem.text)
    }

    /// Whether it holds and did not the last time.
    ///
    /// # Errors
    /// As [`holds`](Self::holds).
    pub fn becomes_true(&mut self, now: Time) -> Result<bool, String> {
        let holds = self.holds(now)?;
        let held = std::mem::replace(&mut self.held, holds);
        Ok(holds && !held)
    }
}

impl fmt::Debug for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Condition").field("program", &self.program).finish_non_exhaustive()
    }
}

/// A program that calls only functions that there are, and names a topic.
fn read(expression: &str) -> Result<Program, String> {
    let program = Program::new(expression, 1, Syntax::Expression).map_err(|problem| problem.text)?;
    if let Some((_, name)) = program.unknown_calls().into_iter().next() {
        let hint = suggestion(&name, functions());
        return Err(wrong(expression, &format!("there is no function \"{name}\"{hint}")));
    }
    if named(&program).is_empty() {
        return Err(wrong(expression, "it names no topic"));
    }
    Ok(program)
}

/// The variables that stand for topics, with the fields that are read of them.
fn named(program: &Program) -> Vec<(String, Vec<String>)> {
    let declared = program.declared();
    let mut named = Vec::new();
    for mut path in program.paths() {
        if path.names.first().is_some_and(|variable| !declared.contains(variable)) {
            let fields = path.names.split_off(1);
            named.extend(path.names.pop().map(|variable| (variable, fields)));
        }
    }
    named
}

fn wrong(expression: &str, problem: &str) -> String {
    format!("`{}`: {problem}", expression.trim())
}

fn since_epoch(time: Time) -> Duration {
    Duration::from_nanos(u64::try_from(time.as_nanos()).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::cdr;
    use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu};

    fn types() -> [(&'static str, DynamicType); 2] {
        [
            ("battery_state", DynamicType::of::<BatteryState>().unwrap()),
            ("imu/data_raw", DynamicType::of::<Imu>().unwrap()),
        ]
    }

    #[test]
    fn it_waits_for_all_of_its_topics() {
        let mut low =
            Condition::new("battery_state.voltage < 11 && norm(imu_data_raw.angular_velocity) < 1", types())
                .unwrap();
        let now = Time::from_nanos(5);
        low.take(
            "battery_state",
            now,
            &cdr::to_vec(&BatteryState { voltage: 10.5, ..BatteryState::default() }),
        );
        assert_eq!(low.holds(now), Ok(false), "no message of the other");
        low.take("imu/data_raw", now, &cdr::to_vec(&Imu::default()));
        low.take("elsewhere", now, &[]);
        assert_eq!((low.becomes_true(now), low.becomes_true(now)), (Ok(true), Ok(false)));
        let mut old =
            Condition::new("age('battery_state') > 2 && battery_state.voltage > 0", types()).unwrap();
        old.take(
            "battery_state",
            now,
            &cdr::to_vec(&BatteryState { voltage: 10.5, ..BatteryState::default() }),
        );
        assert_eq!(old.holds(now), Ok(false));
        assert_eq!(old.holds(Time::from_nanos(3_000_000_000)), Ok(true));
    }

    #[test]
    fn mistakes_are_named() {
        for (expression, problem) in [
            ("battery_state.voltage <", "is no valid expression"),
            ("battery.voltage < 11", "there is no topic \"battery\", did you mean \"battery_state\"?"),
            (
                "battery_state.volt < 11",
                "sensor_msgs/msg/BatteryState has no field \"volt\", did you mean \"voltage\"?",
            ),
            (
                "nrm(imu_data_raw.angular_velocity) > 1",
                "there is no function \"nrm\", did you mean \"norm\"?",
            ),
            ("1 < 2", "it names no topic"),
        ] {
            let error = Condition::new(expression, types()).unwrap_err();
            assert!(error.contains(problem), "{expression}: {error}");
            let is_of_topics = problem.contains("no topic \"") || problem.contains("no field");
            assert_eq!(Condition::variables(expression).err(), (!is_of_topics).then_some(error));
        }
        let named = Condition::variables("imu_data_raw.angular_velocity.z > battery_state.voltage");
        assert_eq!(named.unwrap().into_iter().collect::<Vec<_>>(), ["battery_state", "imu_data_raw"]);
        let mut number = Condition::new("battery_state.voltage", types()).unwrap();
        number.take("battery_state", Time::ZERO, &cdr::to_vec(&BatteryState::default()));
        assert!(number.holds(Time::ZERO).unwrap_err().contains("it has to be true or false"));
    }
}
