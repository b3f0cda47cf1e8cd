//! Recorded conversations of Cyclone DDS and Fast DDS, opened from the handshake to the samples with the
//! secret on which the two agreed (`data/README.md`).
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use downbeat_rtps::wire::{self, EndpointData, EntityId, GuidPrefix, Header, Payload, Submessage};
use downbeat_security::cryptography::{
    KeyId, KeyMaterial, Opener, message_transform, payload_transform, split_submessage_group,
    submessage_transform,
};
use downbeat_security::tokens::{GenericMessage, class};
use sha2::{Digest, Sha256};

const HEADER: usize = 20;
const SEC_PREFIX: u8 = 0x31;

fn file(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data")).join(name)).unwrap()
}

/// A conversation while it is opened.
struct Conversation {
    datagrams: Vec<Vec<u8>>,
    exchange: Opener,
    keys: BTreeMap<(GuidPrefix, KeyId), Opener>,
    /// How many tokens arrived, by class. What was sent again counts once.
    tokens: BTreeMap<String, BTreeSet<KeyId>>,
    topics: BTreeSet<String>,
    texts: Vec<String>,
    /// How many protected parts were opened.
    opened: usize,
}

/// The layers that a part of a conversation had.
#[derive(Clone, Copy)]
struct Layers {
    message: bool,
    submessage: bool,
}

impl Conversation {
    fn read(name: &str) -> Self {
        let challenge = |step: &str, challenge: &str| {
            let message = GenericMessage::parse(&file(&format!("handshakes/{name}/{step}.bin"))).unwrap();
            message.tokens[0].binary(challenge).unwrap().to_vec()
        };
        let agreement = String::from_utf8(file(&format!("handshakes/{name}/agreement.txt"))).unwrap();
        let secret = agreement.lines().find_map(|line| line.strip_prefix("secret ")).unwrap();
        let bytes: Vec<u8> = (0..secret.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&secret[at..at + 2], 16).unwrap())
            .collect();
        let (first, second) = (challenge("request", "challenge1"), challenge("reply", "challenge2"));
        Self {
            datagrams: datagrams(&file(&format!("wire/{name}.pcap"))),
            exchange: Opener::new(KeyMaterial::for_key_exchange(&first, &second, &Sha256::digest(bytes))),
            keys: BTreeMap::new(),
            tokens: BTreeMap::new(),
            topics: BTreeSet::new(),
            texts: Vec::new(),
            opened: 0,
        }
    }

    /// Opens everything that the keys known so far open, and takes the keys in it.
    fn take_keys(&mut self) {
        for datagram in self.datagrams.clone() {
            let (header, mut rest) = datagram.split_at(HEADER);
            // The channel of the keys is not in protected messages.
            while let Some(group) = next_group(&mut rest) {
                if submessage_transform(group).unwrap().key == KeyId::KEY_EXCHANGE {
                    let mut plain = header.to_vec();
                    self.exchange.submessage(group, &mut plain).unwrap();
                    self.take_tokens(&plain);
                }
            }
        }
    }

    fn take_tokens(&mut self, message: &[u8]) {
        let (Header { prefix, .. }, submessages) = wire::parse(message).unwrap();
        for submessage in submessages {
            let Submessage::Data(data) = submessage.unwrap() else { continue };
            assert_eq!(data.writer, EntityId::VOLATILE_WRITER);
            let Payload::Data(payload) = data.payload else { panic!("a message without content") };
            let message = GenericMessage::parse(payload).unwrap();
            for token in &message.tokens {
                let material = KeyMaterial::parse(token.binary("dds.cryp.keymat").unwrap()).unwrap().unwrap();
                self.tokens.entry(message.class.clone()).or_default().insert(material.id());
                self.keys.entry((prefix, material.id())).or_insert_with(|| Opener::new(material));
            }
        }
    }

    fn open_everything(&mut self) {
        for datagram in self.datagrams.clone() {
            let prefix = GuidPrefix(datagram[8..HEADER].try_into().unwrap());
            let layers = Layers { message: false, submessage: false };
            match message_transform(&datagram).unwrap() {
                None => self.open(&datagram, prefix, layers),
                Some(transform) => {
                    let opener =
                        self.keys.get_mut(&(prefix, transform.key)).expect("a key of the participant");
                    let message = opener.message(&datagram).unwrap();
                    self.opened += 1;
                    self.open(&message, prefix, Layers { message: true, ..layers });
                }
            }
        }
    }

    fn open(&mut self, message: &[u8], prefix: GuidPrefix, layers: Layers) {
        let (header, submessages) = message.split_at(HEADER);
        let mut rest = submessages;
        while let Some(group) = next_group(&mut rest) {
            let key = submessage_transform(group).unwrap().key;
            let mut plain = header.to_vec();
            if key == KeyId::KEY_EXCHANGE {
                assert!(!layers.message, "the channel of the keys is outside of protected messages");
                self.exchange.submessage(group, &mut plain).unwrap();
            } else {
                let opener = self.keys.get_mut(&(prefix, key)).expect("a key of the endpoint");
                opener.submessage(group, &mut plain).unwrap();
            }
            self.opened += 1;
            self.open(&plain, prefix, Layers { submessage: true, ..layers });
        }
        for submessage in wire::parse(message).unwrap().1 {
            // What follows a protected message is a submessage of Fast DDS.
            let Ok(Submessage::Data(data)) = submessage else { continue };
            let Payload::Data(payload) = data.payload else { continue };
            if matches!(
                data.writer,
                EntityId::SEDP_PUBLICATIONS_SECURE_WRITER | EntityId::SEDP_SUBSCRIPTIONS_SECURE_WRITER
            ) {
                assert!(layers.message && layers.submessage);
                self.topics.insert(EndpointData::parse(payload).unwrap().topic);
            } else if !data.writer.is_builtin() {
                assert!(layers.message && layers.submessage);
                let key = payload_transform(payload).unwrap().key;
                let opener = self.keys.get_mut(&(prefix, key)).expect("a key of the writer");
                let plain = opener.payload(payload).unwrap();
                self.opened += 1;
                let length = u32::from_le_bytes(plain[4..8].try_into().unwrap()) as usize;
                self.texts.push(String::from_utf8(plain[8..8 + length - 1].to_vec()).unwrap());
            }
        }
    }
}

/// The next protected submessage; `rest` is what follows it.
fn next_group<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    loop {
        let bytes = *rest;
        if *bytes.first()? == SEC_PREFIX {
            let (group, following) = split_submessage_group(bytes).unwrap();
            *rest = following;
            return Some(group);
        }
        let length: [u8; 2] = bytes[2..4].try_into().unwrap();
        let length = if bytes[1] & 1 == 1 { u16::from_le_bytes(length) } else { u16::from_be_bytes(length) };
        // The last one may say 0 and reach to the end.
        *rest = bytes.get(4 + usize::from(length)..)?;
    }
}

/// The UDP payloads of a little-endian pcap file of Ethernet frames with IPv4 headers without options.
fn datagrams(file: &[u8]) -> Vec<Vec<u8>> {
    const FILE_HEADER: usize = 24;
    const RECORD_HEADER: usize = 16;
    const ETHERNET_IP_UDP: usize = 14 + 20 + 8;
    let (header, mut rest) = file.split_at(FILE_HEADER);
    assert_eq!(header[..4], [0xd4, 0xc3, 0xb2, 0xa1]);
    let mut datagrams = Vec::new();
    while let Some((record, following)) = rest.split_at_checked(RECORD_HEADER) {
        let length = u32::from_le_bytes(record[8..12].try_into().unwrap()) as usize;
        let (frame, following) = following.split_at(length);
        datagrams.push(frame[ETHERNET_IP_UDP..].to_vec());
        rest = following;
    }
    datagrams
}

#[test]
fn recorded_conversations_open_from_the_secret_to_the_samples() {
    for name in ["cyclone", "fastdds", "cyclone_to_fastdds"] {
        let mut conversation = Conversation::read(name);
        conversation.take_keys();
        let Conversation { tokens, .. } = &conversation;
        assert_eq!(
            tokens.keys().map(|class| &**class).collect::<Vec<_>>(),
            [class::READER_CRYPTO_TOKENS, class::WRITER_CRYPTO_TOKENS, class::PARTICIPANT_CRYPTO_TOKENS],
            "{name}"
        );
        conversation.open_everything();
        println!("{name}: {} parts opened, {} keys", conversation.opened, conversation.keys.len());
        let topics: Vec<_> = conversation.topics.iter().map(|topic| &**topic).collect();
        assert_eq!(topics, ["rt/big", "rt/chatter"], "{name}");
        let said = |start: &str| conversation.texts.iter().filter(|text| text.starts_with(start)).count();
        assert!(said("hello ") >= 3 && said(&"x".repeat(3000)) >= 3, "{name}: {:?}", conversation.texts);
        assert_eq!(said("hello ") + said("xxx"), conversation.texts.len(), "{name}");
    }
}
