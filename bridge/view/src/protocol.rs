//! The messages of the protocol: JSON in text frames, and binary frames that begin with an opcode.

use serde::Deserialize;
use serde_json::{Value, json};

/// The versions of the protocol, which differ in their names only.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// A request of a viewer in a text frame.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(crate) enum Request {
    Subscribe { subscriptions: Vec<Subscription> },
    Unsubscribe { subscription_ids: Vec<u32> },
    Advertise { channels: Vec<ClientChannel> },
    Unadvertise { channel_ids: Vec<u32> },
    GetParameters { parameter_names: Vec<String>, id: Option<String> },
    SetParameters { parameters: Vec<Parameter>, id: Option<String> },
    SubscribeParameterUpdates { parameter_names: Vec<String> },
    UnsubscribeParameterUpdates { parameter_names: Vec<String> },
    SubscribeConnectionGraph,
    UnsubscribeConnectionGraph,
    FetchAsset { uri: String, request_id: u32 },
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Subscription {
    pub(crate) id: u32,
    pub(crate) channel_id: u32,
}

/// A topic on which a viewer publishes.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct ClientChannel {
    pub(crate) id: u32,
    pub(crate) topic: String,
    pub(crate) encoding: String,
    pub(crate) schema_name: String,
}

#[derive(Debug, PartialEq, Deserialize)]
pub(crate) struct Parameter {
    pub(crate) name: String,
    #[serde(default)]
    pub(crate) value: Value,
}

/// A request of a viewer in a binary frame.
#[derive(Debug, PartialEq)]
pub(crate) enum BinaryRequest<'a> {
    Publish { channel_id: u32, data: &'a [u8] },
    Call { service_id: u32, call_id: u32, encoding: &'a str, data: &'a [u8] },
}

impl<'a> BinaryRequest<'a> {
    /// Reads a frame.
    ///
    /// # Errors
    /// In words, if it is too short or has another opcode.
    pub(crate) fn read(frame: &'a [u8]) -> Result<Self, String> {
        match frame.split_first() {
            Some((opcode @ (1 | 2), body)) => {
                Self::read_body(*opcode, body).ok_or_else(|| "a binary message is damaged".to_owned())
            }
            Some((other, _)) => Err(format!("binary messages with the opcode {other} are not supported")),
            None => Err("a binary message is empty".to_owned()),
        }
    }

    fn read_body(opcode: u8, body: &'a [u8]) -> Option<Self> {
        let number = |bytes: &'a [u8]| {
            let (number, rest) = bytes.split_first_chunk::<4>()?;
            Some((u32::from_le_bytes(*number), rest))
        };
        let (id, rest) = number(body)?;
        if opcode == 1 {
            return Some(Self::Publish { channel_id: id, data: rest });
        }
        let (call_id, rest) = number(rest)?;
        let (length, rest) = number(rest)?;
        let (encoding, data) = rest.split_at_checked(usize::try_from(length).ok()?)?;
        let encoding = std::str::from_utf8(encoding).ok()?;
        Some(Self::Call { service_id: id, call_id, encoding, data })
    }
}

/// The weight of a status message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Warning = 1,
    Error = 2,
}

pub(crate) fn status(level: Level, message: &str) -> String {
    json!({ "op": "status", "level": level as u8, "message": message }).to_string()
}

pub(crate) fn call_failure(service_id: u32, call_id: u32, message: &str) -> String {
    json!({ "op": "serviceCallFailure", "serviceId": service_id, "callId": call_id, "message": message })
        .to_string()
}

/// What precedes the bytes of a message.
pub(crate) fn message_head(subscription: u32, time_ns: u64) -> [u8; 13] {
    let mut head = [1; 13];
    head[1..5].copy_from_slice(&subscription.to_le_bytes());
    head[5..].copy_from_slice(&time_ns.to_le_bytes());
    head
}

pub(crate) fn time(time_ns: u64) -> Vec<u8> {
    let mut frame = vec![2];
    frame.extend(time_ns.to_le_bytes());
    frame
}

/// What precedes the bytes of a response in CDR.
pub(crate) fn call_response_head(service_id: u32, call_id: u32) -> Vec<u8> {
    let mut head = vec![3];
    for number in [service_id, call_id, 3] {
        head.extend(number.to_le_bytes());
    }
    head.extend(b"cdr");
    head
}

/// What precedes the contents of a file.
pub(crate) fn asset_head(request_id: u32) -> Vec<u8> {
    asset(request_id, 0, "")
}

pub(crate) fn asset_error(request_id: u32, reason: &str) -> Vec<u8> {
    asset(request_id, 1, reason)
}

fn asset(request_id: u32, status: u8, reason: &str) -> Vec<u8> {
    let mut frame = vec![4];
    frame.extend(request_id.to_le_bytes());
    frame.push(status);
    frame.extend(u32::try_from(reason.len()).unwrap_or(0).to_le_bytes());
    frame.extend(reason.as_bytes());
    frame
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn requests_are_read_as_the_client_class_writes_them() {
        let read = |text: &str| serde_json::from_str::<Request>(text).unwrap();
        assert_eq!(
            read(r#"{"op":"subscribe","subscriptions":[{"id":3,"channelId":7}]}"#),
            Request::Subscribe { subscriptions: vec![Subscription { id: 3, channel_id: 7 }] }
        );
        assert_eq!(
            read(r#"{"op":"unsubscribe","subscriptionIds":[3]}"#),
            Request::Unsubscribe { subscription_ids: vec![3] }
        );
        assert_eq!(
            read(
                r#"{"op":"advertise","channels":[{"id":1,"topic":"/a","encoding":"cdr","schemaName":"std_msgs/msg/Bool"}]}"#
            ),
            Request::Advertise {
                channels: vec![ClientChannel {
                    id: 1,
                    topic: "/a".into(),
                    encoding: "cdr".into(),
                    schema_name: "std_msgs/msg/Bool".into()
                }]
            }
        );
        assert_eq!(
            read(
                r#"{"op":"setParameters","parameters":[{"name":"a.b","value":1.5,"type":"float64"}],"id":"x"}"#
            ),
            Request::SetParameters {
                parameters: vec![Parameter { name: "a.b".into(), value: json!(1.5) }],
                id: Some("x".into())
            }
        );
        assert_eq!(
            read(r#"{"op":"getParameters","parameterNames":[]}"#),
            Request::GetParameters { parameter_names: vec![], id: None }
        );
        assert_eq!(read(r#"{"op":"subscribeConnectionGraph"}"#), Request::SubscribeConnectionGraph);
        assert_eq!(
            read(r#"{"op":"fetchAsset","uri":"package://a/b","requestId":9}"#),
            Request::FetchAsset { uri: "package://a/b".into(), request_id: 9 }
        );
    }

    #[test]
    fn binary_requests_are_read() {
        assert_eq!(
            BinaryRequest::read(&[1, 7, 0, 0, 0, 0xAA]),
            Ok(BinaryRequest::Publish { channel_id: 7, data: &[0xAA] })
        );
        let mut call = vec![2, 1, 0, 0, 0, 2, 1, 0, 0, 3, 0, 0, 0];
        call.extend(b"cdr\x00\x01");
        assert_eq!(
            BinaryRequest::read(&call),
            Ok(BinaryRequest::Call { service_id: 1, call_id: 258, encoding: "cdr", data: &[0, 1] })
        );
    }

    #[test]
    fn a_damaged_binary_request_is_an_error() {
        let mut call = vec![2, 1, 0, 0, 0, 2, 0, 0, 0, 255, 255, 255, 255];
        call.extend(b"cdr");
        for length in 0..=call.len() {
            assert!(BinaryRequest::read(&call[..length]).is_err(), "{length} bytes");
        }
        assert!(BinaryRequest::read(&[9, 0, 0, 0, 0]).unwrap_err().contains("opcode 9"));
        assert!(BinaryRequest::read(&[2, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0xFF]).is_err(), "not UTF-8");
    }

    #[test]
    fn binary_answers_are_little_endian_as_in_the_client_class() {
        assert_eq!(message_head(0x0102, 3), [1, 2, 1, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(time(256), [2, 0, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(call_response_head(1, 2), *b"\x03\x01\0\0\0\x02\0\0\0\x03\0\0\0cdr");
        assert_eq!(asset_head(5), [4, 5, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(asset_error(5, "no"), *b"\x04\x05\0\0\0\x01\x02\0\0\0no");
    }
}
