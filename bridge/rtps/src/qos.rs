//! Quality of service of an endpoint, and the rule that decides whether a writer and a reader match.
//!
//! Offered must be at least what is requested (DDS 1.4, table in section 2.2.3). History, lifespan and user data never
//! decide. Topic and type names are compared by the caller.

use std::time::Duration;

/// Whether lost samples are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Reliability {
    BestEffort,
    Reliable,
}

/// Which earlier samples a reader gets that is matched late.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Durability {
    /// None.
    Volatile,
    /// Those in the history of the writer.
    TransientLocal,
    /// Those a service keeps in memory. ROS 2 has none, a foreign peer may offer it.
    Transient,
    /// Those a service keeps on disk. ROS 2 has none, a foreign peer may offer it.
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

/// Who asserts that a writer is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Liveliness {
    /// Its participant, unasked.
    Automatic,
    /// The application, for all writers of the participant at once.
    ManualByParticipant,
    /// The application, for each writer.
    ManualByTopic,
}

/// Whether several writers may update one instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
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
#[allow(missing_docs)]
pub enum AccessScope {
    Instance,
    Topic,
    Group,
}

/// How changes of several instances are presented.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
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
    #[allow(missing_docs)]
    pub reliability: Reliability,
    #[allow(missing_docs)]
    pub durability: Durability,
    #[allow(missing_docs)]
    pub history: History,
    /// The longest time between two samples; `None` is infinite.
    pub deadline: Option<Duration>,
    /// How long a sample is of use after its source timestamp; `None` is for ever.
    pub lifespan: Option<Duration>,
    #[allow(missing_docs)]
    pub liveliness: Liveliness,
    /// After this time without an assertion a writer is taken for dead; `None` is infinite.
    pub lease: Option<Duration>,
    /// The delay that delivery may have; `None` is infinite.
    pub latency_budget: Option<Duration>,
    #[allow(missing_docs)]
    pub ownership: Ownership,
    #[allow(missing_docs)]
    pub destination_order: DestinationOrder,
    #[allow(missing_docs)]
    pub presentation: Presentation,
    /// Names or `fnmatch` patterns; none is the partition with the empty name.
    pub partition: Vec<String>,
    /// What a writer sends (the first) or a reader accepts; none is [`Representation::XCDR1`].
    pub representation: Vec<Representation>,
}

impl Qos {
    /// What holds for a writer whose announcement says nothing: reliable.
    pub fn writer_default() -> Self {
        Self { reliability: Reliability::Reliable, ..Self::reader_default() }
    }

    /// What holds for a reader whose announcement says nothing: best effort.
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
            representation: Vec::new(),
        }
    }
}

/// A policy that keeps a writer and a reader apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
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
    todo!()
}
