//! Quality of service of an endpoint, and the rule that decides whether a writer and a reader match.
//!
//! A writer must offer at least what a reader requests (DDS 1.4, section 2.2.3). History, lifespan and user
//! data have no influence. Topic and type names are compared by the caller.

use std::time::Duration;

/// Whether lost samples are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reliability {
    BestEffort = 1,
    Reliable = 2,
}

/// Which earlier samples a late reader receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Durability {
    /// None.
    Volatile,
    /// Those in the history of the writer.
    TransientLocal,
    /// Those that a service keeps in memory. ROS 2 has no such service, but other peers may offer it.
    Transient,
    /// Those that a service keeps on disk. ROS 2 has no such service, but other peers may offer it.
    Persistent,
}

/// How many samples are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum History {
    /// The newest ones, acknowledged or not.
    KeepLast(u32),
    /// All until they are acknowledged.
    KeepAll,
}

/// The participant or writer that asserts liveliness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Liveliness {
    /// Its participant, without the application.
    Automatic,
    /// The application, for all writers of the participant at once.
    ManualByParticipant,
    /// The application, for each writer.
    ManualByTopic,
}

/// Whether several writers may update one instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ownership {
    Shared,
    Exclusive,
}

/// Which clock orders the samples of several writers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DestinationOrder {
    /// The reader's, on arrival.
    ByReception,
    /// The writer's source timestamps.
    BySource,
}

/// The scope in which changes are presented in order or together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AccessScope {
    Instance,
    Topic,
    Group,
}

/// How changes of several instances are presented.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Presentation {
    pub access_scope: AccessScope,
    pub coherent: bool,
    pub ordered: bool,
}

/// An encoding of samples (DDS-XTypes 1.3, section 7.6.3.1.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Representation(pub i16);

impl Representation {
    /// What ROS 2 Jazzy uses: plain CDR.
    pub const XCDR1: Self = Self(0);
    /// The second version of CDR.
    pub const XCDR2: Self = Self(2);
}

/// The policies of a writer (offered) or a reader (requested).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Qos {
    pub reliability: Reliability,
    pub durability: Durability,
    pub history: History,
    /// The longest time between two samples; `None` is infinite.
    pub deadline: Option<Duration>,
    /// How long a sample is valid after its source timestamp; `None` is infinite.
    pub lifespan: Option<Duration>,
    pub liveliness: Liveliness,
    /// Time without an assertion after which a writer is no longer alive; `None` is infinite.
    pub lease: Option<Duration>,
    /// The acceptable delay of delivery; `None` is infinite.
    pub latency_budget: Option<Duration>,
    pub ownership: Ownership,
    pub destination_order: DestinationOrder,
    pub presentation: Presentation,
    /// Names or `fnmatch` patterns. An empty list is the partition with the empty name.
    pub partition: Vec<String>,
    /// What a writer sends (the first one) or a reader accepts. An empty list is [`Representation::XCDR1`].
    pub representation: Vec<Representation>,
}

impl Qos {
    /// The policies of a writer that announces none: reliable.
    pub fn writer_default() -> Self {
        Self { reliability: Reliability::Reliable, ..Self::reader_default() }
    }

    /// The policies of a reader that announces none: best effort.
    pub fn reader_default() -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            history: History::KeepLast(1),
            deadline: None,
            lifespan: None,
            liveliness: Liveliness::Automatic,
            lease: None,
            latency_budget: Some(Duration::ZERO),
            ownership: Ownership::Shared,
            destination_order: DestinationOrder::ByReception,
            presentation: Presentation {
                access_scope: AccessScope::Instance,
                coherent: false,
                ordered: false,
            },
            partition: Vec::new(),
            representation: vec![Representation::XCDR1],
        }
    }
}

/// A policy in which a writer and a reader are incompatible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Policy {
    Reliability,
    Durability,
    Deadline,
    Liveliness,
    LatencyBudget,
    Ownership,
    DestinationOrder,
    Presentation,
    Partition,
    Representation,
}

/// The first policy in which `offered` does not satisfy `requested`; `None` if the two match.
pub fn incompatible(offered: &Qos, requested: &Qos) -> Option<Policy> {
    let (offers, wants) = (&offered.presentation, &requested.presentation);
    let checks = [
        (Policy::Reliability, offered.reliability >= requested.reliability),
        (Policy::Durability, offered.durability >= requested.durability),
        (Policy::Deadline, is_within(offered.deadline, requested.deadline)),
        (
            Policy::Liveliness,
            offered.liveliness >= requested.liveliness && is_within(offered.lease, requested.lease),
        ),
        (Policy::LatencyBudget, is_within(offered.latency_budget, requested.latency_budget)),
        (Policy::Ownership, offered.ownership == requested.ownership),
        (Policy::DestinationOrder, offered.destination_order >= requested.destination_order),
        (
            Policy::Presentation,
            offers.access_scope >= wants.access_scope
                && offers.coherent >= wants.coherent
                && offers.ordered >= wants.ordered,
        ),
        (Policy::Partition, partitions_meet(&offered.partition, &requested.partition)),
        (Policy::Representation, is_accepted(&offered.representation, &requested.representation)),
    ];
    checks.into_iter().find(|(_, is_satisfied)| !is_satisfied).map(|(policy, _)| policy)
}

/// Returns whether `offered` is no longer than `requested`; `None` is infinite.
fn is_within(offered: Option<Duration>, requested: Option<Duration>) -> bool {
    requested.is_none_or(|requested| offered.is_some_and(|offered| offered <= requested))
}

fn is_accepted(offered: &[Representation], accepted: &[Representation]) -> bool {
    let sent = offered.first().unwrap_or(&Representation::XCDR1);
    let default = [Representation::XCDR1];
    let accepted = if accepted.is_empty() { &default } else { accepted };
    accepted.contains(sent)
}

fn partitions_meet(offered: &[String], requested: &[String]) -> bool {
    let default = [String::new()];
    let or_default = |names| if <[String]>::is_empty(names) { &default[..] } else { names };
    let (offered, requested) = (or_default(offered), or_default(requested));
    offered.iter().any(|offered| requested.iter().any(|requested| names_match(offered, requested)))
}

/// Two names match if they are equal or one is a pattern that matches the other. Two patterns match only if
/// they are equal.
fn names_match(a: &str, b: &str) -> bool {
    let is_pattern = |name: &str| name.contains(['*', '?', '[']);
    a == b
        || match (is_pattern(a), is_pattern(b)) {
            (true, false) => fits(a.as_bytes(), b.as_bytes()),
            (false, true) => fits(b.as_bytes(), a.as_bytes()),
            _ => false,
        }
}

/// POSIX `fnmatch` without flags or escapes, in time proportional to the product of the lengths: only the
/// last `*` is ever tried again.
fn fits(pattern: &[u8], name: &[u8]) -> bool {
    let (mut at, mut in_name) = (0, 0);
    let mut last_star = None;
    while in_name < name.len() {
        if pattern.get(at) == Some(&b'*') {
            last_star = Some((at, in_name));
            at += 1;
        } else if let Some(length) = fits_one(&pattern[at..], name[in_name]) {
            (at, in_name) = (at + length, in_name + 1);
        } else if let Some((star, taken)) = last_star {
            last_star = Some((star, taken + 1));
            (at, in_name) = (star + 1, taken + 1);
        } else {
            return false;
        }
    }
    pattern[at..].iter().all(|byte| *byte == b'*')
}

/// Bytes of the first element of `pattern`, if `byte` fits it.
fn fits_one(pattern: &[u8], byte: u8) -> Option<usize> {
    match pattern {
        [b'?', ..] => Some(1),
        [b'[', rest @ ..] => {
            let is_negated = matches!(rest, [b'!' | b'^', ..]);
            let set = &rest[usize::from(is_negated)..];
            // A bracket that closes an empty set is its first member.
            let end = 1 + set.get(1..)?.iter().position(|byte| *byte == b']')?;
            (in_set(&set[..end], byte) != is_negated).then_some(1 + usize::from(is_negated) + end + 1)
        }
        [literal, ..] => (*literal == byte).then_some(1),
        [] => None,
    }
}

fn in_set(mut set: &[u8], byte: u8) -> bool {
    loop {
        let (is_member, rest) = match set {
            [low, b'-', high, rest @ ..] => ((*low..=*high).contains(&byte), rest),
            [member, rest @ ..] => (*member == byte, rest),
            [] => return false,
        };
        if is_member {
            return true;
        }
        set = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second(count: u64) -> Option<Duration> {
        Some(Duration::from_secs(count))
    }

    /// Compares two endpoints, both with the defaults of a writer and one change.
    fn check(offered: impl FnOnce(&mut Qos), requested: impl FnOnce(&mut Qos)) -> Option<Policy> {
        let (mut offer, mut request) = (Qos::writer_default(), Qos::writer_default());
        offered(&mut offer);
        requested(&mut request);
        incompatible(&offer, &request)
    }

    fn partitions(offered: &[&str], requested: &[&str]) -> bool {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        check(|qos| qos.partition = names(offered), |qos| qos.partition = names(requested)).is_none()
    }

    #[test]
    fn defaults_match() {
        assert_eq!(incompatible(&Qos::writer_default(), &Qos::reader_default()), None);
        assert_eq!(check(|_| {}, |_| {}), None);
    }

    #[test]
    fn a_writer_that_offers_less_does_not_match_and_one_that_offers_more_does() {
        type Change = fn(&mut Qos);
        let cases: [(Policy, Change, Change); 13] = [
            (
                Policy::Reliability,
                |qos| qos.reliability = Reliability::BestEffort,
                |qos| qos.reliability = Reliability::Reliable,
            ),
            (
                Policy::Durability,
                |qos| qos.durability = Durability::Volatile,
                |qos| qos.durability = Durability::TransientLocal,
            ),
            (Policy::Deadline, |qos| qos.deadline = second(2), |qos| qos.deadline = second(1)),
            (Policy::Deadline, |qos| qos.deadline = None, |qos| qos.deadline = second(1)),
            (
                Policy::Liveliness,
                |qos| qos.liveliness = Liveliness::Automatic,
                |qos| qos.liveliness = Liveliness::ManualByTopic,
            ),
            (Policy::Liveliness, |qos| qos.lease = None, |qos| qos.lease = second(1)),
            (
                Policy::LatencyBudget,
                |qos| qos.latency_budget = second(1),
                |qos| qos.latency_budget = second(0),
            ),
            (
                Policy::DestinationOrder,
                |qos| qos.destination_order = DestinationOrder::ByReception,
                |qos| qos.destination_order = DestinationOrder::BySource,
            ),
            (
                Policy::Presentation,
                |qos| qos.presentation.access_scope = AccessScope::Instance,
                |qos| qos.presentation.access_scope = AccessScope::Topic,
            ),
            (
                Policy::Presentation,
                |qos| qos.presentation.coherent = false,
                |qos| qos.presentation.coherent = true,
            ),
            (
                Policy::Presentation,
                |qos| qos.presentation.ordered = false,
                |qos| qos.presentation.ordered = true,
            ),
            (Policy::Deadline, |qos| qos.deadline = None, |qos| qos.deadline = second(100)),
            (Policy::Liveliness, |qos| qos.lease = second(3), |qos| qos.lease = second(2)),
        ];
        for (policy, less, more) in cases {
            assert_eq!(check(less, more), Some(policy));
            assert_eq!(check(more, less), None, "{policy:?}");
            assert_eq!(check(more, more), None, "{policy:?}");
        }
    }

    #[test]
    fn ownership_must_be_equal() {
        let exclusive = |qos: &mut Qos| qos.ownership = Ownership::Exclusive;
        assert_eq!(check(exclusive, |_| {}), Some(Policy::Ownership));
        assert_eq!(check(|_| {}, exclusive), Some(Policy::Ownership));
        assert_eq!(check(exclusive, exclusive), None);
    }

    #[test]
    fn the_first_representation_of_the_writer_decides() {
        let both = |qos: &mut Qos| qos.representation = vec![Representation::XCDR2, Representation::XCDR1];
        let none = |qos: &mut Qos| qos.representation.clear();
        assert_eq!(check(none, both), None);
        assert_eq!(check(both, none), Some(Policy::Representation));
        assert_eq!(check(both, both), None);
    }

    #[test]
    fn history_and_lifespan_never_decide() {
        let one = |qos: &mut Qos| {
            qos.history = History::KeepAll;
            qos.lifespan = second(1);
        };
        assert_eq!(check(one, |_| {}), None);
        assert_eq!(check(|_| {}, one), None);
    }

    #[test]
    fn partitions_match_by_name_or_by_a_pattern_on_one_side() {
        assert!(partitions(&[], &[]));
        assert!(partitions(&[], &[""]));
        assert!(partitions(&["left", "right"], &["right"]));
        assert!(!partitions(&["left"], &["right"]));
        assert!(!partitions(&["left"], &[]));
        assert!(partitions(&["robot_1/arm"], &["robot_*"]));
        assert!(partitions(&["robot_?"], &["robot_1"]));
        assert!(!partitions(&["robot_?"], &["robot_"]));
        assert!(!partitions(&["a*"], &["*b"]), "two patterns do not match");
        assert!(partitions(&["a*"], &["a*"]), "but equal names do");
    }

    #[test]
    fn patterns_are_those_of_fnmatch() {
        for (pattern, name, is_fitting) in [
            ("*", "", true),
            ("a*b*c", "aXbYbZc", true),
            ("a*b*c", "aXbYbZ", false),
            ("[abc]x", "bx", true),
            ("[!abc]x", "bx", false),
            ("[!abc]x", "dx", true),
            ("[a-c0-9]", "7", true),
            ("[a-c0-9]", "d", false),
            ("[]]", "]", true),
            ("[]-]", "-", true),
            ("[a", "a", false),
            ("[", "[", false),
        ] {
            assert_eq!(fits(pattern.as_bytes(), name.as_bytes()), is_fitting, "{pattern} {name}");
        }
    }

    #[test]
    fn a_hostile_pattern_does_not_take_long() {
        let pattern = "*a".repeat(250) + "b";
        assert!(!fits(pattern.as_bytes(), "a".repeat(500).as_bytes()));
    }
}
