//! Parses a datagram of any bytes. Parsing may fail but must not panic, and what is parsed can be written and
//! parses to the same values again.

use downbeat_rtps::qos::{Qos, incompatible};
use downbeat_rtps::wire::{
    Data, EndpointData, MessageBuilder, ParticipantData, ParticipantMessage, Payload, Submessage, parse,
};

/// One run; returns the number of parsed submessages.
pub fn run(bytes: &[u8]) -> usize {
    let Ok((header, submessages)) = parse(bytes) else { return 0 };
    let mut understood = 0;
    for submessage in submessages.map_while(Result::ok) {
        let mut again = Vec::new();
        let mut message = MessageBuilder::new(&mut again, usize::MAX, header);
        understood += 1;
        let is_written = match submessage {
            Submessage::Data(data) => {
                if let Payload::Data(payload) | Payload::Key(payload) = data.payload {
                    read_discovery(payload);
                }
                let _ = data.inline_qos.removed(data.payload);
                message.data(&data)
            }
            Submessage::DataFragment(fragment) => {
                assert!(
                    u64::from(fragment.offset()) + fragment.payload.len() as u64
                        <= fragment.sample_size.into()
                );
                message.data_fragment(&fragment)
            }
            Submessage::AckNack(ack_nack) => {
                assert!(ack_nack.missing.iter().all(|number| number >= ack_nack.missing.base()));
                message.ack_nack(&ack_nack)
            }
            Submessage::Heartbeat(heartbeat) => message.heartbeat(&heartbeat),
            Submessage::Gap(gap) => message.gap(&gap),
            Submessage::NackFragment(nack) => message.nack_fragment(&nack),
            Submessage::HeartbeatFragment(heartbeat) => message.heartbeat_fragment(&heartbeat),
            _ => continue,
        };
        // Only padding can make it too long for its length field.
        if is_written {
            let (_, mut submessages) = parse(&again).expect("a valid message");
            let read = submessages.next().expect("one submessage").expect("a valid submessage");
            assert_same(read, submessage);
        } else {
            assert!(bytes.len() > 65_000, "{submessage:?} cannot be written");
        }
    }
    understood
}

/// Compares payloads without their padding, whose length is part of the encapsulation options or unknown.
fn assert_same(read: Submessage<'_>, written: Submessage<'_>) {
    match (read, written) {
        (Submessage::Data(read), Submessage::Data(written)) => {
            let (bytes, expected) = (bytes_of(read.payload), bytes_of(written.payload));
            assert!(bytes.len() >= expected.len() && bytes.len() < expected.len() + 4);
            assert_eq!(bytes.get(4..expected.len()), expected.get(4..));
            assert_eq!(Data { payload: written.payload, ..read }, written);
        }
        (read, written) => assert_eq!(read, written),
    }
}

fn bytes_of<'a>(payload: Payload<'a>) -> &'a [u8] {
    match payload {
        Payload::None => &[],
        Payload::Data(bytes) | Payload::Key(bytes) => bytes,
    }
}

fn read_discovery(payload: &[u8]) {
    let mut again = Vec::new();
    if let Ok(participant) = ParticipantData::parse(payload) {
        participant.emit(&mut again);
        assert_eq!(ParticipantData::parse(&again), Ok(participant));
        again.clear();
    }
    if let Ok(endpoint) = EndpointData::parse(payload) {
        let _ = incompatible(&endpoint.qos, &Qos::reader_default());
        let _ = incompatible(&Qos::writer_default(), &endpoint.qos);
        endpoint.emit(&mut again);
        assert_eq!(EndpointData::parse(&again), Ok(endpoint));
        again.clear();
    }
    if let Ok(message) = ParticipantMessage::parse(payload) {
        message.emit(&mut again);
        assert_eq!(ParticipantMessage::parse(&again), Ok(message));
    }
}
