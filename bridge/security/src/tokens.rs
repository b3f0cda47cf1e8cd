//! Tokens and the messages that carry them, as CDR (DDS Security 1.1, sections 7.2.3 and 7.4.3).
//!
//! Tokens stand in the announcements of participants, in the messages of handshakes and in those that hand
//! over keys.

use std::fmt;

use downbeat_rtps::wire::Guid;

pub use crate::cdr::{ByteOrder, Malformed};
use crate::cdr::{Reader, Writer};

/// Of a message with its encapsulation, which a single datagram must hold.
const MAX_LEN: usize = 65_536;
const MAX_TOKENS: u32 = 64;
const MAX_PROPERTIES: u32 = 64;

/// A set of named values (`DataHolder` of the specification). It holds only what is propagated.
///
/// `Debug` shows no binary values, which may be keys.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Token {
    /// What the values mean, for example `DDS:Auth:PKI-DH:1.0`.
    pub class_id: String,
    /// Names and values.
    pub properties: Vec<(String, String)>,
    /// Names and values.
    pub binary: Vec<(String, Vec<u8>)>,
}

impl Token {
    /// A token without values.
    pub fn new(class_id: &str) -> Self {
        Self { class_id: class_id.into(), ..Self::default() }
    }

    /// The first property of this name.
    pub fn property(&self, name: &str) -> Option<&str> {
        self.properties.iter().find(|(known, _)| known == name).map(|(_, value)| &**value)
    }

    /// The first binary property of this name.
    pub fn binary(&self, name: &str) -> Option<&[u8]> {
        self.binary.iter().find(|(known, _)| known == name).map(|(_, value)| &**value)
    }

    /// Appends the token, without encapsulation, padded to a multiple of four bytes. The bytes before it must
    /// be a multiple of four.
    pub fn emit(&self, out: &mut Vec<u8>, order: ByteOrder) {
        self.write(&mut Writer::new(out, order));
    }

    /// Reads a token without encapsulation, which at most padding follows.
    ///
    /// # Errors
    /// Returns an error that names the first invalid value.
    pub fn parse(bytes: &[u8], order: ByteOrder) -> Result<Self, Malformed> {
        check_length(bytes)?;
        let mut reader = Reader::new(bytes, order);
        let token = Self::read(&mut reader)?;
        reader.finish()?;
        Ok(token)
    }

    fn write(&self, out: &mut Writer<'_>) {
        out.string(&self.class_id);
        out.count(self.properties.len());
        for (name, value) in &self.properties {
            out.string(name);
            out.string(value);
        }
        write_binary(out, &self.binary);
        // Fast DDS expects the padding after the last value, too.
        out.align(4);
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut token = Self::new(reader.string("class id of a token")?);
        for _ in 0..reader.count("properties", MAX_PROPERTIES)? {
            let name = reader.string("name of a property")?.to_owned();
            token.properties.push((name, reader.string("value of a property")?.to_owned()));
        }
        for _ in 0..reader.count("binary properties", MAX_PROPERTIES)? {
            let name = reader.string("name of a binary property")?.to_owned();
            token.binary.push((name, reader.octets("value of a binary property")?.to_vec()));
        }
        Ok(token)
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lengths = self.binary.iter().map(|(name, value)| (name, value.len()));
        f.debug_struct("Token")
            .field("class_id", &self.class_id)
            .field("properties", &self.properties)
            .field("lengths", &lengths.collect::<Vec<_>>())
            .finish()
    }
}

/// Appends a sequence of binary properties, without padding after the last. In big-endian order, hashes and
/// signatures are over this form.
pub(crate) fn write_binary<Name: AsRef<str>, Value: AsRef<[u8]>>(
    out: &mut Writer<'_>,
    properties: &[(Name, Value)],
) {
    out.count(properties.len());
    for (name, value) in properties {
        out.string(name.as_ref());
        out.octets(value.as_ref());
    }
}

/// A message between the security parts of two participants (`ParticipantGenericMessage`), over the stateless
/// or the volatile secure channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GenericMessage {
    /// The writer of this message, and a number that no other message of its has.
    pub source: (Guid, i64),
    /// The message that this one answers; unknown and 0 if none.
    pub related: (Guid, i64),
    /// The participant for which the message is; unknown for all.
    pub destination_participant: Guid,
    /// The endpoint that the tokens are for; unknown if for the participant.
    pub destination_endpoint: Guid,
    /// The endpoint that the tokens are of; unknown if of the participant.
    pub source_endpoint: Guid,
    /// What the message is about, one of [`class`].
    pub class: String,
    /// The content.
    pub tokens: Vec<Token>,
}

/// Classes of messages.
pub mod class {
    /// A participant asks another to begin a handshake.
    pub const AUTHENTICATION_REQUEST: &str = "dds.sec.auth_request";
    /// A step of a handshake.
    pub const AUTHENTICATION: &str = "dds.sec.auth";
    /// Keys of a participant.
    pub const PARTICIPANT_CRYPTO_TOKENS: &str = "dds.sec.participant_crypto_tokens";
    /// Keys of a writer.
    pub const WRITER_CRYPTO_TOKENS: &str = "dds.sec.datawriter_crypto_tokens";
    /// Keys of a reader.
    pub const READER_CRYPTO_TOKENS: &str = "dds.sec.datareader_crypto_tokens";
}

impl GenericMessage {
    /// Appends the message with its encapsulation.
    pub fn emit(&self, out: &mut Vec<u8>, order: ByteOrder) {
        let kind = match order {
            ByteOrder::Big => 0,
            ByteOrder::Little => 1,
        };
        out.extend_from_slice(&[0, kind, 0, 0]);
        let mut out = Writer::new(out, order);
        for (writer, number) in [self.source, self.related] {
            out.bytes(&writer.to_bytes());
            out.i64(number);
        }
        for guid in [self.destination_participant, self.destination_endpoint, self.source_endpoint] {
            out.bytes(&guid.to_bytes());
        }
        out.string(&self.class);
        out.count(self.tokens.len());
        self.tokens.iter().for_each(|token| token.write(&mut out));
    }

    /// Reads a message with its encapsulation.
    ///
    /// # Errors
    /// Returns an error that names the first invalid value.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        check_length(payload)?;
        let (order, content) = match payload {
            [0, 0, _, _, content @ ..] => (ByteOrder::Big, content),
            [0, 1, _, _, content @ ..] => (ByteOrder::Little, content),
            _ => return Err(Malformed::Encapsulation),
        };
        let mut reader = Reader::new(content, order);
        let source = (guid(&mut reader, "source")?, reader.i64("number")?);
        let related = (guid(&mut reader, "related source")?, reader.i64("related number")?);
        let mut message = Self {
            source,
            related,
            destination_participant: guid(&mut reader, "destination participant")?,
            destination_endpoint: guid(&mut reader, "destination endpoint")?,
            source_endpoint: guid(&mut reader, "source endpoint")?,
            class: reader.string("class of a message")?.to_owned(),
            tokens: Vec::new(),
        };
        for _ in 0..reader.count("tokens", MAX_TOKENS)? {
            message.tokens.push(Token::read(&mut reader)?);
        }
        reader.finish()?;
        Ok(message)
    }
}

fn guid(reader: &mut Reader<'_>, field: &'static str) -> Result<Guid, Malformed> {
    Ok(Guid::from_bytes(reader.array(field)?))
}

fn check_length(bytes: &[u8]) -> Result<(), Malformed> {
    match bytes.len() {
        0..=MAX_LEN => Ok(()),
        length => Err(Malformed::TooLong { length, limit: MAX_LEN }),
    }
}

#[cfg(test)]
mod tests {
    use downbeat_rtps::wire::{EntityId, GuidPrefix};

    use super::*;

    fn token() -> Token {
        Token {
            class_id: "abc".into(),
            properties: vec![("key".into(), "value".into())],
            binary: vec![("one".into(), vec![1, 2, 3]), ("two".into(), vec![4])],
        }
    }

    fn message() -> GenericMessage {
        let guid = |byte| Guid::new(GuidPrefix([byte; 12]), EntityId::PARTICIPANT);
        GenericMessage {
            source: (guid(1), 7),
            related: (Guid::UNKNOWN, 0),
            destination_participant: guid(2),
            destination_endpoint: guid(3),
            source_endpoint: guid(4),
            class: class::AUTHENTICATION.into(),
            tokens: vec![token(), Token::new("empty")],
        }
    }

    #[test]
    fn a_token_has_the_bytes_of_the_specification() {
        let mut bytes = Vec::new();
        token().emit(&mut bytes, ByteOrder::Big);
        let expected = b"\0\0\0\x04abc\0\
            \0\0\0\x01\0\0\0\x04key\0\0\0\0\x06value\0\0\0\
            \0\0\0\x02\0\0\0\x04one\0\0\0\0\x03\x01\x02\x03\0\
            \0\0\0\x04two\0\0\0\0\x01\x04\0\0\0";
        assert_eq!(bytes, expected);
    }

    #[test]
    fn tokens_and_messages_round_trip_in_both_byte_orders() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let mut bytes = Vec::new();
            token().emit(&mut bytes, order);
            assert_eq!(Token::parse(&bytes, order), Ok(token()));
            // Cyclone DDS does not pad the last value.
            assert_eq!(Token::parse(&bytes[..bytes.len() - 3], order), Ok(token()));
            let mut bytes = Vec::new();
            message().emit(&mut bytes, order);
            assert_eq!(bytes.len() % 4, 0);
            assert_eq!(GenericMessage::parse(&bytes), Ok(message()));
        }
    }

    #[test]
    fn a_message_that_is_cut_anywhere_is_refused() {
        let mut bytes = Vec::new();
        message().emit(&mut bytes, ByteOrder::Little);
        for length in 0..bytes.len() - 3 {
            assert!(GenericMessage::parse(&bytes[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn lengths_and_counts_beyond_the_message_are_refused_without_allocating_them() {
        let mut bytes = Vec::new();
        message().emit(&mut bytes, ByteOrder::Little);
        // The four bytes of encapsulation, two identities, three identities of entities.
        let class = 4 + 48 + 48;
        let tokens = class + 4 + 16;
        let change = |at: usize, value: u32| {
            let mut bytes = bytes.clone();
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            GenericMessage::parse(&bytes)
        };
        let field = "class of a message";
        assert_eq!(change(class, u32::MAX), Err(Malformed::Truncated { field }));
        assert_eq!(change(class, 0), Err(Malformed::String { field }));
        let too_many = Malformed::TooMany { field: "tokens", count: u32::MAX, limit: MAX_TOKENS };
        assert_eq!(change(tokens, u32::MAX), Err(too_many));
        let field = "class id of a token";
        assert_eq!(change(tokens, 3), Err(Malformed::Truncated { field }));
        assert_eq!(change(tokens, 1), Err(Malformed::Trailing { count: 23 }));
        let long = GenericMessage::parse(&vec![0; MAX_LEN + 1]);
        assert_eq!(long, Err(Malformed::TooLong { length: MAX_LEN + 1, limit: MAX_LEN }));
    }

    #[test]
    fn other_encapsulations_and_strings_with_zeros_are_refused() {
        let mut bytes = Vec::new();
        message().emit(&mut bytes, ByteOrder::Little);
        bytes[1] = 3;
        assert_eq!(GenericMessage::parse(&bytes), Err(Malformed::Encapsulation));
        let refused = Token::parse(b"\0\0\0\x04a\0c\0\0\0\0\0\0\0\0\0", ByteOrder::Big);
        assert_eq!(refused, Err(Malformed::String { field: "class id of a token" }));
        let refused = Token::parse(b"\0\0\0\x04\xffbc\0\0\0\0\0\0\0\0\0", ByteOrder::Big);
        assert_eq!(refused, Err(Malformed::String { field: "class id of a token" }));
    }

    #[test]
    fn debug_output_shows_no_binary_value() {
        let shown = format!("{:?}", token());
        let expected =
            r#"Token { class_id: "abc", properties: [("key", "value")], lengths: [("one", 3), ("two", 1)] }"#;
        assert_eq!(shown, expected);
    }
}
