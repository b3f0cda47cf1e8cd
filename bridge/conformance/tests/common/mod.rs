//! A test for each case.

use downbeat_conformance::{CASES, Engine, Outcome, run};

macro_rules! each_case {
    ($engine:expr) => {
        each_case! {
            @ $engine;
            a_sample_arrives_as_it_was_written
            a_best_effort_reader_hears_a_reliable_writer
            samples_of_a_writer_arrive_in_order_and_none_is_lost
            a_participant_hears_itself
            matched_counts_follow_what_comes_and_goes
            a_dropped_reader_hears_nothing_more
            endpoints_of_others_are_listed_until_they_go
            payloads_of_either_byte_order_arrive_as_they_were_written
            a_payload_without_an_encapsulation_header_is_refused
            a_reader_that_asks_for_more_than_is_offered_is_not_matched
            each_policy_keeps_apart_what_does_not_suit_and_is_named_on_both_sides
            a_peer_with_another_type_is_reported_on_both_sides_and_not_matched
            matches_are_reported_as_they_come_and_go
            missed_deadlines_are_reported_on_both_sides
            a_writer_with_manual_liveliness_lives_as_long_as_it_says_so
            a_late_reader_of_a_transient_local_writer_catches_up_in_order
            a_late_reader_gets_no_more_than_the_history_depth
            a_late_volatile_reader_gets_no_history
            a_late_reader_gets_no_sample_past_its_lifespan
            a_sample_of_many_fragments_arrives_whole
            samples_of_64_kilobytes_to_8_megabytes_arrive_whole
            a_request_is_answered_to_the_client_that_asked
            many_requests_in_flight_are_each_answered_in_whatever_order
            a_call_without_a_server_ends_at_once
            a_call_that_is_not_answered_ends_when_its_time_is_up
            a_reply_waits_until_the_client_that_asked_is_matched
            a_reply_to_a_client_that_never_comes_is_dropped
            requests_beyond_the_bound_are_refused_and_counted
            calls_beyond_the_bound_are_refused
            a_server_that_left_is_no_longer_there
            a_server_that_leaves_delivers_its_reply_first
            a_server_that_leaves_waits_for_a_client_that_is_found_late
            a_dropped_client_ends_its_calls
            large_requests_and_replies_arrive_whole
            a_peer_that_leaves_disappears_immediately
            a_killed_reader_does_not_stop_the_writer
            the_hash_of_a_type_is_announced
            static_peers_are_announced_to
            time_until_a_new_participant_is_matched
            time_until_a_late_reader_has_a_latched_sample
            round_trip_of_100_bytes
            throughput
        }
    };
    (@ $engine:expr; $($name:ident)*) => {
        $(#[test] fn $name() { common::holds(&$engine, stringify!($name)); })*

        #[test]
        fn no_case_is_left_out() {
            let names: Vec<_> = downbeat_conformance::CASES.iter().map(|case| case.name).collect();
            assert_eq!(names, [$(stringify!($name)),*]);
        }
    };
}

/// Runs the case of that name, and says what there is to say of it beside that it passed.
pub fn holds(engine: &Engine, name: &str) {
    let case =
        CASES.iter().find(|case| case.name == name).unwrap_or_else(|| panic!("there is no case {name}"));
    let result = run(engine, case);
    if !matches!(result.outcome, Outcome::Passed(None)) {
        eprintln!("{result}");
    }
    assert!(result.is_as_expected(), "{result}");
}
