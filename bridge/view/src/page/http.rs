//! The little of HTTP that a page needs: requests for files, on connections that stay open, until one becomes
//! a WebSocket.

use super::{PageOptions, files};
use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, TcpStream};
use std::time::{Duration, Instant};

/// How long a browser may keep a connection open without a request.
const IDLE: Duration = Duration::from_secs(15);

/// Files fetched over one connection.
const MOST_REQUESTS: usize = 1000;

/// The longest head of a request, and the most headers in it.
const LONGEST_HEAD: usize = 16 << 10;
const MOST_HEADERS: usize = 64;

/// Scripts, styles and connections only from here, pictures from the page too; nothing inline.
const SECURITY: &str = "Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
     connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
     X-Content-Type-Options: nosniff\r\n\
     Referrer-Policy: no-referrer\r\n\
     Cross-Origin-Opener-Policy: same-origin\r\n\
     Cross-Origin-Resource-Policy: same-origin\r\n";

/// Serves files until the browser leaves or asks for the WebSocket. Returns the bytes of that request, for
/// the handshake.
pub(crate) fn serve(stream: &mut TcpStream, options: &PageOptions) -> io::Result<Option<Vec<u8>>> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(IDLE))?;
    let mut received = Vec::new();
    for _ in 0..MOST_REQUESTS {
        let Some(length) = receive_head(stream, &mut received)? else { return Ok(None) };
        let answer = match Head::read(&received[..length]) {
            Err(refusal) => refusal,
            Ok(head) => match head.check(options) {
                Err(refusal) => refusal,
                Ok(()) if head.is_websocket => return Ok(Some(received)),
                Ok(()) => file(&head, options),
            },
        };
        let is_last = answer.ends;
        answer.write(stream)?;
        if is_last {
            return Ok(None);
        }
        received.drain(..length);
    }
    Ok(None)
}

/// Receives until the end of a head and returns its length; `None` if the browser leaves before.
fn receive_head(stream: &mut TcpStream, received: &mut Vec<u8>) -> io::Result<Option<usize>> {
    let deadline = Instant::now() + IDLE;
    loop {
        if let Some(end) = received.windows(4).position(|four| four == b"\r\n\r\n") {
            return Ok(Some(end + 4));
        }
        if received.len() > LONGEST_HEAD {
            Answer::refusal("431 Request Header Fields Too Large", "the request is too long")
                .write(stream)?;
            return Ok(None);
        }
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        let mut part = [0; 2048];
        match stream.read(&mut part)? {
            0 => return Ok(None),
            length => received.extend(&part[..length]),
        }
    }
}

/// What of a request's head counts.
struct Head {
    is_head_only: bool,
    path: String,
    host: Option<String>,
    origin: Option<String>,
    known_version: Option<String>,
    is_websocket: bool,
}

impl Head {
    fn read(bytes: &[u8]) -> Result<Self, Answer> {
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        let damaged = |_| Answer::refusal("400 Bad Request", "this is no request of a browser");
        request.parse(bytes).map_err(damaged)?;
        let is_head_only = match request.method {
            Some("GET") => false,
            Some("HEAD") => true,
            _ => return Err(Answer::refusal("405 Method Not Allowed", "files are only read here")),
        };
        let header = |name: &str| {
            let found = request.headers.iter().find(|header| header.name.eq_ignore_ascii_case(name))?;
            Some(std::str::from_utf8(found.value).ok()?.trim().to_owned())
        };
        let has_body = header("content-length").is_some_and(|length| length != "0");
        if has_body || header("transfer-encoding").is_some() {
            return Err(Answer::refusal("400 Bad Request", "a request with contents is not taken"));
        }
        let target = request.path.unwrap_or("/");
        Ok(Self {
            is_head_only,
            path: target.split_once('?').map_or(target, |(path, _)| path).to_owned(),
            host: header("host"),
            origin: header("origin"),
            known_version: header("if-none-match"),
            is_websocket: header("upgrade").is_some_and(|to| to.eq_ignore_ascii_case("websocket")),
        })
    }

    /// Admits requests under a name of this machine and from the page itself.
    fn check(&self, options: &PageOptions) -> Result<(), Answer> {
        let host = self.host.as_deref().unwrap_or_default();
        if !is_name_of_this_machine(host, options) {
            let text = "this name is not one of the page's: open it by its address, or add the name to `hosts` in [view]";
            return Err(Answer::refusal("421 Misdirected Request", text));
        }
        match self.origin.as_deref().map(|origin| origin.strip_prefix("http://")) {
            None => Ok(()),
            Some(Some(origin)) if origin.eq_ignore_ascii_case(host) => Ok(()),
            Some(_) => Err(Answer::refusal("403 Forbidden", "other pages may not use this server")),
        }
    }
}

fn is_name_of_this_machine(host: &str, options: &PageOptions) -> bool {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
        _ => (host, None),
    };
    if port.is_some_and(|port| port.parse::<u16>().is_err()) {
        return false;
    }
    let literal = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(name);
    literal.parse::<IpAddr>().is_ok()
        || name.eq_ignore_ascii_case("localhost")
        || options.hosts.iter().any(|known| known.eq_ignore_ascii_case(name))
}

struct Answer {
    status: &'static str,
    media_type: &'static str,
    version: Option<String>,
    body: std::borrow::Cow<'static, [u8]>,
    /// The body is not sent, only its length.
    is_head_only: bool,
    /// The connection ends with it.
    ends: bool,
}

impl Answer {
    fn refusal(status: &'static str, text: &str) -> Self {
        let body = format!("{text}\n").into_bytes().into();
        let media_type = "text/plain; charset=utf-8";
        Self { status, media_type, version: None, body, is_head_only: false, ends: true }
    }

    fn write(self, stream: &mut TcpStream) -> io::Result<()> {
        let mut head = format!("HTTP/1.1 {}\r\n{SECURITY}", self.status);
        // Writing to a string does not fail.
        if let Some(version) = &self.version {
            let _ = write!(head, "ETag: {version}\r\nCache-Control: no-cache\r\n");
        }
        if self.ends {
            head.push_str("Connection: close\r\n");
        }
        let _ =
            write!(head, "Content-Type: {}\r\nContent-Length: {}\r\n\r\n", self.media_type, self.body.len());
        stream.write_all(head.as_bytes())?;
        if !self.is_head_only { stream.write_all(&self.body) } else { Ok(()) }
    }
}

fn file(head: &Head, options: &PageOptions) -> Answer {
    let Some((body, media_type)) = files::find(&head.path, options) else {
        return Answer { ends: false, ..Answer::refusal("404 Not Found", "there is no such file") };
    };
    let mut hasher = DefaultHasher::new();
    body.hash(&mut hasher);
    let version = format!("\"{:016x}\"", hasher.finish());
    let is_known = head.known_version.as_deref() == Some(&version);
    let answer = Answer {
        status: "200 OK",
        media_type,
        version: Some(version),
        body,
        is_head_only: head.is_head_only,
        ends: false,
    };
    if is_known {
        return Answer { status: "304 Not Modified", is_head_only: true, ..answer };
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_machines_are_refused() {
        let options = PageOptions { hosts: vec!["robot.local".into()], ..PageOptions::default() };
        for name in [
            "localhost",
            "localhost:7373",
            "127.0.0.1:1",
            "192.168.0.5",
            "[::1]:7373",
            "[::1]",
            "Robot.local:80",
        ] {
            assert!(is_name_of_this_machine(name, &options), "{name}");
        }
        for name in [
            "",
            "evil.example",
            "localhost.evil.example",
            "evil.example:7373",
            "127.0.0.1.evil",
            "localhost:x",
            "[::1]x",
        ] {
            assert!(!is_name_of_this_machine(name, &options), "{name}");
        }
    }

    #[test]
    fn heads_are_read_and_damage_is_refused() {
        let read = |text: &str| Head::read(text.as_bytes());
        let head = read("GET /a.js?b=c HTTP/1.1\r\nHost: x\r\nUPGRADE: WebSocket\r\n\r\n");
        assert!(head.is_ok_and(|head| head.path == "/a.js"
            && head.is_websocket
            && head.host.as_deref() == Some("x")));
        for (text, status) in [
            ("POST / HTTP/1.1\r\n\r\n", "405"),
            ("GET / HTTP/1.1\r\nContent-Length: 5\r\n\r\n", "400"),
            ("nonsense\r\n\r\n", "400"),
            ("GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", "400"),
        ] {
            assert!(read(text).is_err_and(|answer| answer.status.starts_with(status)), "{text}");
        }
    }
}
