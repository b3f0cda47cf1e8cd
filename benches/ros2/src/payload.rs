//! The message that all contestants send: bytes that begin with the number of the message.

use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

/// Size of the number; no message is shorter.
pub const NUMBER_BYTES: usize = 8;

/// A message of `size` bytes, not counting its envelope.
pub fn message(number: u64, size: usize) -> UInt8MultiArray {
    let mut data = vec![0x5a; size.max(NUMBER_BYTES)];
    data[..NUMBER_BYTES].copy_from_slice(&number.to_le_bytes());
    UInt8MultiArray { data, ..UInt8MultiArray::default() }
}

/// The number of a message, if it has one.
pub fn number(message: &UInt8MultiArray) -> Option<u64> {
    message.data.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
}
