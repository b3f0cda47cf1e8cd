//! A robot and others, with enclaves of keystores that are made here.

use std::cell::RefCell;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use downbeat_rtps::protocol::{Config, Guard};
use downbeat_rtps::wire::{EntityId, GuidPrefix};
use downbeat_security::access::{Governance, Permissions, smime};
use downbeat_security::enclave::Enclave;
use downbeat_security::guard::{Credentials, SecurityGuard, Status};
use downbeat_security::keystore::Keystore;
use downbeat_security::pki::{Certificate, PrivateKey};
use fuzzing::Random;

use crate::common::{Network, best_effort, reliable};
use crate::keystore::valid;
use crate::liar::{Liar, Lies};

pub const SECOND: Duration = Duration::from_secs(1);
pub const YEAR: Duration = Duration::from_secs(365 * 24 * 3600);
/// That of a new keystore, for domain 0.
pub const GOVERNANCE: &str = include_str!("../../src/keystore/governance.xml");

/// A new keystore.
pub struct Ca {
    folder: tempfile::TempDir,
    keystore: Keystore,
    seed: u64,
}

impl Ca {
    pub fn new(seed: u64, when: SystemTime) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut random = random(seed);
        let keystore = Keystore::create(folder.path(), 0, when, &mut random).unwrap();
        Self { folder, keystore, seed }
    }

    /// The folder of an enclave that was issued at `when`.
    pub fn folder(&self, name: &str, when: SystemTime) -> PathBuf {
        let seed = self.seed + 1000 * name.len() as u64 + u64::from(name.as_bytes()[1]);
        self.keystore.create_enclave(name, 0, when, &mut random(seed)).unwrap()
    }

    /// An enclave that was issued at a time, and is read when it is valid.
    pub fn enclave_at(&self, name: &str, issued: SystemTime, read: SystemTime) -> Enclave {
        Enclave::load(&self.folder(name, issued), read).unwrap()
    }

    pub fn enclave(&self, name: &str) -> Enclave {
        self.enclave_at(name, valid(), valid())
    }

    /// Signs a document with the key of the authority.
    pub fn sign(&self, text: &str) -> Vec<u8> {
        let read = |name: &str| std::fs::read(self.folder.path().join(name)).unwrap();
        let certificate = Certificate::from_pem(&read("public/ca.cert.pem")).unwrap();
        let key = PrivateKey::from_pem(&read("private/ca.key.pem")).unwrap();
        smime::sign(text.as_bytes(), &certificate, &key, valid())
    }
}

fn random(seed: u64) -> impl FnMut(&mut [u8]) + Send {
    let mut random = Random::new(seed);
    move |bytes| bytes.iter_mut().for_each(|byte| *byte = random.below(256) as u8)
}

/// The enclave with a changed governance.
pub fn governed(mut enclave: Enclave, changes: &[(&str, &str)]) -> Enclave {
    let mut text = GOVERNANCE.to_owned();
    for (element, value) in changes {
        let start = text.find(&format!("<{element}>")).unwrap() + element.len() + 2;
        let end = start + text[start..].find('<').unwrap();
        text.replace_range(start..end, value);
    }
    enclave.governance = Governance::parse(&text).unwrap();
    enclave
}

/// The text of the permissions of an enclave.
pub fn permissions_text(enclave: &Enclave) -> String {
    let text = smime::verify(&enclave.permissions_document, &enclave.permissions_ca).unwrap();
    String::from_utf8(text).unwrap()
}

/// The enclave with other permissions, which `ca` signs.
pub fn permitted(mut enclave: Enclave, ca: &Ca, text: &str) -> Enclave {
    enclave.permissions = Permissions::parse(text).unwrap();
    enclave.permissions_document = ca.sign(text);
    enclave
}

/// Credentials, the state to show, lies, and a seed.
type Next = (Arc<Credentials>, Status, Option<Arc<Mutex<Lies>>>, u64);

thread_local! {
    static NEXT: RefCell<Option<Next>> = const { RefCell::new(None) };
}

pub fn guard(config: &Config) -> Option<(GuidPrefix, Box<dyn Guard>)> {
    let (credentials, status, lies, seed) = NEXT.take()?;
    let guard = SecurityGuard::new(credentials, config.prefix, Box::new(random(seed)), status);
    let prefix = guard.prefix();
    Some(match lies {
        Some(lies) => {
            let shown = lies.lock().unwrap().disguise.as_mut().map(|disguise| {
                // The subject is in the first six bytes.
                *disguise = [prefix; 2];
                disguise[1].0[5] ^= 1;
                disguise[1]
            });
            (shown.unwrap_or(prefix), Box::new(Liar { honest: Box::new(guard), lies }))
        }
        None => (prefix, Box::new(guard)),
    })
}

/// A network whose first participant is the robot, with a writer and a reader.
pub struct World {
    pub network: Network,
    pub statuses: Vec<Status>,
    pub writer: EntityId,
    pub reader: EntityId,
    seed: u64,
}

pub const ROBOT: usize = 0;

impl World {
    pub fn new(robot: &Enclave) -> Self {
        Self::with_seed(robot, 1)
    }

    /// The seed decides the random numbers.
    pub fn with_seed(robot: &Enclave, seed: u64) -> Self {
        let network = Network::new(0);
        let (writer, reader) = (EntityId::UNKNOWN, EntityId::UNKNOWN);
        let mut world = Self { network, statuses: Vec::new(), writer, reader, seed };
        world.join(robot);
        world.writer = world.network.writer(ROBOT, "rt/state", reliable());
        world.reader = world.network.reader(ROBOT, "rt/commands", best_effort());
        world
    }

    pub fn join(&mut self, enclave: &Enclave) -> usize {
        self.join_with(enclave, None)
    }

    pub fn join_liar(&mut self, enclave: &Enclave, lies: Lies) -> (usize, Arc<Mutex<Lies>>) {
        let lies = Arc::new(Mutex::new(lies));
        (self.join_with(enclave, Some(lies.clone())), lies)
    }

    fn join_with(&mut self, enclave: &Enclave, lies: Option<Arc<Mutex<Lies>>>) -> usize {
        // It may be wrong now, but not when it began.
        let begin = enclave.certificate.validity().0 + 2 * 24 * 3600 * SECOND;
        let credentials = Arc::new(Credentials::new(enclave, 0, begin).unwrap());
        let status = Status::default();
        self.seed += 1;
        NEXT.set(Some((credentials, status.clone(), lies, self.seed)));
        self.statuses.push(status);
        self.network.join(|_| {})
    }

    /// Gives another participant a writer and a reader on the robot's topics.
    pub fn equip(&mut self, node: usize) -> (EntityId, EntityId) {
        let writer = self.network.writer(node, "rt/commands", best_effort());
        (writer, self.network.reader(node, "rt/state", reliable()))
    }

    /// All that the robot told about security.
    pub fn said(&self) -> String {
        self.statuses[ROBOT].refusals().1.join("\n")
    }

    #[track_caller]
    pub fn assert_said(&self, text: &str) {
        assert!(self.said().contains(text), "expected: {text}\nfound: {}", self.said());
    }

    /// The participant is not authenticated, and nothing of it is matched.
    #[track_caller]
    pub fn assert_alone(&self) {
        let robot = &self.network.nodes[ROBOT].participant;
        assert_eq!(self.statuses[ROBOT].authenticated(), 0);
        assert_eq!((robot.matched(self.writer).len(), robot.matched(self.reader).len()), (0, 0));
        assert_eq!(robot.remote_endpoints().count(), 0);
    }

    #[track_caller]
    pub fn assert_matched(&self, others: usize) {
        let robot = &self.network.nodes[ROBOT].participant;
        let matched = (robot.matched(self.writer).len(), robot.matched(self.reader).len());
        assert_eq!(matched, (others, others), "{}", self.said());
    }

    /// What the robot received.
    pub fn texts(&self) -> Vec<String> {
        self.network.nodes[ROBOT].texts(self.reader)
    }
}

/// The robot meets another participant, refuses it, and says why.
#[track_caller]
pub fn refuses(robot: &Enclave, other: &Enclave, why: &str) {
    lies_are_refused(robot, other, Lies::default(), why);
}

#[track_caller]
pub fn lies_are_refused(robot: &Enclave, other: &Enclave, lies: Lies, why: &str) {
    let mut world = World::new(robot);
    let (node, _) = world.join_liar(other, lies);
    let (writer, _) = world.equip(node);
    for _ in 0..5 {
        world.network.write(node, writer, "let me in");
        world.network.run_for(SECOND);
    }
    world.assert_said(why);
    world.assert_alone();
    assert!(world.texts().is_empty());
}
