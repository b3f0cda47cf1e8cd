//! A robot, its peer, and a stranger on the same network.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

use downbeat_rtps::protocol::Limits;
use downbeat_rtps::qos::Qos;
use downbeat_rtps::wire::{
    AckNack, BuiltinEndpoints, Data, DataFragment, EndpointData, EntityId, Guid, GuidPrefix, Header,
    InlineQos, MessageBuilder, ParticipantData, Payload, SequenceNumber, SequenceNumberSet, VendorId,
};
use fuzzing::most_in;

use crate::common::{Network, latched, reliable};

/// The most memory that a robot may use at any time.
const MOST_MEMORY: usize = 64 << 20;
/// A test case takes milliseconds; one that iterates over a range of 2⁴⁰ numbers does not end.
const LONGEST: Duration = Duration::from_secs(60);

pub const ROBOT: usize = 0;
pub const PEER: usize = 1;

/// The address of the stranger.
pub const STRANGER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 66), 7410);

/// The stranger's reader and writer, which match the robot's.
pub const READER: EntityId = EntityId::user_reader(0x66);
pub const WRITER: EntityId = EntityId::user_writer(0x66);

pub struct Robot {
    pub network: Network,
    /// A reliable reader of the robot on the topic that peer and stranger write.
    pub reader: EntityId,
    /// A reliable writer of the robot on the topic that peer and stranger read.
    pub writer: EntityId,
    pub peer_reader: EntityId,
    pub peer_writer: EntityId,
    talks: u32,
}

impl Robot {
    pub fn new() -> Self {
        let mut network = Network::new(2);
        let mut robot = Self {
            reader: network.reader(ROBOT, "rt/commands", reliable()),
            writer: network.writer(ROBOT, "rt/state", reliable()),
            peer_reader: network.reader(PEER, "rt/state", reliable()),
            peer_writer: network.writer(PEER, "rt/commands", reliable()),
            network,
            talks: 0,
        };
        let is_matched = |network: &Network| {
            let matched = |node: usize, entity| network.nodes[node].participant.matched(entity).len();
            [
                (ROBOT, robot.reader),
                (ROBOT, robot.writer),
                (PEER, robot.peer_reader),
                (PEER, robot.peer_writer),
            ]
            .into_iter()
            .all(|(node, entity)| matched(node, entity) == 1)
        };
        assert!(robot.network.run_until(Duration::from_secs(1), is_matched));
        robot.talk();
        robot
    }

    /// Checks that peer and robot receive each other's samples.
    pub fn talk(&mut self) {
        self.talks += 1;
        let text = format!("{} times", self.talks);
        self.network.write(PEER, self.peer_writer, &text);
        self.network.write(ROBOT, self.writer, &text);
        let (reader, peer_reader) = (self.reader, self.peer_reader);
        let have_heard = |network: &Network| {
            network.nodes[ROBOT].texts(reader).contains(&text)
                && network.nodes[PEER].texts(peer_reader).contains(&text)
        };
        assert!(
            self.network.run_until(Duration::from_secs(10), have_heard),
            "the robot and its peer do not communicate"
        );
    }

    /// Passes a datagram of the stranger to the robot.
    pub fn hear(&mut self, datagram: &[u8]) {
        self.network.inject(ROBOT, STRANGER, datagram);
    }

    /// Adds a writer, which keeps the last few samples for late readers, and a reader to the robot.
    pub fn add_endpoints(&mut self, topic: &str) -> EntityId {
        self.network.reader(ROBOT, topic, latched(3));
        self.network.writer(ROBOT, topic, latched(3))
    }

    pub fn write(&mut self, text: &str) {
        self.network.write(ROBOT, self.writer, text);
    }

    pub fn run_for(&mut self, duration: Duration) {
        self.network.run_for(duration);
    }

    pub fn prefix(&self) -> GuidPrefix {
        self.network.nodes[ROBOT].participant.prefix()
    }

    /// The largest sample that the robot accepts, in bytes.
    pub fn largest_sample(&self) -> u32 {
        Limits::default().max_sample_size
    }

    pub fn participant(&self) -> &downbeat_rtps::protocol::Participant {
        &self.network.nodes[ROBOT].participant
    }

    /// Removes the events of robot and peer and returns their number.
    pub fn forget_events(&mut self) -> usize {
        self.network.nodes.iter_mut().map(|node| std::mem::take(&mut node.events).len()).sum()
    }

    /// Bytes that the robot has sent.
    pub fn sent(&self) -> u64 {
        self.network.nodes[ROBOT].sent.1
    }

    /// Announces the stranger as a participant with a reader and a writer on the robot's topics.
    pub fn meet(&mut self, stranger: GuidPrefix) {
        self.hear(&announcement(stranger));
        // It answers a heartbeat that was sent to the announced address, which validates it.
        let robot = self.prefix();
        let (first, _) = self.network.heartbeats[&(stranger, EntityId::SEDP_PUBLICATIONS_WRITER)];
        self.hear(&message(stranger, |message| {
            let (reader, writer) = (EntityId::SEDP_PUBLICATIONS_READER, EntityId::SEDP_PUBLICATIONS_WRITER);
            let missing = SequenceNumberSet::new(first);
            message.info_destination(robot);
            message.ack_nack(&AckNack { reader, writer, missing, count: 1, is_final: false })
        }));
        self.hear(&endpoint(stranger, WRITER, SequenceNumber::FIRST, "rt/commands"));
        self.hear(&endpoint(stranger, READER, SequenceNumber::FIRST, "rt/state"));
        let participant = self.participant();
        assert!(participant.matched(self.reader).contains(&Guid::new(stranger, WRITER)));
        assert!(participant.matched(self.writer).contains(&Guid::new(stranger, READER)));
    }
}

/// Runs `attack` against a robot. The robot must stay within its limits of memory and time, and work with its
/// peer afterwards.
pub fn survives(attack: impl FnOnce(&mut Robot)) {
    let start = Instant::now();
    survives_for_long(attack);
    assert!(start.elapsed() < LONGEST, "it takes {:?}", start.elapsed());
}

/// Like `survives`, without a limit of time.
pub fn survives_for_long(attack: impl FnOnce(&mut Robot)) {
    let (most, ()) = most_in(|| {
        let mut robot = Robot::new();
        attack(&mut robot);
        robot.talk();
    });
    println!("the robot held at most {most} bytes");
    assert!(most < MOST_MEMORY, "the robot holds {most} bytes");
}

pub fn stranger(number: u32) -> GuidPrefix {
    let mut prefix = [0x66; 12];
    prefix[..2].copy_from_slice(&VendorId::FAST_DDS.0);
    prefix[8..].copy_from_slice(&number.to_be_bytes());
    GuidPrefix(prefix)
}

pub fn message(sender: GuidPrefix, write: impl FnOnce(&mut MessageBuilder<'_>) -> bool) -> Vec<u8> {
    let mut datagram = Vec::new();
    let header = Header { version: [2, 3], vendor: VendorId::FAST_DDS, prefix: sender };
    assert!(write(&mut MessageBuilder::new(&mut datagram, 65_507, header)));
    datagram
}

pub fn sample(sender: GuidPrefix, writer: EntityId, number: SequenceNumber, payload: &[u8]) -> Vec<u8> {
    let (reader, inline_qos) = (EntityId::UNKNOWN, InlineQos::default());
    let payload = Payload::Data(payload);
    message(sender, |message| message.data(&Data { reader, writer, number, inline_qos, payload }))
}

/// What the stranger announces of itself.
pub fn participant_data(prefix: GuidPrefix) -> ParticipantData {
    ParticipantData {
        prefix,
        version: [2, 3],
        vendor: VendorId::FAST_DDS,
        metatraffic_unicast: vec![STRANGER],
        metatraffic_multicast: Vec::new(),
        default_unicast: vec![STRANGER],
        default_multicast: Vec::new(),
        lease: Some(Duration::from_secs(20)),
        builtin_endpoints: BuiltinEndpoints::OURS,
        user_data: b"enclave=/;".to_vec(),
        name: "/".to_owned(),
        domain_id: None,
        domain_tag: String::new(),
        expects_inline_qos: false,
        security: None,
        receive_buffer: None,
    }
}

pub fn announcement(sender: GuidPrefix) -> Vec<u8> {
    let mut payload = Vec::new();
    participant_data(sender).emit(&mut payload);
    sample(sender, EntityId::SPDP_WRITER, SequenceNumber::FIRST, &payload)
}

/// What a participant announces of a reliable endpoint for texts.
pub fn endpoint_data(guid: Guid, topic: &str) -> EndpointData {
    EndpointData {
        guid,
        topic: topic.to_owned(),
        type_name: "std_msgs::msg::dds_::String_".to_owned(),
        qos: Qos::writer_default(),
        unicast: Vec::new(),
        multicast: Vec::new(),
        user_data: Vec::new(),
        expects_inline_qos: false,
        security: None,
    }
}

/// The builtin writer that announces such an endpoint.
pub fn announcer(entity: EntityId) -> EntityId {
    match entity.is_writer() {
        true => EntityId::SEDP_PUBLICATIONS_WRITER,
        false => EntityId::SEDP_SUBSCRIPTIONS_WRITER,
    }
}

/// An announcement of an endpoint, as the `number`th of the stranger.
pub fn endpoint(sender: GuidPrefix, entity: EntityId, number: SequenceNumber, topic: &str) -> Vec<u8> {
    let mut payload = Vec::new();
    endpoint_data(Guid::new(sender, entity), topic).emit(&mut payload);
    sample(sender, announcer(entity), number, &payload)
}

/// The fragment `first` of a sample with the declared size `sample_size`.
pub fn fragment(sender: GuidPrefix, number: i64, first: u32, sample_size: u32) -> Vec<u8> {
    const SIZE: u16 = 1000;
    let fragment = DataFragment {
        reader: EntityId::UNKNOWN,
        writer: WRITER,
        number: SequenceNumber(number),
        first,
        count: 1,
        fragment_size: SIZE,
        sample_size,
        inline_qos: InlineQos::default(),
        payload: &[0; SIZE as usize],
        is_key: false,
    };
    message(sender, |message| message.data_fragment(&fragment))
}
