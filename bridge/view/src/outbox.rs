//! What waits to be sent to one viewer: bounded, and never waited for by the robot.

use crate::protocol::{call_response_head, message_head};
use bytes::Bytes;
use downbeat_edge::EncodedAnswer;
use parking_lot::{Condvar, Mutex};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::{Duration, Instant};

/// A WebSocket frame to a viewer.
pub(crate) enum Frame {
    Text(String),
    Binary(Vec<u8>),
    /// Two parts of one binary frame; the second is not copied.
    Parts(Vec<u8>, Bytes),
    /// A response of a service, which is serialized when it is sent.
    Response {
        service_id: u32,
        call_id: u32,
        answer: EncodedAnswer,
    },
    Ping,
    Close {
        code: u16,
        reason: &'static str,
    },
    /// Frames as bytes.
    Raw(Vec<u8>),
}

/// The queue between the threads of the server and the thread that writes to a viewer.
pub(crate) struct Outbox {
    state: Mutex<State>,
    changed: Condvar,
    most_messages: usize,
    most_bytes: usize,
}

/// The largest number of bytes of answers and announcements that may wait. A larger single one is accepted if
/// the queue is empty.
const MOST_CONTROL_BYTES: usize = 8 << 20;

#[derive(Default)]
struct State {
    /// Sent first, in order, and never dropped.
    control: VecDeque<Frame>,
    control_bytes: usize,
    messages: VecDeque<Message>,
    message_bytes: usize,
    /// The bytes that wait, by subscription.
    waiting: HashMap<u32, usize>,
    /// Dropped messages since they were last taken, by subscription.
    dropped: BTreeMap<u32, u64>,
    /// Nothing more is taken; the rest is sent, then `last`.
    is_ending: bool,
    last: Option<Frame>,
    /// Nothing more is sent.
    is_closed: bool,
}

struct Message {
    subscription: u32,
    time_ns: u64,
    cdr: Bytes,
}

/// The outbox takes nothing more: it was closed, or the viewer does not read.
#[derive(Debug, PartialEq)]
pub(crate) struct Closed;

impl Outbox {
    pub(crate) fn new(most_messages: usize, most_bytes: usize) -> Self {
        Self { state: Mutex::default(), changed: Condvar::new(), most_messages, most_bytes }
    }

    /// Takes a message of a topic, in place of older ones where there is no room.
    pub(crate) fn push_message(&self, subscription: u32, time_ns: u64, cdr: Bytes) {
        let mut state = self.state.lock();
        if state.is_ending || state.is_closed {
            return;
        }
        state.message_bytes += cdr.len();
        *state.waiting.entry(subscription).or_default() += cdr.len();
        state.messages.push_back(Message { subscription, time_ns, cdr });
        while state.message_bytes > self.most_bytes {
            state.drop_of_bulkiest();
        }
        while state.messages.len() > self.most_messages {
            state.drop_at(0);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Counts messages that were lost before they came here.
    pub(crate) fn count_dropped(&self, subscription: u32, messages: u64) {
        *self.state.lock().dropped.entry(subscription).or_default() += messages;
    }

    /// Discards the messages of a subscription that has ended.
    pub(crate) fn forget(&self, subscription: u32) {
        let mut state = self.state.lock();
        state.messages.retain(|message| message.subscription != subscription);
        let bytes = state.waiting.remove(&subscription).unwrap_or(0);
        state.message_bytes -= bytes;
        state.dropped.remove(&subscription);
    }

    /// Discards all messages that wait: the viewer goes to another time.
    pub(crate) fn clear_messages(&self) {
        let mut state = self.state.lock();
        state.messages.clear();
        state.waiting.clear();
        state.message_bytes = 0;
    }

    /// The dropped messages since the last call, by subscription.
    pub(crate) fn take_dropped(&self) -> BTreeMap<u32, u64> {
        std::mem::take(&mut self.state.lock().dropped)
    }

    /// Takes an announcement without waiting.
    ///
    /// # Errors
    /// If too much waits already: the viewer does not read.
    pub(crate) fn announce(&self, frame: Frame) -> Result<(), Closed> {
        let mut state = self.state.lock();
        if !state.has_room(frame.len()) {
            return Err(Closed);
        }
        state.push_control(frame);
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Takes the answer to a request; waits for room, which slows down the viewer that asks.
    ///
    /// # Errors
    /// If there is no room within `patience`.
    pub(crate) fn answer(&self, frame: Frame, patience: Duration) -> Result<(), Closed> {
        let deadline = Instant::now() + patience;
        let mut state = self.state.lock();
        while !state.has_room(frame.len()) {
            if state.is_ending || state.is_closed {
                return Err(Closed);
            }
            if self.changed.wait_until(&mut state, deadline).timed_out() {
                return Err(Closed);
            }
        }
        state.push_control(frame);
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Takes a last frame. The writer ends after all that waits and this.
    pub(crate) fn end(&self, last: Option<Frame>) {
        let mut state = self.state.lock();
        if !state.is_ending {
            (state.is_ending, state.last) = (true, last);
        }
        drop(state);
        self.changed.notify_all();
    }

    pub(crate) fn is_ending(&self) -> bool {
        self.state.lock().is_ending
    }

    /// Discards everything.
    pub(crate) fn close(&self) {
        *self.state.lock() = State { is_ending: true, is_closed: true, ..State::default() };
        self.changed.notify_all();
    }

    /// Waits for the next frame; `None` at the end.
    pub(crate) fn next(&self) -> Option<Frame> {
        let mut state = self.state.lock();
        loop {
            if state.is_closed {
                return None;
            }
            if let Some(frame) = state.pop() {
                drop(state);
                self.changed.notify_all();
                return Some(frame);
            }
            if state.is_ending {
                return None;
            }
            self.changed.wait(&mut state);
        }
    }
}

impl State {
    fn has_room(&self, bytes: usize) -> bool {
        let is_open = !self.is_ending && !self.is_closed;
        is_open && (self.control.is_empty() || self.control_bytes + bytes <= MOST_CONTROL_BYTES)
    }

    fn push_control(&mut self, frame: Frame) {
        self.control_bytes += frame.len();
        self.control.push_back(frame);
    }

    fn pop(&mut self) -> Option<Frame> {
        if let Some(frame) = self.control.pop_front() {
            self.control_bytes = self.control_bytes.saturating_sub(frame.len());
            return Some(frame);
        }
        let Some(Message { subscription, time_ns, cdr }) = self.messages.pop_front() else {
            return self.last.take();
        };
        self.count_removed(subscription, cdr.len());
        Some(Frame::Parts(message_head(subscription, time_ns).to_vec(), cdr))
    }

    /// Drops the oldest message of the subscription of which the most bytes wait, so that a camera does not
    /// displace joint states.
    fn drop_of_bulkiest(&mut self) {
        let bulkiest = self.waiting.iter().max_by_key(|&(id, bytes)| (*bytes, *id)).map(|(id, _)| *id);
        let position = self.messages.iter().position(|message| Some(message.subscription) == bulkiest);
        self.drop_at(position.unwrap_or(0));
    }

    fn drop_at(&mut self, position: usize) {
        if let Some(message) = self.messages.remove(position) {
            self.count_removed(message.subscription, message.cdr.len());
            *self.dropped.entry(message.subscription).or_default() += 1;
        }
    }

    fn count_removed(&mut self, subscription: u32, bytes: usize) {
        self.message_bytes -= bytes;
        if let Some(waiting) = self.waiting.get_mut(&subscription) {
            *waiting -= bytes;
        }
    }
}

impl Frame {
    /// The bytes that it occupies; those of a response are not known yet.
    fn len(&self) -> usize {
        match self {
            Self::Text(text) => text.len(),
            Self::Binary(bytes) | Self::Raw(bytes) => bytes.len(),
            Self::Parts(head, body) => head.len() + body.len(),
            Self::Response { .. } | Self::Ping | Self::Close { .. } => 0,
        }
    }

    /// Appends the frame to `buffer`, except for a large body, which is returned.
    pub(crate) fn write_to(self, buffer: &mut Vec<u8>) -> Bytes {
        const LARGE: usize = 16 << 10;
        match self {
            Self::Text(text) => write(buffer, 1, &[text.as_bytes()]),
            Self::Binary(bytes) => write(buffer, 2, &[&bytes]),
            Self::Parts(head, body) if body.len() >= LARGE => {
                write_header(buffer, 2, head.len() + body.len());
                buffer.extend(head);
                return body;
            }
            Self::Parts(head, body) => write(buffer, 2, &[&head, &body]),
            Self::Response { service_id, call_id, answer } => {
                write(buffer, 2, &[&call_response_head(service_id, call_id), &answer.into_cdr()]);
            }
            Self::Ping => write(buffer, 9, &[]),
            Self::Close { code, reason } => write(buffer, 8, &[&code.to_be_bytes(), reason.as_bytes()]),
            Self::Raw(bytes) => buffer.extend(bytes),
        }
        Bytes::new()
    }
}

fn write(buffer: &mut Vec<u8>, opcode: u8, parts: &[&[u8]]) {
    write_header(buffer, opcode, parts.iter().map(|part| part.len()).sum());
    parts.iter().for_each(|part| buffer.extend(*part));
}

/// The header of an unfragmented, unmasked frame (RFC 6455, section 5.2).
fn write_header(buffer: &mut Vec<u8>, opcode: u8, length: usize) {
    buffer.push(0x80 | opcode);
    match length {
        0..126 => buffer.push(length as u8),
        126..=0xFFFF => {
            buffer.push(126);
            buffer.extend((length as u16).to_be_bytes());
        }
        _ => {
            buffer.push(127);
            buffer.extend((length as u64).to_be_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// The subscriptions of the messages that wait, with the first byte of each.
    fn waiting(outbox: &Outbox) -> Vec<(u32, u8)> {
        outbox.state.lock().messages.iter().map(|message| (message.subscription, message.cdr[0])).collect()
    }

    fn push(outbox: &Outbox, subscription: u32, first: u8, length: usize) {
        let mut cdr = vec![0; length];
        cdr[0] = first;
        outbox.push_message(subscription, 0, cdr.into());
    }

    #[test]
    fn a_full_outbox_drops_the_oldest_message_of_the_bulkiest_topic() {
        let outbox = Outbox::new(100, 1000);
        push(&outbox, 1, 1, 10);
        for first in 0..4 {
            push(&outbox, 2, first, 300);
        }
        push(&outbox, 1, 2, 10);
        assert_eq!(waiting(&outbox), [(1, 1), (2, 1), (2, 2), (2, 3), (1, 2)]);
        assert_eq!(outbox.take_dropped(), BTreeMap::from([(2, 1)]));
        assert_eq!(outbox.take_dropped(), BTreeMap::new());
    }

    #[test]
    fn the_number_of_messages_is_bounded_too() {
        let outbox = Outbox::new(3, 1000);
        (0..10).for_each(|first| push(&outbox, 1, first, 1));
        assert_eq!(waiting(&outbox), [(1, 7), (1, 8), (1, 9)]);
        assert_eq!(outbox.take_dropped(), BTreeMap::from([(1, 7)]));
    }

    #[test]
    fn a_message_larger_than_the_outbox_is_dropped_and_the_others_stay() {
        let outbox = Outbox::new(3, 100);
        push(&outbox, 1, 1, 10);
        push(&outbox, 2, 2, 200);
        assert_eq!(waiting(&outbox), [(1, 1)]);
    }

    #[test]
    fn a_subscription_that_ended_leaves_nothing() {
        let outbox = Outbox::new(3, 100);
        push(&outbox, 1, 1, 40);
        push(&outbox, 2, 2, 40);
        outbox.forget(1);
        assert_eq!(waiting(&outbox), [(2, 2)]);
        push(&outbox, 3, 3, 60);
        assert_eq!(waiting(&outbox), [(2, 2), (3, 3)], "its bytes are free");
    }

    #[test]
    fn answers_overtake_messages() {
        let outbox = Outbox::new(3, 100);
        push(&outbox, 1, 1, 4);
        outbox.announce(Frame::Text("{}".into())).unwrap();
        let mut bytes = Vec::new();
        outbox.end(Some(Frame::Close { code: 1001, reason: "" }));
        while let Some(frame) = outbox.next() {
            frame.write_to(&mut bytes);
        }
        let expected =
            [&b"\x81\x02{}"[..], b"\x82\x11\x01\x01\0\0\0\0\0\0\0\0\0\0\0\x01\0\0\0", b"\x88\x02\x03\xE9"]
                .concat();
        assert_eq!(bytes, expected, "and the last frame comes last");
    }

    #[test]
    fn a_viewer_that_reads_no_answers_gets_no_more() {
        let outbox = Outbox::new(3, 100);
        let large = || Frame::Binary(vec![0; MOST_CONTROL_BYTES]);
        outbox.announce(large()).unwrap();
        assert_eq!(outbox.announce(large()), Err(Closed));
        assert_eq!(outbox.answer(large(), Duration::from_millis(1)), Err(Closed));
        assert!(outbox.next().is_some());
        outbox.answer(large(), Duration::from_millis(1)).unwrap();
        outbox.close();
        assert_eq!(outbox.announce(Frame::Ping), Err(Closed));
        assert!(outbox.next().is_none());
    }

    #[test]
    fn lengths_of_frames_are_written_as_in_rfc_6455() {
        for (length, header) in [
            (0, vec![0x82, 0]),
            (125, vec![0x82, 125]),
            (126, vec![0x82, 126, 0, 126]),
            (65535, vec![0x82, 126, 255, 255]),
            (65536, vec![0x82, 127, 0, 0, 0, 0, 0, 1, 0, 0]),
        ] {
            let mut buffer = Vec::new();
            Frame::Binary(vec![7; length]).write_to(&mut buffer);
            assert_eq!(buffer[..header.len()], header);
            assert_eq!(buffer.len(), header.len() + length);
        }
        let mut buffer = Vec::new();
        let body = Frame::Parts(vec![1; 13], vec![7; 70_000].into()).write_to(&mut buffer);
        assert_eq!(buffer[..10], [0x82, 127, 0, 0, 0, 0, 0, 1, 0x11, 0x7D]);
        assert_eq!((buffer.len(), body.len()), (23, 70_000));
    }
}
