//! What a participant and its endpoints are made with.

use std::time::Duration;

use bytes::Bytes;

use super::Addresses;
use crate::{
    qos::Qos,
    wire::{GuidPrefix, VendorId},
};

/// What a participant is made with.
#[derive(Debug, Clone)]
pub struct Config {
    /// Unique to this participant. Begins with [`VendorId::OURS`], by which peers of our kind know each other.
    pub prefix: GuidPrefix,
    pub domain_id: u32,
    /// Shown by tools of other vendors; means nothing to ROS 2.
    pub name: String,
    /// In ROS 2 `enclave=<enclave>;`.
    pub user_data: Bytes,
    /// After this time without a message from us, peers take us for gone.
    pub lease: Duration,
    /// Time between two announcements, but for the first few.
    pub announcement_period: Duration,
    pub addresses: Addresses,
    /// Bytes of a sample in one fragment to other hosts. On this host fragments are at least 32 kB.
    pub fragment_size: u16,
    /// Size of the socket's receive buffer in bytes; announced to participants of this engine, which pace by it.
    pub receive_buffer: Option<u32>,
    pub limits: Limits,
}

impl Config {
    /// Times as Fast DDS has them, and fragments that fit in an Ethernet frame.
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
            fragment_size: 1264,
            receive_buffer: None,
            limits: Limits::default(),
        }
    }
}

/// What a writer or a reader is made with.
#[derive(Debug, Clone)]
pub struct EndpointConfig {
    /// As in DDS: `rt/chatter`.
    pub topic: String,
    /// As in DDS: `std_msgs::msg::dds_::String_`.
    pub type_name: String,
    pub qos: Qos,
    /// In ROS 2 `typehash=RIHS01_…;`.
    pub user_data: Bytes,
    /// Samples of a writer that may wait to be sent (keep last) or acknowledged (keep all) before writing is refused.
    pub send_window: usize,
}

impl EndpointConfig {
    /// Without user data and with a window of 1024 samples.
    pub fn new(topic: impl Into<String>, type_name: impl Into<String>, qos: Qos) -> Self {
        Self {
            topic: topic.into(),
            type_name: type_name.into(),
            qos,
            user_data: Bytes::new(),
            send_window: 1024,
        }
    }
}

/// Bounds of what others can make a participant keep. The lengths of names, lists and user data are bounded by [`wire`](crate::wire).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Participants known at once. When more come, those that never answered us give way.
    pub participants: usize,
    pub endpoints_per_participant: usize,
    /// Endpoints of all other participants together.
    pub endpoints: usize,
    /// Bytes of one sample.
    pub max_sample_size: u32,
    /// Bytes of samples that one reader holds because something of them or before them is missing.
    pub max_open_bytes: usize,
}

impl Default for Limits {
    /// Room for the largest ROS 2 graphs that are known (some hundred processes, ten thousand endpoints), at 20 MB in the
    /// worst case.
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
