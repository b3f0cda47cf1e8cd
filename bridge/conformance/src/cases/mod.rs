//! The cases.

mod endpoints;
mod figures;
mod large;
mod late;
mod peers;
mod qos;
mod requests;

use crate::engine::Domain;
use std::fmt;

/// What every engine must do.
#[derive(Clone, Copy)]
pub struct Case {
    /// A sentence.
    pub name: &'static str,
    /// What it belongs to.
    pub heading: Heading,
    pub(crate) run: fn(&Domain<'_>) -> Ran,
}

/// What a case belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// Endpoints, what goes between them, who sees them.
    Endpoints,
    /// Matching, and its events.
    Qos,
    /// What those get that come later.
    LateJoiners,
    /// Large samples.
    LargeSamples,
    /// Requests and replies.
    Requests,
    /// Other processes, that end in one way or another.
    Peers,
    /// What discovery announces and finds.
    Discovery,
    /// Times.
    Figures,
}

/// Why cases about times are not for the engine in memory.
const NO_TIMES: &str = "it keeps no times";

/// How far a case came, where it did not panic.
pub(crate) enum Ran {
    /// With a figure, where one was measured.
    Done(Option<String>),
    /// With what was found.
    Failed(String),
    /// Why not.
    NotApplicable(&'static str),
}

impl From<()> for Ran {
    fn from((): ()) -> Self {
        Self::Done(None)
    }
}

impl From<String> for Ran {
    fn from(figure: String) -> Self {
        Self::Done(Some(figure))
    }
}

impl fmt::Debug for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Case").field("name", &self.name).finish_non_exhaustive()
    }
}

impl fmt::Display for Heading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Endpoints => "endpoints",
            Self::Qos => "quality of service",
            Self::LateJoiners => "late joiners",
            Self::LargeSamples => "large samples",
            Self::Requests => "requests and replies",
            Self::Peers => "peers",
            Self::Discovery => "discovery",
            Self::Figures => "figures",
        })
    }
}

macro_rules! cases {
    ($($heading:ident: { $($module:ident::$name:ident;)* })*) => {
        /// All cases, in the order of the list.
        pub const CASES: &[Case] = &[$($(Case {
            name: stringify!($name),
            heading: Heading::$heading,
            run: |domain| $module::$name(domain).into(),
        },)*)*];
    };
}

cases! {
    Endpoints: {
        endpoints::a_sample_arrives_as_it_was_written;
        endpoints::a_best_effort_reader_hears_a_reliable_writer;
        endpoints::samples_of_a_writer_arrive_in_order_and_none_is_lost;
        endpoints::a_participant_hears_itself;
        endpoints::matched_counts_follow_what_comes_and_goes;
        endpoints::a_dropped_reader_hears_nothing_more;
        endpoints::endpoints_of_others_are_listed_until_they_go;
        endpoints::payloads_of_either_byte_order_arrive_as_they_were_written;
        endpoints::a_payload_without_an_encapsulation_header_is_refused;
    }
    Qos: {
        qos::a_reader_that_asks_for_more_than_is_offered_is_not_matched;
        qos::each_policy_keeps_apart_what_does_not_suit_and_is_named_on_both_sides;
        qos::a_peer_with_another_type_is_reported_on_both_sides_and_not_matched;
        qos::matches_are_reported_as_they_come_and_go;
        qos::missed_deadlines_are_reported_on_both_sides;
        qos::a_writer_with_manual_liveliness_lives_as_long_as_it_says_so;
    }
    LateJoiners: {
        late::a_late_reader_of_a_transient_local_writer_catches_up_in_order;
        late::a_late_reader_gets_no_more_than_the_history_depth;
        late::a_late_volatile_reader_gets_no_history;
        late::a_late_reader_gets_no_sample_past_its_lifespan;
    }
    LargeSamples: {
        large::a_sample_of_many_fragments_arrives_whole;
        large::samples_of_64_kilobytes_to_8_megabytes_arrive_whole;
    }
    Requests: {
        requests::a_request_is_answered_to_the_client_that_asked;
        requests::many_requests_in_flight_are_each_answered_in_whatever_order;
        requests::a_call_without_a_server_ends_at_once;
        requests::a_call_that_is_not_answered_ends_when_its_time_is_up;
        requests::a_reply_waits_until_the_client_that_asked_is_matched;
        requests::a_reply_to_a_client_that_never_comes_is_dropped;
        requests::requests_beyond_the_bound_are_refused_and_counted;
        requests::calls_beyond_the_bound_are_refused;
        requests::a_server_that_left_is_no_longer_there;
        requests::a_server_that_leaves_delivers_its_reply_first;
        requests::a_server_that_leaves_waits_for_a_client_that_is_found_late;
        requests::a_dropped_client_ends_its_calls;
        requests::large_requests_and_replies_arrive_whole;
    }
    Peers: {
        peers::a_peer_that_leaves_disappears_immediately;
        peers::a_killed_reader_does_not_stop_the_writer;
    }
    Discovery: {
        peers::the_hash_of_a_type_is_announced;
        peers::static_peers_are_announced_to;
    }
    Figures: {
        figures::time_until_a_new_participant_is_matched;
        figures::time_until_a_late_reader_has_a_latched_sample;
        figures::round_trip_of_100_bytes;
        figures::throughput;
    }
}
