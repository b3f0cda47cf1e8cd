//! Our output, read by the reference libraries of the formats with our schemas, and their output, read by us.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use downbeat_msgs::encoding::{Codec, Encoding};
use downbeat_msgs::protobuf;

use crate::python::{ask, hex, unhex};
use crate::random::Random;
use crate::types::{catalog, every_type, name};

const VALUES_PER_TYPE: usize = 8;

/// For each type a line with its schema, then for each value a line with its bytes and its JSON. Also returns
/// the values.
fn values(encoding: Encoding) -> (String, Vec<(Codec, Vec<u8>)>) {
    let mut random = Random::new(0x07e5);
    let (mut lines, mut values) = (String::new(), Vec::new());
    for of in every_type() {
        let codec = encoding.codec(catalog(), &name(of.name)).unwrap();
        writeln!(lines, "schema\t{}\t{}", codec.schema().name, hex(&codec.schema().data)).unwrap();
        for _ in 0..VALUES_PER_TYPE {
            let value = (of.random)(&mut random);
            let bytes = hex(&codec.encode(&value).unwrap());
            writeln!(lines, "value\t{bytes}\t{}", (of.to_json)(&value)).unwrap();
            values.push((codec.clone(), value));
        }
    }
    (lines, values)
}

#[test]
fn googles_protobuf_reads_every_type_with_our_schema_and_we_read_its_output() {
    let (lines, values) = values(Encoding::Protobuf);
    let Some(answer) = ask("protobuf", &lines) else { return };
    assert_eq!(answer.lines().count(), values.len());
    for (line, (codec, value)) in answer.lines().zip(&values) {
        let decoded = codec.decode(&unhex(line)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(decoded, *value, "{}", codec.type_name());
    }
}

#[test]
fn the_protobuf_compiler_derives_our_descriptors_from_our_text() {
    let (mut lines, mut files) = (String::new(), BTreeMap::new());
    for of in every_type() {
        let codec = Encoding::Protobuf.codec(catalog(), &name(of.name)).unwrap();
        writeln!(lines, "schema\t{}\t{}", codec.schema().name, hex(&codec.schema().data)).unwrap();
        for file in protobuf::schema_files(catalog(), &name(of.name)).unwrap() {
            files.insert(file.path, file.text);
        }
    }
    for (path, text) in &files {
        writeln!(lines, "file\t{path}\t{}", hex(text.as_bytes())).unwrap();
    }
    let Some(answer) = ask("proto_text", &lines) else { return };
    assert_eq!(answer.trim(), files.len().to_string());
}

#[test]
fn googles_flatbuffers_reads_every_type_with_our_binary_schema() {
    let (lines, values) = values(Encoding::FlatBuffers);
    let Some(answer) = ask("flatbuffers", &lines) else { return };
    assert_eq!(answer.trim(), values.len().to_string());
}

#[test]
fn every_json_message_is_valid_by_our_json_schema() {
    let (lines, values) = values(Encoding::Json);
    let Some(answer) = ask("json_schema", &lines) else { return };
    assert_eq!(answer.trim(), values.len().to_string());
}
