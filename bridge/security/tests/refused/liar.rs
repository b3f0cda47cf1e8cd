//! A guard that does not keep to the rules.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use downbeat_rtps::protocol::{Admission, Channel, Demand, Denial, Guard, Now, Room, TopicProtection};
use downbeat_rtps::wire::{EndpointData, Guid, GuidPrefix, ParticipantData};
use downbeat_security::tokens::{ByteOrder, GenericMessage};

type Change<T> = Option<Box<dyn FnMut(&mut T) + Send>>;

/// What it does wrong.
#[derive(Default)]
pub struct Lies {
    pub announcement: Change<ParticipantData>,
    /// Of the announcements of own endpoints.
    pub endpoint: Change<EndpointData>,
    /// Of what it says over the channels between guards.
    pub said: Change<GenericMessage>,
    /// The same as bytes.
    pub said_bytes: Change<Vec<u8>>,
    /// Of datagrams before they are protected.
    pub plain: Change<Vec<u8>>,
    /// Of protected datagrams.
    pub sealed: Change<Vec<u8>>,
    pub leaves_clear: bool,
    /// The prefix that it has, and the one that it shows.
    pub disguise: Option<[GuidPrefix; 2]>,
    /// All that it said.
    pub log: Vec<GenericMessage>,
}

pub struct Liar {
    pub honest: Box<dyn Guard>,
    pub lies: Arc<Mutex<Lies>>,
}

impl Guard for Liar {
    fn complete_participant(&mut self, own: &mut ParticipantData) {
        self.honest.complete_participant(own);
        if let Some(change) = &mut self.lies.lock().unwrap().announcement {
            change(own);
        }
    }

    fn complete_endpoint(&mut self, now: Now, own: &mut EndpointData) -> Result<(), Denial> {
        self.honest.complete_endpoint(now, own)?;
        if let Some(change) = &mut self.lies.lock().unwrap().endpoint {
            change(own);
        }
        Ok(())
    }

    fn admit_participant(&mut self, now: Now, remote: &ParticipantData) -> Admission {
        self.honest.admit_participant(now, remote)
    }

    fn is_authenticated(&self, remote: GuidPrefix) -> bool {
        self.honest.is_authenticated(remote)
    }

    fn admit_endpoint(&mut self, now: Now, local: &EndpointData, remote: &EndpointData) -> Admission {
        self.honest.admit_endpoint(now, local, remote)
    }

    fn protection_of(&self, topic: &str) -> TopicProtection {
        self.honest.protection_of(topic)
    }

    fn forget_participant(&mut self, remote: GuidPrefix) {
        self.honest.forget_participant(remote);
    }

    fn forget_endpoint(&mut self, endpoint: Guid) {
        self.honest.forget_endpoint(endpoint);
    }

    fn handle_message(&mut self, now: Now, channel: Channel, from: GuidPrefix, payload: &[u8]) {
        let mut payload = payload.to_vec();
        if let Some([own, shown]) = self.lies.lock().unwrap().disguise {
            replace(&mut payload, shown, own);
        }
        self.honest.handle_message(now, channel, from, &payload);
    }

    fn handle_timeout(&mut self, now: Now) {
        self.honest.handle_timeout(now);
    }

    fn next_timeout(&self) -> Option<Instant> {
        self.honest.next_timeout()
    }

    fn poll(&mut self) -> Option<Demand> {
        let demand = self.honest.poll()?;
        let Demand::Send { channel, to, message } = demand else { return Some(demand) };
        let mut lies = self.lies.lock().unwrap();
        let mut said = GenericMessage::parse(&message).unwrap();
        if let Some(change) = &mut lies.said {
            change(&mut said);
        }
        let mut bytes = Vec::new();
        said.emit(&mut bytes, ByteOrder::Little);
        lies.log.push(said);
        if let Some([own, shown]) = lies.disguise {
            replace(&mut bytes, own, shown);
        }
        if let Some(change) = &mut lies.said_bytes {
            change(&mut bytes);
        }
        Some(Demand::Send { channel, to, message: bytes.into() })
    }

    fn room(&self) -> Room {
        self.honest.room()
    }

    fn encode(&mut self, to: GuidPrefix, datagram: &mut Vec<u8>) -> bool {
        let mut lies = self.lies.lock().unwrap();
        if let Some(change) = &mut lies.plain {
            change(datagram);
        }
        if lies.leaves_clear {
            return true;
        }
        let is_sealed = self.honest.encode(to, datagram);
        if let Some(change) = &mut lies.sealed {
            change(datagram);
        }
        is_sealed
    }

    fn decode(&mut self, now: Now, from: GuidPrefix, datagram: &[u8], out: &mut Vec<u8>) -> bool {
        self.honest.decode(now, from, datagram, out)
    }
}

fn replace(bytes: &mut [u8], old: GuidPrefix, new: GuidPrefix) {
    for at in 0..bytes.len().saturating_sub(old.0.len() - 1) {
        if bytes[at..].starts_with(&old.0) {
            bytes[at..at + new.0.len()].copy_from_slice(&new.0);
        }
    }
}
