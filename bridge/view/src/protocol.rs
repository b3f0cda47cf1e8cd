//! The messages of the protocol: JSON in text frames, and binary frames that begin with an opcode.

use serde::Deserialize;
use serde_json::{Value, json};

/// The versions of the protocol, which differ in their names only.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// A request of a viewer in a text frame.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(crate) enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    Advertise {
        channels: Vec<ClientChannel>,
    },
    Unadvertise {
        channel_ids: Vec<u32>,
    },
    GetParameters {
        parameter_names: Vec<String>,
        id: Option<String>,
    },
    SetParameters {
        parameters: Vec<Parameter>,
        id: Option<String>,
    },
    SubscribeParameterUpdates {
        parameter_names: Vec<String>,
    },
    UnsubscribeParameterUpdates {
        parameter_names: Vec<String>,
    },
    SubscribeConnectionGraph,
    UnsubscribeConnectionGraph,
    FetchAsset {
        uri: String,
        request_id: u32,
    },
    Ask {
        id: u32,
        ask: String,
        #[serde(flatten)]
        arguments: Value,
    },
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
    Playback(PlaybackControl),
}

/// What a viewer wants of playback.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlaybackControl {
    pub(crate) command: PlaybackCommand,
    /// Time of the data per real time.
    pub(crate) rate: f32,
    /// The time to go to, in nanoseconds since the epoch.
    pub(crate) seek_ns: Option<u64>,
    /// Returned in the answer.
    pub(crate) request_id: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlaybackCommand {
    Play,
    Pause,
}

/// What playback does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlaybackStatus {
    Playing = 0,
    Paused = 1,
    Ended = 3,
}

/// The identifier of a request is sent to every viewer.
const LONGEST_REQUEST_ID: usize = 256;

impl<'a> BinaryRequest<'a> {
    /// Reads a frame.
    ///
    /// # Errors
    /// In words, if it is too short or has another opcode.
    pub(crate) fn read(frame: &'a [u8]) -> Result<Self, String> {
        match frame.split_first() {
            Some((opcode @ 1..=3, body)) => {
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
        if opcode == 3 {
            return PlaybackControl::read(body).map(Self::Playback);
        }
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

impl PlaybackControl {
    /// Command (u8), rate (f32), whether there is a time (u8), time (u64), length of the identifier (u32),
    /// identifier.
    fn read(body: &[u8]) -> Option<Self> {
        let (&[command, ref rate @ .., has_time], rest) = body.split_first_chunk::<6>()?;
        let (time, rest) = rest.split_first_chunk()?;
        let (length, rest) = rest.split_first_chunk()?;
        let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
        let request_id = rest.get(..length).filter(|id| id.len() <= LONGEST_REQUEST_ID)?;
        Some(Self {
            command: match command {
                0 => PlaybackCommand::Play,
                1 => PlaybackCommand::Pause,
                _ => return None,
            },
            rate: f32::from_le_bytes(*rate),
            seek_ns: (has_time != 0).then(|| u64::from_le_bytes(*time)),
            request_id: std::str::from_utf8(request_id).ok()?.to_owned(),
        })
    }
}

/// The state of playback; `request_id` is that of the request that it answers, or empty.
pub(crate) fn playback_state(
    status: PlaybackStatus,
    time_ns: u64,
    rate: f32,
    did_seek: bool,
    request_id: &str,
) -> Vec<u8> {
    let mut frame = vec![5, status as u8];
    frame.extend(time_ns.to_le_bytes());
    frame.extend(rate.to_le_bytes());
    frame.push(u8::from(did_seek));
    frame.extend(u32::try_from(request_id.len()).unwrap_or(0).to_le_bytes());
    frame.extend(request_id.as_bytes());
    frame
}

/// A time as `serverInfo` has it.
pub(crate) fn timestamp(time_ns: u64) -> Value {
    json!({ "sec": time_ns / 1_000_000_000, "nsec": time_ns % 1_000_000_000 })
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

/// The answer to a question.
pub(crate) fn answer(id: u32, answered: Result<Value, String>) -> String {
    match answered {
        Ok(value) => json!({ "op": "answer", "id": id, "ok": value }),
        Err(reason) => json!({ "op": "answer", "id": id, "error": reason }),
    }
    .to_string()
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

    /// Bytes as in the snapshots of `rust/foxglove/src/protocol/v1` in Foxglove's SDK.
    #[test]
    fn requests_of_playback_are_read_as_the_sdk_writes_them() {
        let mut frame = vec![3, 0, 0, 0, 0x80, 0x3F, 1, 0x15, 0xCD, 0x5B, 0x07, 0, 0, 0, 0, 7, 0, 0, 0];
        frame.extend(b"some-id");
        let control = PlaybackControl {
            command: PlaybackCommand::Play,
            rate: 1.0,
            seek_ns: Some(123_456_789),
            request_id: "some-id".into(),
        };
        assert_eq!(BinaryRequest::read(&frame), Ok(BinaryRequest::Playback(control.clone())));
        for length in 1..frame.len() {
            assert!(BinaryRequest::read(&frame[..length]).is_err(), "{length} bytes");
        }
        (frame[1], frame[6]) = (1, 0);
        let paused = PlaybackControl { command: PlaybackCommand::Pause, seek_ns: None, ..control };
        assert_eq!(BinaryRequest::read(&frame), Ok(BinaryRequest::Playback(paused)));
        frame[1] = 2;
        assert!(BinaryRequest::read(&frame).is_err(), "no such command");
    }

    #[test]
    fn the_state_of_playback_is_written_as_in_the_sdk() {
        let frame = playback_state(PlaybackStatus::Playing, 12345, 1.0, true, "");
        assert_eq!(frame, [5, 0, 0x39, 0x30, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3F, 1, 0, 0, 0, 0]);
        let frame = playback_state(PlaybackStatus::Ended, 12345, 1.0, false, "ab");
        assert_eq!(frame[..2], [5, 3]);
        assert_eq!(frame[14..], [0, 2, 0, 0, 0, b'a', b'b']);
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
