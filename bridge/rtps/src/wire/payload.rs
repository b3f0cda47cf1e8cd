//! The content of samples.

/// The content of a sample, with the four bytes of its encapsulation in front.
///
/// On the wire a payload is padded to a multiple of four bytes. The last two bits of the encapsulation hold
/// the length of the padding (DDS-XTypes 1.3, section 7.6.3.1.2), which is removed on reception. Fast DDS
/// does not set these bits, so up to three bytes of padding may remain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload<'a> {
    /// No payload; the inline QoS is the content.
    None,
    /// A sample.
    Data(&'a [u8]),
    /// Only the key of an instance.
    Key(&'a [u8]),
}
