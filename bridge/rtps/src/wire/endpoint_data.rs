//! What a participant announces about its writers and readers (sections 8.5.4.4 and 9.6.3.2).

use std::net::SocketAddrV4;
use std::time::Duration;

use super::bytes::{ByteOrder, Cursor, Encoder};
use super::parameters::{Parameter, ParameterList, pid, write_parameter, write_payload};
use super::time::{read_duration, write_duration};
use super::values::{
    read_bool, read_locator, read_octets, read_string, write_locators, write_octets, write_string,
};
use super::{Guid, Malformed, SecurityAttributes};
use crate::qos::{
    AccessScope, DestinationOrder, Durability, History, Liveliness, Ownership, Presentation, Qos,
    Reliability, Representation,
};

/// The content of a SEDP sample.
///
/// Only locators of UDP over IPv4 with a valid address are kept, at most 16 of each kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointData {
    /// Its entity is a writer or a reader.
    pub guid: Guid,
    /// As in DDS: `rt/chatter`.
    pub topic: String,
    /// As in DDS: `std_msgs::msg::dds_::String_`.
    pub type_name: String,
    pub qos: Qos,
    /// Empty if the participant's default locators apply.
    pub unicast: Vec<SocketAddrV4>,
    pub multicast: Vec<SocketAddrV4>,
    /// In ROS 2 `typehash=RIHS01_…;`. At most 1024 bytes are kept.
    pub user_data: Vec<u8>,
    pub expects_inline_qos: bool,
    /// How it is protected; `None` if it announces nothing about it.
    pub security: Option<SecurityAttributes>,
}

/// Longest name of a topic or a type, in bytes. Fast DDS cannot hold more than 255, and rmw refuses longer
/// topics.
const MAX_NAME: usize = 512;

/// Largest number of partitions, and of representations, of one endpoint. ROS 2 uses no partition and one
/// representation.
const MAX_ITEMS: usize = 16;

/// Announced with reliability, as ROS 2 does. It has no influence on matching.
const MAX_BLOCKING_TIME: Option<Duration> = Some(Duration::from_millis(100));

impl EndpointData {
    /// Reads the payload of a SEDP sample. The guid determines whether it describes a writer or a reader.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        let list = ParameterList::from_payload(payload)?;
        let guid = list.iter().find(|parameter| parameter.id == pid::ENDPOINT_GUID);
        let guid = guid.ok_or(Malformed::Lacks(pid::ENDPOINT_GUID))?.get(|value| value.array().ok())?;
        let guid = Guid::from_bytes(guid);
        let qos = match (guid.entity.is_writer(), guid.entity.is_reader()) {
            (true, _) => Qos::writer_default(),
            (_, true) => Qos::reader_default(),
            _ => return Err(Malformed::Parameter(pid::ENDPOINT_GUID)),
        };
        let mut data = Self {
            guid,
            topic: String::new(),
            type_name: String::new(),
            qos,
            unicast: Vec::new(),
            multicast: Vec::new(),
            user_data: Vec::new(),
            expects_inline_qos: false,
            security: None,
        };
        for parameter in list.iter() {
            match parameter.id {
                pid::ENDPOINT_GUID => {}
                pid::TOPIC_NAME => data.topic = parameter.get(|value| read_string(value, MAX_NAME))?,
                pid::TYPE_NAME => data.type_name = parameter.get(|value| read_string(value, MAX_NAME))?,
                pid::UNICAST_LOCATOR => parameter.get(|value| read_locator(value, &mut data.unicast))?,
                pid::MULTICAST_LOCATOR => parameter.get(|value| read_locator(value, &mut data.multicast))?,
                pid::USER_DATA => data.user_data = parameter.get(read_octets)?,
                pid::EXPECTS_INLINE_QOS => data.expects_inline_qos = parameter.get(read_bool)?,
                pid::ENDPOINT_SECURITY_INFO => {
                    data.security = Some(parameter.get(SecurityAttributes::read)?);
                }
                _ => read_policy(parameter, &mut data.qos)?,
            }
        }
        match (data.topic.is_empty(), data.type_name.is_empty()) {
            (true, _) => Err(Malformed::Lacks(pid::TOPIC_NAME)),
            (_, true) => Err(Malformed::Lacks(pid::TYPE_NAME)),
            _ => Ok(data),
        }
    }

    /// Appends the payload of a SEDP sample. Every policy is explicit, so that the defaults of peers do not
    /// matter.
    ///
    /// # Panics
    /// Panics if a name or the user data is longer than 64 kB.
    pub fn emit(&self, out: &mut Vec<u8>) {
        self.emit_in(ByteOrder::Little, out);
    }

    fn emit_in(&self, order: ByteOrder, out: &mut Vec<u8>) {
        let guid = self.guid.to_bytes();
        let participant = Guid::new(self.guid.prefix, super::EntityId::PARTICIPANT).to_bytes();
        write_payload(out, order, |out| {
            write_parameter(out, pid::ENDPOINT_GUID, |out| out.bytes(&guid));
            write_parameter(out, pid::PARTICIPANT_GUID, |out| out.bytes(&participant));
            write_parameter(out, pid::KEY_HASH, |out| out.bytes(&guid));
            write_parameter(out, pid::TOPIC_NAME, |out| write_string(&self.topic, out));
            write_parameter(out, pid::TYPE_NAME, |out| write_string(&self.type_name, out));
            write_locators(out, pid::UNICAST_LOCATOR, &self.unicast);
            write_locators(out, pid::MULTICAST_LOCATOR, &self.multicast);
            if self.expects_inline_qos {
                write_parameter(out, pid::EXPECTS_INLINE_QOS, |out| out.bytes(&[1]));
            }
            write_policies(out, &self.qos);
            if !self.user_data.is_empty() {
                write_parameter(out, pid::USER_DATA, |out| write_octets(&self.user_data, out));
            }
            if let Some(security) = self.security {
                write_parameter(out, pid::ENDPOINT_SECURITY_INFO, |out| security.write(out));
            }
        });
    }
}

fn read_policy(parameter: Parameter<'_>, qos: &mut Qos) -> Result<(), Malformed> {
    match parameter.id {
        pid::RELIABILITY => qos.reliability = parameter.get(read_reliability)?,
        pid::DURABILITY => {
            use Durability::{Persistent, Transient, TransientLocal, Volatile};
            qos.durability =
                parameter.get(|value| one_of(value, &[Volatile, TransientLocal, Transient, Persistent]))?;
        }
        pid::HISTORY => qos.history = parameter.get(read_history)?,
        pid::DEADLINE => qos.deadline = parameter.get(read_duration)?,
        pid::LATENCY_BUDGET => qos.latency_budget = parameter.get(read_duration)?,
        pid::LIFESPAN => qos.lifespan = parameter.get(read_duration)?,
        pid::LIVELINESS => (qos.liveliness, qos.lease) = parameter.get(read_liveliness)?,
        pid::OWNERSHIP => {
            qos.ownership =
                parameter.get(|value| one_of(value, &[Ownership::Shared, Ownership::Exclusive]))?;
        }
        pid::DESTINATION_ORDER => {
            use DestinationOrder::{ByReception, BySource};
            qos.destination_order = parameter.get(|value| one_of(value, &[ByReception, BySource]))?;
        }
        pid::PRESENTATION => qos.presentation = parameter.get(read_presentation)?,
        pid::PARTITION => qos.partition = parameter.get(read_partition)?,
        pid::DATA_REPRESENTATION => {
            qos.representation = parameter.get(read_representation)?;
        }
        _ => parameter.skip()?,
    }
    Ok(())
}

fn write_policies(out: &mut Encoder<'_>, qos: &Qos) {
    write_parameter(out, pid::RELIABILITY, |out| {
        out.u32(qos.reliability as u32);
        write_duration(MAX_BLOCKING_TIME, out);
    });
    write_parameter(out, pid::DURABILITY, |out| out.u32(qos.durability as u32));
    write_parameter(out, pid::HISTORY, |out| {
        let (kind, depth) = match qos.history {
            History::KeepLast(depth) => (0, i32::try_from(depth).unwrap_or(i32::MAX)),
            History::KeepAll => (1, 0),
        };
        out.u32(kind);
        out.i32(depth);
    });
    write_parameter(out, pid::DEADLINE, |out| write_duration(qos.deadline, out));
    write_parameter(out, pid::LATENCY_BUDGET, |out| write_duration(qos.latency_budget, out));
    write_parameter(out, pid::LIFESPAN, |out| write_duration(qos.lifespan, out));
    write_parameter(out, pid::LIVELINESS, |out| {
        out.u32(qos.liveliness as u32);
        write_duration(qos.lease, out);
    });
    write_parameter(out, pid::OWNERSHIP, |out| out.u32(qos.ownership as u32));
    write_parameter(out, pid::DESTINATION_ORDER, |out| out.u32(qos.destination_order as u32));
    write_parameter(out, pid::PRESENTATION, |out| {
        let Presentation { access_scope, coherent, ordered } = qos.presentation;
        out.u32(access_scope as u32);
        out.bytes(&[coherent.into(), ordered.into()]);
    });
    if !qos.partition.is_empty() {
        write_parameter(out, pid::PARTITION, |out| {
            let start = out.len();
            out.u32(qos.partition.len() as u32);
            for name in &qos.partition {
                out.align(start);
                write_string(name, out);
            }
        });
    }
    write_parameter(out, pid::DATA_REPRESENTATION, |out| {
        out.u32(qos.representation.len() as u32);
        qos.representation.iter().for_each(|Representation(id)| out.u16(id.cast_unsigned()));
    });
}

/// Reads an enumeration with consecutive values from 0.
fn one_of<T: Copy>(value: &mut Cursor<'_>, kinds: &[T]) -> Option<T> {
    kinds.get(value.u32().ok()? as usize).copied()
}

fn read_reliability(value: &mut Cursor<'_>) -> Option<Reliability> {
    match value.u32().ok()? {
        1 => Some(Reliability::BestEffort),
        2 => Some(Reliability::Reliable),
        _ => None,
    }
}

fn read_history(value: &mut Cursor<'_>) -> Option<History> {
    match (value.u32().ok()?, value.i32().ok()?) {
        (0, depth) => Some(History::KeepLast(depth.max(1).cast_unsigned())),
        (1, _) => Some(History::KeepAll),
        _ => None,
    }
}

fn read_liveliness(value: &mut Cursor<'_>) -> Option<(Liveliness, Option<Duration>)> {
    use Liveliness::{Automatic, ManualByParticipant, ManualByTopic};
    let kind = one_of(value, &[Automatic, ManualByParticipant, ManualByTopic])?;
    Some((kind, read_duration(value)?))
}

fn read_presentation(value: &mut Cursor<'_>) -> Option<Presentation> {
    let access_scope = one_of(value, &[AccessScope::Instance, AccessScope::Topic, AccessScope::Group])?;
    Some(Presentation { access_scope, coherent: read_bool(value)?, ordered: read_bool(value)? })
}

fn read_partition(value: &mut Cursor<'_>) -> Option<Vec<String>> {
    let count = read_count(value)?;
    (0..count)
        .map(|_| {
            value.align().ok()?;
            read_string(value, MAX_NAME)
        })
        .collect()
}

fn read_representation(value: &mut Cursor<'_>) -> Option<Vec<Representation>> {
    let count = read_count(value)?;
    (0..count).map(|_| Some(Representation(value.u16().ok()?.cast_signed()))).collect()
}

fn read_count(value: &mut Cursor<'_>) -> Option<usize> {
    let count = value.u32().ok()? as usize;
    (count <= MAX_ITEMS).then_some(count)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::wire::{EntityId, GuidPrefix};
    use std::net::Ipv4Addr;

    fn data(entity: EntityId) -> EndpointData {
        EndpointData {
            guid: Guid::new(GuidPrefix([1, 0x44, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]), entity),
            topic: "rt/chatter".to_owned(),
            type_name: "std_msgs::msg::dds_::String_".to_owned(),
            qos: Qos {
                reliability: Reliability::BestEffort,
                durability: Durability::TransientLocal,
                history: History::KeepLast(7),
                deadline: Some(Duration::from_millis(1500)),
                lifespan: Some(Duration::from_nanos(1)),
                liveliness: Liveliness::ManualByTopic,
                lease: Some(Duration::from_secs(3)),
                latency_budget: None,
                ownership: Ownership::Exclusive,
                destination_order: DestinationOrder::BySource,
                presentation: Presentation {
                    access_scope: AccessScope::Group,
                    coherent: true,
                    ordered: false,
                },
                partition: vec!["a".to_owned(), "robot/*".to_owned(), String::new()],
                representation: vec![Representation::XCDR2, Representation::XCDR1, Representation(-1)],
            },
            unicast: vec![SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7411)],
            multicast: vec![SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 2), 7401)],
            user_data: b"typehash=RIHS01_00;".to_vec(),
            expects_inline_qos: true,
            security: None,
        }
    }

    /// Parses a reader with only the required parameters and those that `write` appends.
    fn parse_with(write: impl FnOnce(&mut Encoder<'_>)) -> Result<EndpointData, Malformed> {
        let data = data(EntityId::user_reader(1));
        let mut payload = Vec::new();
        write_payload(&mut payload, ByteOrder::Big, |out| {
            write_parameter(out, pid::ENDPOINT_GUID, |out| out.bytes(&data.guid.to_bytes()));
            write_parameter(out, pid::TOPIC_NAME, |out| write_string(&data.topic, out));
            write_parameter(out, pid::TYPE_NAME, |out| write_string(&data.type_name, out));
            write(out);
        });
        EndpointData::parse(&payload)
    }

    #[test]
    fn all_data_round_trips_in_both_byte_orders() {
        for entity in [EntityId::user_writer(1), EntityId::user_reader(0xab_cdef)] {
            for order in [ByteOrder::Big, ByteOrder::Little] {
                let mut payload = Vec::new();
                data(entity).emit_in(order, &mut payload);
                assert_eq!(EndpointData::parse(&payload), Ok(data(entity)));
            }
        }
    }

    #[test]
    fn every_default_round_trips() {
        for qos in [Qos::writer_default(), Qos { history: History::KeepAll, ..Qos::reader_default() }] {
            let data = EndpointData { qos, ..data(EntityId::user_writer(1)) };
            let mut payload = Vec::new();
            data.emit(&mut payload);
            assert_eq!(EndpointData::parse(&payload), Ok(data));
        }
    }

    #[test]
    fn a_silent_reader_is_best_effort_and_a_silent_writer_reliable() {
        assert_eq!(parse_with(|_| {}).unwrap().qos, Qos::reader_default());
        let writer = Guid::new(GuidPrefix([1; 12]), EntityId::user_writer(9));
        let data =
            parse_with(|out| write_parameter(out, pid::ENDPOINT_GUID, |out| out.bytes(&writer.to_bytes())));
        assert_eq!(data.unwrap().qos, Qos::reader_default(), "the first guid counts");
        let mut payload = Vec::new();
        write_payload(&mut payload, ByteOrder::Big, |out| {
            write_parameter(out, pid::TYPE_NAME, |out| write_string("T", out));
            write_parameter(out, pid::TOPIC_NAME, |out| write_string("t", out));
            write_parameter(out, pid::ENDPOINT_GUID, |out| out.bytes(&writer.to_bytes()));
        });
        assert_eq!(EndpointData::parse(&payload).unwrap().qos, Qos::writer_default());
    }

    #[test]
    fn data_without_guid_topic_or_type_is_malformed() {
        for left_out in [pid::ENDPOINT_GUID, pid::TOPIC_NAME, pid::TYPE_NAME] {
            let mut payload = Vec::new();
            write_payload(&mut payload, ByteOrder::Big, |out| {
                let guid = data(EntityId::user_writer(1)).guid.to_bytes();
                let texts = [pid::TOPIC_NAME, pid::TYPE_NAME].into_iter().filter(|id| *id != left_out);
                if left_out != pid::ENDPOINT_GUID {
                    write_parameter(out, pid::ENDPOINT_GUID, |out| out.bytes(&guid));
                }
                texts.for_each(|id| write_parameter(out, id, |out| write_string("name", out)));
            });
            assert_eq!(EndpointData::parse(&payload), Err(Malformed::Lacks(left_out)));
        }
    }

    #[test]
    fn an_entity_that_neither_writes_nor_reads_is_malformed() {
        let mut payload = Vec::new();
        data(EntityId::PARTICIPANT).emit(&mut payload);
        assert_eq!(EndpointData::parse(&payload), Err(Malformed::Parameter(pid::ENDPOINT_GUID)));
    }

    #[test]
    fn a_policy_with_an_undefined_value_is_malformed() {
        let kinds = [
            pid::RELIABILITY,
            pid::DURABILITY,
            pid::HISTORY,
            pid::LIVELINESS,
            pid::OWNERSHIP,
            pid::DESTINATION_ORDER,
            pid::PRESENTATION,
        ];
        let durations = [pid::DEADLINE, pid::LATENCY_BUDGET, pid::LIFESPAN];
        let lists = [pid::PARTITION, pid::DATA_REPRESENTATION];
        for id in kinds.into_iter().chain(durations).chain(lists) {
            for value in [&[][..], &[0xff; 12]] {
                let data = parse_with(|out| write_parameter(out, id, |out| out.bytes(value)));
                assert_eq!(data, Err(Malformed::Parameter(id)), "{value:?}");
            }
        }
    }

    #[test]
    fn names_of_512_bytes_are_accepted_and_longer_ones_are_not() {
        let with_topic = |length: usize| {
            let topic = "x".repeat(length);
            parse_with(|out| write_parameter(out, pid::TOPIC_NAME, |out| write_string(&topic, out)))
        };
        assert_eq!(with_topic(512).unwrap().topic.len(), 512);
        assert_eq!(with_topic(513), Err(Malformed::Parameter(pid::TOPIC_NAME)));
        assert_eq!(with_topic(10_000), Err(Malformed::Parameter(pid::TOPIC_NAME)));
    }

    #[test]
    fn a_list_of_too_many_partitions_is_malformed() {
        let with = |count: u32| {
            parse_with(|out| {
                write_parameter(out, pid::PARTITION, |out| {
                    out.u32(count);
                    (0..count).for_each(|_| write_string("abc", out));
                });
            })
        };
        assert_eq!(with(16).unwrap().qos.partition.len(), 16);
        assert_eq!(with(17), Err(Malformed::Parameter(pid::PARTITION)));
    }

    #[test]
    fn an_unknown_parameter_is_skipped_unless_it_must_be_understood() {
        let with = |id| parse_with(|out| write_parameter(out, id, |out| out.u32(0)));
        assert!(with(0x0075).is_ok());
        assert!(with(0x8007).is_ok());
        assert_eq!(with(0x4abc), Err(Malformed::MustUnderstand(0x4abc)));
    }

    #[test]
    fn a_history_without_depth_keeps_one() {
        let depth = |depth: i32| {
            parse_with(|out| {
                write_parameter(out, pid::HISTORY, |out| {
                    out.u32(0);
                    out.i32(depth);
                });
            })
        };
        assert_eq!(depth(0).unwrap().qos.history, History::KeepLast(1));
        assert_eq!(depth(-5).unwrap().qos.history, History::KeepLast(1));
    }
}
