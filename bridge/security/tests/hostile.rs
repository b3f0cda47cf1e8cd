//! Random changes of what comes from files and peers: none makes a parser panic or allocate more than a small
//! multiple of its input, and none passes for proven.
#![allow(clippy::unwrap_used)]

mod mutation;

use std::time::{Duration, Instant, SystemTime};

use downbeat_rtps::wire::{EntityId, Guid};
use downbeat_security::authentication::{Context, Handshake, Identity, Output};
use downbeat_security::pki::{Authority, Certificate, Crl, PrivateKey};
use downbeat_security::tokens::{ByteOrder, GenericMessage, Token};
use fuzzing::{Random, most_in};
use mutation::mutate;

/// In 2027, when all certificates here are valid.
const TIME: Duration = Duration::from_secs(1_798_761_600);

fn file(path: &str) -> Vec<u8> {
    let path = format!("{}/tests/data/{path}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Runs a parser on a changed input, and checks its memory.
fn check<T>(input: &[u8], parse: impl FnOnce(&[u8]) -> T) -> T {
    let (most, result) = most_in(|| parse(input));
    assert!(most <= 40 * input.len() + 8192, "{most} bytes of memory for {} bytes", input.len());
    result
}

#[test]
fn changed_files_of_keystores_are_parsed_without_panic_and_in_bounded_memory() {
    let folder = "keystores/all_domains";
    let ca = file(&format!("{folder}/public/ca.cert.pem"));
    let authority = Authority::new(Certificate::from_pem(&ca).unwrap(), None).unwrap();
    let files = [
        ("CERTIFICATE", file(&format!("{folder}/enclaves/talker/cert.pem"))),
        ("CERTIFICATE", ca),
        ("PRIVATE KEY", file(&format!("{folder}/enclaves/talker/key.pem"))),
        ("X509 CRL", file("crl.pem")),
    ];
    let time = SystemTime::UNIX_EPOCH + TIME;
    let genuine = Certificate::from_pem(&files[0].1).unwrap();
    let mut trusted = 0;
    for round in fuzzing::rounds(4000) {
        let mut random = Random::new(round);
        let (label, pem) = random.choose(&files);
        // Half of the changes are inside of what PEM encodes, so that they get past it.
        let mut bytes = pem.clone();
        if random.one_in(2) {
            let (_, document) = der::Document::from_pem(std::str::from_utf8(pem).unwrap()).unwrap();
            let mut der = document.to_vec();
            mutate(&mut der, &mut random);
            bytes = der::pem::encode_string(label, der::pem::LineEnding::LF, &der).unwrap().into_bytes();
        } else {
            mutate(&mut bytes, &mut random);
        }
        if let Ok(certificate) = check(&bytes, Certificate::from_pem)
            && authority.check(&certificate, time).is_ok()
        {
            // Only text around the certificate has changed.
            assert_eq!(certificate, genuine, "round {round}");
            trusted += 1;
        }
        if let Ok(crl) = check(&bytes, Crl::from_pem)
            && let Ok(with_crl) = Authority::new(authority.certificate().clone(), Some(crl))
        {
            assert_eq!(with_crl.check(&genuine, time), Ok(()), "round {round}");
        }
        let _ = check(&bytes, PrivateKey::from_pem);
    }
    assert!(trusted < 1000, "{trusted} changed certificates are the genuine one");
}

const STEPS: [&str; 3] = ["request", "reply", "final"];

#[test]
fn changed_messages_are_parsed_without_panic_in_bounded_memory_and_emitted_as_read() {
    let messages = STEPS.map(|step| file(&format!("handshakes/fastdds/{step}.bin")));
    let mut accepted = 0;
    for round in fuzzing::rounds(20_000) {
        let mut random = Random::new(round);
        let mut bytes = random.choose(&messages).clone();
        mutate(&mut bytes, &mut random);
        if let Ok(message) = check(&bytes, GenericMessage::parse) {
            accepted += 1;
            let mut emitted = Vec::new();
            message.emit(&mut emitted, ByteOrder::Big);
            assert_eq!(GenericMessage::parse(&emitted), Ok(message), "round {round}");
        }
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let _ = check(&bytes, |bytes| Token::parse(bytes, order));
        }
    }
    assert!(accepted > 100, "only {accepted} changed messages are well-formed");
}

/// The listener of a recorded handshake, with the keys that it had.
struct Listener {
    identity: Identity,
    participant_data: Vec<u8>,
    numbers: Vec<Vec<u8>>,
    handshake: Handshake,
}

impl Listener {
    fn new(request: &GenericMessage, reply: &GenericMessage, key: &[u8]) -> Self {
        let folder = "keystores/captured/enclaves/listener";
        let certificate = |name| Certificate::from_pem(&file(&format!("{folder}/{name}.pem"))).unwrap();
        let recorded = |field| reply.tokens[0].binary(field).unwrap().to_vec();
        let remote = Guid::new(request.source.0.prefix, EntityId::PARTICIPANT);
        let identity = Identity {
            certificate: certificate("cert"),
            key: PrivateKey::from_pem(&file(&format!("{folder}/key.pem"))).unwrap(),
            authority: Authority::new(certificate("identity_ca.cert"), None).unwrap(),
            permissions_document: file(&format!("{folder}/permissions.p7s")),
        };
        Self {
            identity,
            participant_data: recorded("c.pdata"),
            numbers: vec![key.to_vec(), recorded("challenge2")],
            handshake: Handshake::new(request.destination_participant, remote, Instant::now()),
        }
    }

    /// Returns whether the talker has proven its identity.
    fn handle(&mut self, message: &GenericMessage) -> bool {
        let mut random = |bytes: &mut [u8]| match self.numbers.pop() {
            Some(number) => bytes.copy_from_slice(&number),
            None => bytes.fill(7),
        };
        let mut context = Context {
            identity: &self.identity,
            participant_data: &self.participant_data,
            random: &mut random,
            last_number: &mut 0,
            now: Instant::now(),
            time: SystemTime::UNIX_EPOCH + TIME,
        };
        let outputs = self.handshake.handle(message, &mut context);
        outputs.iter().any(|output| matches!(output, Output::Done { .. }))
    }
}

#[test]
fn a_changed_message_of_a_handshake_proves_nothing() {
    let [request, reply, last] =
        STEPS.map(|step| GenericMessage::parse(&file(&format!("handshakes/fastdds/{step}.bin"))).unwrap());
    let agreement = String::from_utf8(file("handshakes/fastdds/agreement.txt")).unwrap();
    let key = agreement.lines().find_map(|line| line.strip_prefix("listener private ")).unwrap();
    let mut padded = [0; 32];
    let key = key.as_bytes().rchunks(2).zip(padded.iter_mut().rev());
    key.for_each(|(pair, byte)| *byte = u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap());
    let mut unchanged = Listener::new(&request, &reply, &padded);
    assert!(!unchanged.handle(&request));
    assert!(unchanged.handle(&last), "the recorded messages complete a handshake");
    let mut finished = 0;
    for round in fuzzing::rounds(300) {
        let mut random = Random::new(round);
        let mut changed = [request.clone(), last.clone()];
        // One of the two messages, in one of its values.
        let index = random.below(2);
        let token = &mut changed[index].tokens[0];
        let at = random.below(token.binary.len());
        match random.below(5) {
            0 => drop(token.binary.remove(at)),
            1 => token.binary[at].0.push('x'),
            _ => mutate(&mut token.binary[at].1, &mut random),
        }
        let is_same = changed == [request.clone(), last.clone()];
        let mut listener = Listener::new(&request, &reply, &padded);
        let [request, last] = &changed;
        listener.handle(request);
        if listener.handle(last) {
            finished += 1;
            // The specification allows to leave out the hashes and repeated keys, and an unknown name is the
            // same; the value is signed.
            let name = &STEPS[2 * index];
            let optional = ["hash_c1", "hash_c2", "dh1", "dh2"];
            let is_left_out = |field: &&str| changed[index].tokens[0].binary(field).is_none();
            assert!(is_same || optional.iter().any(is_left_out), "round {round}: a changed {name} passed");
        }
    }
    assert!(finished < 100, "{finished} of 300 changed handshakes finished");
}
