//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::tcp::Tcp;
use crate::tcp_lines::TcpLines;
use crate::udp::Udp;
use crate::udp_lines::UdpLines;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    [
        Kind::device("tcp_lines", "lines of text on TCP, as topics", Tcp::default, TcpLines::new),
        Kind::device("udp_lines", "lines of text on UDP, as topics", Udp::default, UdpLines::new),
        #[cfg(feature = "mqtt")]
        Kind::device_with_interfaces(
            "mqtt",
            "topics of the robot on an MQTT broker, both ways, in JSON or CBOR",
            crate::mqtt::broker::Broker::default,
            crate::mqtt::Mqtt::new,
        )
        .with_files(&["password_file"]),
    ]
    .to_vec()
}
