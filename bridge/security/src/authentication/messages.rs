//! The tokens of the three messages of a handshake (section 9.3.2.5).

use super::agreement::Method;
use super::credentials::Credentials;
use super::fields::Fields;
use super::identity::{Identity, RemoteIdentity};
use super::refusal::Refusal;
use crate::cdr::{ByteOrder, Writer};
use crate::tokens::{Token, write_binary};

pub(super) const BEGIN: &str = "DDS:Auth:PKI-DH:1.0+AuthReq";
pub(super) const REQUEST: &str = "DDS:Auth:PKI-DH:1.0+Req";
pub(super) const REPLY: &str = "DDS:Auth:PKI-DH:1.0+Reply";
pub(super) const FINAL: &str = "DDS:Auth:PKI-DH:1.0+Final";

pub(super) type Hash = [u8; 32];
pub(super) type Challenge = [u8; 32];

/// What both sides sign: the hashes of their credentials, their public keys and random numbers. Those of the
/// initiator end in 1, those of the replier in 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Exchange {
    pub(super) hash1: Hash,
    pub(super) hash2: Hash,
    pub(super) dh1: Vec<u8>,
    pub(super) dh2: Vec<u8>,
    pub(super) challenge1: Challenge,
    pub(super) challenge2: Challenge,
}

impl Exchange {
    /// What the replier signs.
    fn reply_content(&self) -> Vec<u8> {
        signed_form([
            ("hash_c2", &self.hash2),
            ("challenge2", &self.challenge2),
            ("dh2", &self.dh2),
            ("challenge1", &self.challenge1),
            ("dh1", &self.dh1),
            ("hash_c1", &self.hash1),
        ])
    }

    /// What the initiator signs.
    fn final_content(&self) -> Vec<u8> {
        signed_form([
            ("hash_c1", &self.hash1),
            ("challenge1", &self.challenge1),
            ("dh1", &self.dh1),
            ("challenge2", &self.challenge2),
            ("dh2", &self.dh2),
            ("hash_c2", &self.hash2),
        ])
    }
}

fn signed_form(properties: [(&str, &[u8]); 6]) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_binary(&mut Writer::new(&mut bytes, ByteOrder::Big), &properties);
    bytes
}

fn token(class_id: &str, properties: &[(&str, &[u8])]) -> Token {
    let binary = properties.iter().map(|(name, value)| ((*name).to_owned(), value.to_vec())).collect();
    Token { binary, ..Token::new(class_id) }
}

/// Asks for the first message. The answer to that will have the same random number.
pub(super) fn emit_begin(challenge2: &Challenge) -> Token {
    token(BEGIN, &[("future_challenge", challenge2)])
}

/// The first message. Nothing in it is proven.
pub(super) struct Request<'a> {
    pub(super) credentials: Credentials<&'a [u8]>,
    pub(super) method: Method,
    pub(super) hash1: Hash,
    pub(super) dh1: Vec<u8>,
    pub(super) challenge1: Challenge,
}

impl<'a> Request<'a> {
    pub(super) fn emit(&self) -> Token {
        let own = [("hash_c1", &self.hash1[..]), ("dh1", &self.dh1), ("challenge1", &self.challenge1)];
        token(REQUEST, &[&self.credentials.0[..], &own].concat())
    }

    pub(super) fn parse(token: &'a Token) -> Result<Self, Refusal> {
        let fields = Fields::new(token)?;
        let credentials = Credentials::read(fields)?;
        let (dh1, challenge1) = (fields.get("dh1")?.to_vec(), fields.array("challenge1")?);
        let method = credentials.method()?;
        let hash1 = credentials.hash();
        fields.check_optional("hash_c1", &hash1)?;
        Ok(Self { credentials, method, hash1, dh1, challenge1 })
    }
}

/// The second message.
pub(super) struct Reply<'a> {
    pub(super) credentials: Credentials<&'a [u8]>,
    pub(super) exchange: Exchange,
    signature: Vec<u8>,
}

impl<'a> Reply<'a> {
    pub(super) fn sign(credentials: Credentials<&'a [u8]>, exchange: Exchange, identity: &Identity) -> Self {
        let signature = identity.key.sign(&exchange.reply_content());
        Self { credentials, exchange, signature }
    }

    pub(super) fn emit(&self) -> Token {
        // Fast DDS refuses replies without the hashes and `dh1`, which the specification makes optional.
        let exchange = &self.exchange;
        let own = [
            ("hash_c2", &exchange.hash2[..]),
            ("dh2", &exchange.dh2),
            ("hash_c1", &exchange.hash1),
            ("dh1", &exchange.dh1),
            ("challenge1", &exchange.challenge1),
            ("challenge2", &exchange.challenge2),
            ("signature", &self.signature),
        ];
        token(REPLY, &[&self.credentials.0[..], &own].concat())
    }

    /// Reads the reply to `request`.
    pub(super) fn parse(token: &'a Token, request: &Request<'_>) -> Result<Self, Refusal> {
        let Request { method, hash1, challenge1, .. } = *request;
        let dh1 = request.dh1.clone();
        let fields = Fields::new(token)?;
        fields.check("challenge1", &challenge1)?;
        fields.check_optional("hash_c1", &hash1)?;
        fields.check_optional("dh1", &dh1)?;
        let credentials = Credentials::read(fields)?;
        if credentials.method()? != method {
            return Err(Refusal::Mismatch { field: "c.kagree_algo" });
        }
        let (dh2, challenge2) = (fields.get("dh2")?.to_vec(), fields.array("challenge2")?);
        let signature = fields.get("signature")?.to_vec();
        let hash2 = credentials.hash();
        fields.check_optional("hash_c2", &hash2)?;
        let exchange = Exchange { hash1, hash2, dh1, dh2, challenge1, challenge2 };
        Ok(Self { credentials, exchange, signature })
    }

    pub(super) fn verify(&self, replier: &RemoteIdentity) -> Result<(), Refusal> {
        verify(replier, &self.exchange.reply_content(), &self.signature)
    }
}

/// The third message of the handshake with this exchange.
pub(super) fn emit_final(exchange: &Exchange, identity: &Identity) -> Token {
    let signature = identity.key.sign(&exchange.final_content());
    let properties = [
        ("hash_c1", &exchange.hash1[..]),
        ("hash_c2", &exchange.hash2),
        ("dh1", &exchange.dh1),
        ("dh2", &exchange.dh2),
        ("challenge1", &exchange.challenge1),
        ("challenge2", &exchange.challenge2),
        ("signature", &signature),
    ];
    token(FINAL, &properties)
}

/// Returns the random numbers of a final message, which tell its handshake.
pub(super) fn challenges(token: &Token) -> Result<(Challenge, Challenge), Refusal> {
    let fields = Fields::new(token)?;
    Ok((fields.array("challenge1")?, fields.array("challenge2")?))
}

/// Checks the final message of the handshake with this exchange.
pub(super) fn verify_final(
    token: &Token,
    exchange: &Exchange,
    initiator: &RemoteIdentity,
) -> Result<(), Refusal> {
    let fields = Fields::new(token)?;
    fields.check("challenge1", &exchange.challenge1)?;
    fields.check("challenge2", &exchange.challenge2)?;
    fields.check_optional("hash_c1", &exchange.hash1)?;
    fields.check_optional("hash_c2", &exchange.hash2)?;
    fields.check_optional("dh1", &exchange.dh1)?;
    fields.check_optional("dh2", &exchange.dh2)?;
    verify(initiator, &exchange.final_content(), fields.get("signature")?)
}

fn verify(signer: &RemoteIdentity, content: &[u8], signature: &[u8]) -> Result<(), Refusal> {
    match signer.certificate.verify(content, signature) {
        true => Ok(()),
        false => Err(Refusal::Signature { subject: signer.certificate.subject().into() }),
    }
}
