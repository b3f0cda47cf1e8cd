//! Configuration of a participant and its endpoints.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use bytes::Bytes;

use super::Addresses;
use crate::{
    qos::Qos,
    wire::{GuidPrefix, VendorId},
};

/// Configuration of a participant.
#[derive(Debug, Clone)]
pub struct Config {
    /// Unique to this participant. Begins with [`VendorId::OURS`], by which participants of this engine
    /// recognise each other.
    pub prefix: GuidPrefix,
    pub domain_id: u32,
    /// Shown by tools of other vendors; not used by ROS 2.
    pub name: String,
    /// In ROS 2 `enclave=<enclave>;`.
    pub user_data: Bytes,
    /// Time without a message after which peers consider this participant lost.
    pub lease: Duration,
    /// Time between two announcements, except for the first few.
    pub announcement_period: Duration,
    pub addresses: Addresses,
    /// Unpredictable for others. The sequence numbers follow from it by which participants prove that they
    /// receive at their addresses.
    pub secret: u64,
    /// Size of a fragment to other hosts in bytes. On this host fragments have at least 32 kB.
    pub fragment_size: u16,
    /// Size of the socket's receive buffer in bytes. Announced to participants of this engine, which adapt
    /// their sending rate to it.
    pub receive_buffer: Option<u32>,
    pub limits: Limits,
}

impl Config {
    /// A configuration with the times of Fast DDS and fragments that fit into an Ethernet frame.
    pub fn new(unique: [u8; 10], domain_id: u32, addresses: Addresses) -> Self {
        let mut prefix = [0; 12];
        prefix[..2].copy_from_slice(&VendorId::OURS.0);
        prefix[2..].copy_from_slice(&unique);
        Self {
            prefix: GuidPrefix(prefix),
            domain_id,
            name: String::new(),
            user_data: Bytes::new(),
            lease: Duration::from_secs(20),
            announcement_period: Duration::from_secs(3),
            addresses,
            secret: RandomState::new().hash_one(unique),
            fragment_size: 1264,
            receive_buffer: None,
            limits: Limits::default(),
        }
    }
}

/// Configuration of a writer or reader.
#[derive(Debug, Clone)]
pub struct EndpointConfig {
    /// As in DDS: `rt/chatter`.
    pub topic: String,
    /// As in DDS: `std_msgs::msg::dds_::String_`.
    pub type_name: String,
    pub qos: Qos,
    /// In ROS 2 `typehash=RIHS01_…;`.
    pub user_data: Bytes,
    /// The most samples of a writer that wait to be sent (keep last) or acknowledged (keep all) before writes
    /// are refused.
    pub send_window: usize,
    /// The most bytes of such samples.
    pub send_window_bytes: u64,
}

impl EndpointConfig {
    /// A configuration without user data and with a window of 1024 samples or 64 MiB.
    pub fn new(topic: impl Into<String>, type_name: impl Into<String>, qos: Qos) -> Self {
        Self {
            topic: topic.into(),
            type_name: type_name.into(),
            qos,
            user_data: Bytes::new(),
            send_window: 1024,
            send_window_bytes: 64 << 20,
        }
    }
}

/// Limits on the memory that other participants can make this one use. The lengths of names, lists and user
/// data are limited by [`wire`](crate::wire).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// The most known participants. Beyond that, participants that never answered are replaced.
    pub participants: usize,
    pub endpoints_per_participant: usize,
    /// The most endpoints of all other participants together.
    pub endpoints: usize,
    /// The largest sample in bytes.
    pub max_sample_size: u32,
    /// The most bytes of samples that one reader stores because they are incomplete or follow a missing
    /// sample.
    pub max_open_bytes: usize,
}

impl Default for Limits {
    /// Suffices for the largest known ROS 2 graphs (some hundred processes, ten thousand endpoints), with at
    /// most 20 MB.
    fn default() -> Self {
        Self {
            participants: 512,
            endpoints_per_participant: 4096,
            endpoints: 16_384,
            max_sample_size: 256 << 20,
            max_open_bytes: 512 << 20,
        }
    }
}
