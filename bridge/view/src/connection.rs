//! A WebSocket connection: one thread reads requests, one writes frames.
//!
//! `tungstenite` does the handshake and reads. What it would write (pongs, the answer to a close frame) goes
//! through the outbox of the viewer like all other frames, so that only one thread writes.

use crate::options::{Access, Limits};
use crate::outbox::{Frame, Outbox};
use std::io::{self, Cursor, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tungstenite::http::{HeaderValue, StatusCode};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Error, Message, WebSocket};

/// What a viewer has proven when it connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Proof {
    /// It may change the robot.
    Full,
    /// It gave no token, or none is accepted.
    Read,
    /// It gave a wrong token.
    WrongToken,
}

/// The reading half of a connection.
pub(crate) struct Reader {
    socket: WebSocket<Wire>,
    rate: Rate,
}

/// Why a connection ends.
#[derive(Debug)]
pub(crate) enum Ended {
    /// The viewer left.
    Left,
    /// The server ends the connection, with a code of RFC 6455 and the reason.
    Refused(u16, &'static str),
}

/// Does the handshake within `limits.stall`. What was received of it already is `received`. Returns what the
/// peer has proven, and the version of the protocol.
///
/// # Errors
/// If the peer is slow, or is no viewer.
pub(crate) fn accept(
    stream: TcpStream,
    received: Vec<u8>,
    subprotocols: &'static [&'static str],
    access: &Access,
    limits: &Limits,
) -> Result<(Reader, Proof, &'static str), Box<dyn std::error::Error>> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let (mut proof, mut protocol) = (Proof::Read, "");
    #[allow(clippy::result_large_err, reason = "tungstenite's signature")]
    let check = |request: &Request, mut response: Response| -> Result<Response, ErrorResponse> {
        let offered = request.headers().get_all("sec-websocket-protocol");
        let mut offered =
            offered.iter().filter_map(|names| names.to_str().ok()).flat_map(|names| names.split(','));
        let Some(chosen) = offered.find_map(|name| subprotocols.iter().find(|known| **known == name.trim()))
        else {
            let text = "This is a server for Foxglove, Lichtblick and PlotJuggler: open it there as a Foxglove WebSocket.\n";
            let mut refusal = ErrorResponse::new(Some(text.to_owned()));
            *refusal.status_mut() = StatusCode::BAD_REQUEST;
            return Err(refusal);
        };
        protocol = chosen;
        response.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(chosen));
        let token = token_in(request.uri().query().unwrap_or_default());
        proof = match (access.admits(token), token, access) {
            (true, ..) => Proof::Full,
            (false, Some(_), Access::Token(_)) => Proof::WrongToken,
            (false, ..) => Proof::Read,
        };
        Ok(response)
    };
    let config = WebSocketConfig::default()
        .read_buffer_size(8 << 10)
        .write_buffer_size(0)
        .max_message_size(Some(limits.incoming_bytes))
        .max_frame_size(Some(limits.incoming_bytes));
    let deadline = Some(Instant::now() + limits.stall);
    let wire = Wire { stream, received: Cursor::new(received), deadline, outbox: None };
    let socket =
        tungstenite::accept_hdr_with_config(wire, check, Some(config)).map_err(|error| error.to_string())?;
    Ok((Reader { socket, rate: Rate::new(limits.incoming_per_second) }, proof, protocol))
}

fn token_in(query: &str) -> Option<&str> {
    query.split('&').find_map(|pair| pair.strip_prefix("token="))
}

impl Reader {
    /// Hands all that is written from now on to `outbox`, and returns the stream for the writing thread. A
    /// peer that sends nothing for `silence`, not even a pong, is disconnected.
    pub(crate) fn split(&mut self, outbox: &Arc<Outbox>, silence: Duration) -> io::Result<TcpStream> {
        let wire = self.socket.get_mut();
        wire.deadline = None;
        wire.outbox = Some(Arc::clone(outbox));
        wire.stream.set_read_timeout(Some(silence))?;
        wire.stream.try_clone()
    }

    /// The next text or binary message.
    pub(crate) fn next(&mut self) -> Result<Message, Ended> {
        loop {
            let message = self.socket.read().map_err(|error| match error {
                Error::Capacity(_) => Ended::Refused(1009, "a message is too long"),
                Error::Protocol(_) | Error::Utf8(_) | Error::AttackAttempt => {
                    Ended::Refused(1002, "this is not the WebSocket protocol")
                }
                Error::Io(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    Ended::Refused(1001, "nothing was received for too long")
                }
                _ => Ended::Left,
            })?;
            if !self.rate.admits(Instant::now()) {
                return Err(Ended::Refused(1008, "too many messages per second"));
            }
            match message {
                Message::Text(_) | Message::Binary(_) => return Ok(message),
                // The answer to a close frame is written by the next read, which ends.
                Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_) => {}
            }
        }
    }
}

/// Writes the frames of the outbox until it ends, the peer disappears, or it takes nothing for `stall`.
pub(crate) fn write(mut stream: TcpStream, outbox: &Outbox, stall: Duration) {
    const USUAL: usize = 64 << 10;
    let mut buffer = Vec::new();
    while let Some(frame) = outbox.next() {
        buffer.clear();
        buffer.shrink_to(USUAL);
        let body = frame.write_to(&mut buffer);
        let written =
            [&buffer[..], &body].iter().try_for_each(|part| write_all(&mut stream, part, outbox, stall));
        if written.is_err() {
            break;
        }
    }
    outbox.close();
    // Ends the reading thread too.
    let _ = stream.shutdown(Shutdown::Both);
}

/// Each write to a stream returns after this time, with or without success.
const PATIENCE: Duration = Duration::from_millis(500);

fn write_all(stream: &mut TcpStream, mut bytes: &[u8], outbox: &Outbox, stall: Duration) -> io::Result<()> {
    let mut last_progress = Instant::now();
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => {
                bytes = &bytes[count..];
                last_progress = Instant::now();
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                // A robot that stops does not wait for a viewer that has stalled.
                if last_progress.elapsed() >= stall || outbox.is_ending() {
                    return Err(error);
                }
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The stream as `tungstenite` sees it.
struct Wire {
    stream: TcpStream,
    /// What is read before the stream.
    received: Cursor<Vec<u8>>,
    /// When the handshake must be complete.
    deadline: Option<Instant>,
    /// After the handshake.
    outbox: Option<Arc<Outbox>>,
}

impl Read for Wire {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = self.received.read(buffer)?;
        if length > 0 {
            return Ok(length);
        }
        if let Some(deadline) = self.deadline {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(ErrorKind::TimedOut.into());
            }
            self.stream.set_read_timeout(Some(left))?;
        }
        self.stream.read(buffer)
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &self.outbox {
            None => self.stream.write(bytes),
            Some(outbox) => match outbox.announce(Frame::Raw(bytes.to_vec())) {
                Ok(()) => Ok(bytes.len()),
                Err(_) => Err(ErrorKind::BrokenPipe.into()),
            },
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Counts messages: a budget that fills up steadily, for two seconds at most.
struct Rate {
    per_second: f64,
    budget: f64,
    last: Option<Instant>,
}

impl Rate {
    fn new(per_second: u32) -> Self {
        let per_second = f64::from(per_second);
        Self { per_second, budget: 2.0 * per_second, last: None }
    }

    fn admits(&mut self, now: Instant) -> bool {
        let elapsed = self.last.replace(now).map_or(0.0, |last| (now - last).as_secs_f64());
        self.budget = (self.budget + elapsed * self.per_second).min(2.0 * self.per_second) - 1.0;
        self.budget >= 0.0
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_token_is_found_in_the_query() {
        assert_eq!(token_in("token=abc"), Some("abc"));
        assert_eq!(token_in("a=b&token=abc&c=d"), Some("abc"));
        assert_eq!(token_in("a=b&nottoken=abc"), None);
        assert_eq!(token_in(""), None);
    }

    #[test]
    fn a_steady_rate_passes_and_a_flood_does_not() {
        let (mut rate, start) = (Rate::new(100), Instant::now());
        assert!((0..1000).all(|n| rate.admits(start + Duration::from_millis(10 * n))));
        let mut rate = Rate::new(100);
        assert_eq!((0..1000).filter(|_| rate.admits(start)).count(), 200);
    }
}
