//! Leaving a domain ends every thread and closes every socket that joining it began. Alone in its program,
//! since it counts those of the process.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Dds, Domain, cdr, next, subscribe, wait_until};
use downbeat_bridge::middleware::Endpoint;
use downbeat_msgs::qos::QosProfile;
use test_machine::free_domain;

#[test]
fn a_participant_that_left_leaves_no_thread_and_no_open_file() {
    let count = |what: &str| std::fs::read_dir(format!("/proc/self/{what}")).unwrap().count();
    // Each holds a socket until the end of the process.
    let domains: [Dds; 3] = std::array::from_fn(|_| Dds(free_domain()));
    let (threads, files) = (count("task"), count("fd"));
    for domain in domains {
        let (alice, bob) = (domain.join(), domain.join());
        let endpoint = Endpoint::new("rt/chatter", "std_msgs::msg::dds_::UInt32_", QosProfile::DEFAULT);
        let writer = alice.create_writer(&endpoint).unwrap();
        let (reader, samples) = subscribe(&*bob, &endpoint);
        wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
        writer.write(cdr([1; 4])).unwrap();
        next(&samples);
        drop((writer, reader));
        drop((alice, bob));
        // The system lists a thread that was joined for a moment longer.
        wait_until("all threads have ended", || count("task") == threads);
        assert_eq!(count("fd"), files, "open files");
    }
}
