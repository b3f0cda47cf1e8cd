//! Conversion between CDR and an encoding.

use downbeat_msgs_definitions::{Catalog, DefinitionEncoding, TypeName};

use super::Encoding;
use crate::cdr;
#[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
use crate::foxglove;
use crate::interchange::{self, CodecDirection, Error, Problem, Value};
use crate::message::Message;

/// Converts between the CDR of a message type and an encoding.
#[derive(Clone, Debug)]
pub struct Codec {
    type_name: String,
    encoding: Encoding,
    /// The schema of the definition, for reading and writing CDR.
    definition: interchange::Schema,
    /// The mapping to Foxglove's type, if the encoding uses it.
    #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
    foxglove: Option<foxglove::Mapping>,
    schema: Schema,
}

/// The schema record of a channel in an MCAP file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schema {
    /// The type: `sensor_msgs/msg/Imu`, `sensor_msgs.msg.Imu`, `foxglove.RawImage`.
    pub name: String,
    /// The format of the data: `ros2msg`, `jsonschema`, `protobuf`, `flatbuffer`; empty if there is none.
    pub encoding: String,
    /// The schema.
    pub data: Vec<u8>,
}

impl Encoding {
    /// Creates a codec for a type whose definition is in the catalog.
    ///
    /// # Errors
    /// Returns an error if the catalog lacks a type, the type is too large, or this build lacks the encoding.
    pub fn codec(self, catalog: &Catalog, name: &TypeName) -> Result<Codec, Error> {
        self.check_compiled_in()?;
        let definition = interchange::Schema::of_definition(catalog, name)?;
        let type_name = name.to_string();
        #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
        let foxglove = match self {
            Self::FoxgloveProtobuf | Self::FoxgloveFlatBuffers => {
                foxglove::Mapping::new(&type_name, &definition, self)
            }
            _ => None,
        };
        #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
        let target = foxglove.as_ref().map_or(&definition, |mapping| mapping.schema());
        #[cfg(all(feature = "json", not(any(feature = "protobuf", feature = "flatbuffers"))))]
        let target = &definition;
        let (name_there, schema_encoding, data) = match self {
            Self::Cdr => (type_name.clone(), "ros2msg", catalog.definition_text(name)?.into_bytes()),
            #[cfg(feature = "json")]
            Self::Json => {
                (type_name.clone(), "jsonschema", super::json_schema::json_schema(&type_name, target))
            }
            #[cfg(feature = "protobuf")]
            Self::Protobuf | Self::FoxgloveProtobuf => {
                (target.root().name.clone(), "protobuf", crate::protobuf::file_descriptor_set(target))
            }
            #[cfg(feature = "flatbuffers")]
            Self::FlatBuffers | Self::FoxgloveFlatBuffers => {
                (target.root().name.clone(), "flatbuffer", crate::flatbuffers::binary_schema(target))
            }
            _ => (type_name.clone(), "", Vec::new()),
        };
        Ok(Codec {
            type_name,
            encoding: self,
            schema: Schema { name: name_there, encoding: schema_encoding.into(), data },
            definition,
            #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
            foxglove,
        })
    }

    /// Like [`Encoding::codec`], with the `ros2msg` text of the definition: [`Message::DEFINITION`], or from
    /// a bag.
    ///
    /// # Errors
    /// See [`Encoding::codec`]; also if the text is not a definition.
    pub fn codec_of_text(self, type_name: &str, definition: &str) -> Result<Codec, Error> {
        let name: TypeName = type_name.parse()?;
        let mut catalog = Catalog::new();
        catalog.add_definition_text(&name, DefinitionEncoding::Ros2Msg, definition, type_name)?;
        self.codec(&catalog, &name)
    }

    fn check_compiled_in(self) -> Result<(), Error> {
        let (is_there, feature) = match self {
            Self::Cdr => (true, ""),
            Self::Json => (cfg!(feature = "json"), "json"),
            Self::Cbor => (cfg!(feature = "cbor"), "cbor"),
            Self::Protobuf | Self::FoxgloveProtobuf => (cfg!(feature = "protobuf"), "protobuf"),
            Self::FlatBuffers | Self::FoxgloveFlatBuffers => (cfg!(feature = "flatbuffers"), "flatbuffers"),
        };
        if is_there { Ok(()) } else { Err(Error::NotCompiledIn { encoding: self.as_str(), feature }) }
    }
}

impl Codec {
    /// The encoding.
    #[must_use]
    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// The name of the ROS 2 type.
    #[must_use]
    pub fn type_name(&self) -> &str {
        &self.type_name
    }

    /// Its name in MCAP files and in the metadata of a bag.
    #[must_use]
    pub fn message_encoding(&self) -> &'static str {
        self.encoding.message_encoding()
    }

    /// The schema for MCAP files.
    #[must_use]
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Converts from CDR in either byte order, including its header.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type, or the encoding cannot represent a value.
    pub fn encode(&self, cdr: &[u8]) -> Result<Vec<u8>, Error> {
        #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
        if let Some(mapping) = &self.foxglove {
            let value = self.read_cdr(cdr)?;
            return mapping
                .to_foxglove(&self.definition, value)
                .and_then(|value| self.put(mapping.schema(), &value))
                .map_err(|problem| self.error(CodecDirection::Write, problem));
        }
        let value = self.read_cdr(cdr)?;
        if self.encoding == Encoding::Cdr {
            return Ok(cdr.to_vec());
        }
        self.put(&self.definition, &value).map_err(|problem| self.error(CodecDirection::Write, problem))
    }

    /// Converts to CDR, little-endian with its header. Fields that the encoding does not preserve have their
    /// defaults.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type in the encoding, or violate its
    /// definition.
    pub fn decode(&self, bytes: &[u8]) -> Result<Vec<u8>, Error> {
        #[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
        if let Some(mapping) = &self.foxglove {
            return self
                .get(mapping.schema(), bytes)
                .and_then(|value| mapping.to_ros(&self.definition, value))
                .and_then(|value| interchange::cdr::write(&self.definition, &value))
                .map_err(|problem| self.error(CodecDirection::Read, problem));
        }
        if self.encoding == Encoding::Cdr {
            self.read_cdr(bytes)?;
            return Ok(bytes.to_vec());
        }
        self.get(&self.definition, bytes)
            .and_then(|value| interchange::cdr::write(&self.definition, &value))
            .map_err(|problem| self.error(CodecDirection::Read, problem))
    }

    /// Encodes a message of the codec's type.
    ///
    /// # Errors
    /// Returns an error if it is of another type, or the encoding cannot represent a value.
    pub fn to_vec<T: Message>(&self, message: &T) -> Result<Vec<u8>, Error> {
        self.check_type::<T>(CodecDirection::Write)?;
        self.encode(&cdr::to_vec(message))
    }

    /// Decodes a message of the codec's type.
    ///
    /// # Errors
    /// Returns an error if it is of another type, or the bytes are not a message of the type in the encoding.
    pub fn from_slice<T: Message>(&self, bytes: &[u8]) -> Result<T, Error> {
        self.check_type::<T>(CodecDirection::Read)?;
        cdr::from_slice(&self.decode(bytes)?).map_err(|source| self.cdr_error(source))
    }

    fn check_type<T: Message>(&self, direction: CodecDirection) -> Result<(), Error> {
        if T::TYPE_NAME == self.type_name {
            return Ok(());
        }
        Err(self.error(direction, Problem::new(format!("the message is a {}", T::TYPE_NAME))))
    }

    /// Writes the value in the encoding.
    fn put(&self, schema: &interchange::Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
        match self.encoding {
            #[cfg(feature = "json")]
            Encoding::Json => interchange::tree::to_json(schema, value),
            #[cfg(feature = "cbor")]
            Encoding::Cbor => interchange::tree::to_cbor(schema, value),
            #[cfg(feature = "protobuf")]
            Encoding::Protobuf | Encoding::FoxgloveProtobuf => crate::protobuf::encode(schema, value),
            #[cfg(feature = "flatbuffers")]
            Encoding::FlatBuffers | Encoding::FoxgloveFlatBuffers => {
                crate::flatbuffers::encode(schema, value)
            }
            _ => interchange::cdr::write(schema, value),
        }
    }

    fn get<'a>(&self, schema: &interchange::Schema, bytes: &'a [u8]) -> Result<Value<'a>, Problem> {
        match self.encoding {
            #[cfg(feature = "json")]
            Encoding::Json => interchange::tree::from_json(schema, bytes),
            #[cfg(feature = "cbor")]
            Encoding::Cbor => interchange::tree::from_cbor(schema, bytes),
            #[cfg(feature = "protobuf")]
            Encoding::Protobuf | Encoding::FoxgloveProtobuf => crate::protobuf::decode(schema, bytes),
            #[cfg(feature = "flatbuffers")]
            Encoding::FlatBuffers | Encoding::FoxgloveFlatBuffers => {
                crate::flatbuffers::decode(schema, bytes)
            }
            _ => interchange::cdr::read(schema, bytes).map_err(|error| Problem::new(error.to_string())),
        }
    }

    fn read_cdr<'a>(&self, cdr: &'a [u8]) -> Result<Value<'a>, Error> {
        interchange::cdr::read(&self.definition, cdr).map_err(|source| self.cdr_error(source))
    }

    fn error(&self, direction: CodecDirection, problem: Problem) -> Error {
        problem.into_error(&self.type_name, direction, self.encoding.as_str())
    }

    fn cdr_error(&self, source: cdr::Error) -> Error {
        Error::Cdr { type_name: self.type_name.clone(), source }
    }
}
