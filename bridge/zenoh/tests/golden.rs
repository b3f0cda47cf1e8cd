//! Every token, key, attachment and identity of a real node, byte for byte.
#![allow(clippy::unwrap_used)]

use downbeat_zenoh::wire::{Announced, Attachment, EndpointToken, Role, Token, gid, key};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

fn records(text: &str) -> impl Iterator<Item = (String, Value)> {
    text.lines().map(|line| {
        let record: Value = serde_json::from_str(line).unwrap();
        (record["kind"].as_str().unwrap().to_owned(), record)
    })
}

fn node() -> impl Iterator<Item = (String, Value)> {
    records(include_str!("golden/golden_node.jsonl"))
}

fn text<'a>(record: &'a Value, field: &str) -> &'a str {
    record[field].as_str().unwrap()
}

fn bytes(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

/// The tokens of endpoints, by their identity.
fn endpoints() -> BTreeMap<[u8; 16], EndpointToken> {
    let tokens = node().filter(|(kind, _)| kind == "token");
    let endpoints = tokens.filter_map(|(_, record)| {
        let token = text(&record, "key").to_owned();
        match token.parse::<Token>().unwrap().announced {
            Announced::Endpoint(endpoint) => Some((gid(&token), endpoint)),
            Announced::Node => None,
        }
    });
    endpoints.collect()
}

#[test]
fn every_token_is_read_and_written_as_it_was() {
    let mut read = 0;
    for (_, record) in node().filter(|(kind, _)| kind == "token") {
        let token = text(&record, "key");
        assert_eq!(token.parse::<Token>().unwrap().to_string(), token);
        read += 1;
    }
    assert_eq!(read, 100);
}

#[test]
fn every_key_of_samples_and_requests_follows_from_a_token() {
    let keys: BTreeSet<String> = endpoints()
        .values()
        .map(|endpoint| key(85, &endpoint.name, &endpoint.type_name, endpoint.hash.as_deref()))
        .collect();
    let mut seen = 0;
    for (_, record) in node().filter(|(kind, _)| kind == "sample" || kind == "query") {
        assert!(keys.contains(text(&record, "key")), "{record}");
        seen += 1;
    }
    assert!(seen > 20, "{seen}");
}

#[test]
fn the_identity_in_every_attachment_is_the_hash_of_a_token() {
    let endpoints = endpoints();
    let mut seen = 0;
    for (kind, record) in node().filter(|(_, record)| record["att"].is_string()) {
        let written = bytes(text(&record, "att"));
        let attachment = Attachment::parse(&written).unwrap();
        assert_eq!(attachment.to_bytes()[..], written);
        let Some(endpoint) = endpoints.get(&attachment.gid) else { continue };
        let role = if kind == "query" { Role::Client } else { Role::Publisher };
        assert_eq!(endpoint.role, role, "{record}");
        assert_eq!(
            text(&record, "key"),
            key(85, &endpoint.name, &endpoint.type_name, endpoint.hash.as_deref())
        );
        seen += 1;
    }
    assert!(seen > 20, "{seen}");
}

#[test]
fn replies_carry_the_number_and_the_identity_of_the_request() {
    let replies = records(include_str!("golden/replies.jsonl")).filter(|(kind, _)| kind == "reply");
    let attachments: Vec<_> =
        replies.map(|(_, record)| Attachment::parse(&bytes(text(&record, "att"))).unwrap()).collect();
    let of_request: Vec<_> =
        attachments.iter().map(|attachment| (attachment.sequence_number, attachment.gid)).collect();
    assert_eq!(of_request, [(7, [0x11; 16]), (8, [0x11; 16])]);
}

#[test]
fn identities_are_those_that_others_print() {
    let endpoint = |rest: &str| {
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let head = "@ros2_lv/85/89358d841018189f4be60385f2d48452/0";
        let rest = rest.replace("/S/", &format!("/std_msgs::msg::dds_::String_/{hash}/"));
        gid(&format!("{head}/{rest}"))
    };
    assert_eq!(
        endpoint("10/MP/%/%ns1/golden/%ns1%chatter/S/::,10:,:,:,,").to_vec(),
        bytes("9dca6a7d9bc3051d09da323ed5cda9b0")
    );
    assert_eq!(
        endpoint("15/MP/%/%ns1/golden/%d42/S/::,:,:,:,,").to_vec(),
        bytes("6fa0a9489b7d9ea8319428e04d33b11d")
    );
}
