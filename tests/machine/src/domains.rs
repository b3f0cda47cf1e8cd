//! ROS domains that no other test of this machine uses, in this checkout or in another.

use std::net::{Ipv4Addr, TcpListener, UdpSocket};
use std::ops::RangeInclusive;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// The domains that ROS 2 recommends for Linux: when a program lets the system choose a port, it never
/// chooses one of theirs. The default, 0, is for robots outside of tests, and Cyclone DDS accepts no rules of
/// security for 231 and 232.
const RANGES: [RangeInclusive<u16>; 2] = [1..=101, 215..=230];

/// Long enough for other tests to end.
const WATCHDOG: Duration = Duration::from_secs(300);

/// Takes a domain that no other test uses until this process ends.
pub fn free_domain() -> u16 {
    free_domains(1)
}

/// Takes `count` consecutive domains that no other test uses until this process ends, and returns the first.
pub fn free_domains(count: u16) -> u16 {
    static HELD: Mutex<Vec<Domains>> = Mutex::new(Vec::new());
    let domains = Domains::take(count);
    let first = domains.first;
    println!("this test has the ROS domains from {first} on: {count}");
    HELD.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(domains);
    first
}

/// Consecutive domains that no other test uses until this is dropped.
#[derive(Debug)]
pub struct Domains {
    first: u16,
    _locks: Vec<TcpListener>,
}

impl Domains {
    /// Takes `count` domains, and waits while no such number of them is free.
    pub fn take(count: u16) -> Self {
        let first_of = |range: RangeInclusive<u16>| *range.start()..(range.end() + 2).saturating_sub(count);
        let mut candidates: Vec<u16> = RANGES.into_iter().flat_map(first_of).collect();
        assert!(!candidates.is_empty(), "there are no {count} consecutive domains");
        // Processes that start at the same time begin at different ones.
        let begin = std::process::id() as usize * 37 % candidates.len();
        candidates.rotate_left(begin);
        let start = Instant::now();
        while start.elapsed() < WATCHDOG {
            for &first in &candidates {
                let locks: Option<Vec<_>> = (first..first + count).map(take).collect();
                if let Some(locks) = locks {
                    return Self { first, _locks: locks };
                }
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("no ROS domain became free within {WATCHDOG:?}: are processes of ended tests still running?");
    }

    /// The first of them.
    pub fn first(&self) -> u16 {
        self.first
    }
}

/// Takes a domain by a TCP port of its range, which no DDS uses: a bound port is released when its process
/// ends, in whatever way, and it is known to every user and in no other network namespace, as DDS itself.
fn take(domain: u16) -> Option<TcpListener> {
    let base = 7400 + 250 * domain;
    let lock = TcpListener::bind((Ipv4Addr::LOCALHOST, base)).ok()?;
    // Multicast of discovery and data, and the unicast ports of the first participants.
    let is_unused = |offset| UdpSocket::bind((Ipv4Addr::UNSPECIFIED, base + offset)).is_ok();
    (0..2).chain(10..20).all(is_unused).then_some(lock)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_domain_is_taken_once() {
        let singles: Vec<u16> = (0..5).map(|_| free_domain()).collect();
        let first = free_domains(3);
        let all: BTreeSet<u16> = singles.into_iter().chain(first..first + 3).collect();
        assert_eq!(all.len(), 8, "{all:?}");
        assert!(all.iter().all(|&domain| take(domain).is_none()));
    }

    #[test]
    fn a_domain_with_a_participant_is_not_free() {
        let Domains { first, _locks: locks } = Domains::take(1);
        drop(locks);
        let participant = UdpSocket::bind((Ipv4Addr::LOCALHOST, 7400 + 250 * first + 10));
        assert!(participant.is_err() || take(first).is_none());
    }
}
