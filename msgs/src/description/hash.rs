//! The RIHS01 hash of a message, computed at compile time.
//!
//! # References
//! SHA-256, as a `const fn`: FIPS 180-4, 4.2.2, 5.1.1, 5.3.3 and 6.2.

use super::const_text::{compare, digits};
use super::{Description, Field};

/// A hash as text: `RIHS01_` and 64 hexadecimal digits.
pub struct Hash([u8; 71]);

impl Hash {
    /// The text.
    #[must_use]
    pub const fn as_str(&self) -> &str {
        match std::str::from_utf8(&self.0) {
            Ok(text) => text,
            Err(_) => panic!("digits are ASCII"),
        }
    }
}

/// The hash of a message with that name and these fields: SHA-256 over the JSON text of its description.
#[must_use]
pub const fn hash(type_name: &'static str, fields: &'static [Field]) -> Hash {
    let mut json = Json(Sha256::new());
    json.text("{\"type_description\": ");
    json.individual(type_name, fields);
    json.text(", \"referenced_type_descriptions\": [");
    let references = References::of(fields);
    let mut index = 0;
    while index < references.count {
        if let Some(nested) = references.descriptions[index] {
            json.text(if index == 0 { "" } else { ", " });
            json.individual(nested.type_name, nested.fields);
        }
        index += 1;
    }
    json.text("]}");
    in_hexadecimal(&json.0.finish())
}

const fn in_hexadecimal(digest: &[u8; 32]) -> Hash {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let mut text = *b"RIHS01_0000000000000000000000000000000000000000000000000000000000000000";
    let mut index = 0;
    while index < 32 {
        text[7 + 2 * index] = DIGITS[(digest[index] >> 4) as usize];
        text[8 + 2 * index] = DIGITS[(digest[index] & 15) as usize];
        index += 1;
    }
    Hash(text)
}

/// JSON with the spacing the hash depends on. Names are ASCII without quotes or backslashes, so it needs no
/// escapes.
struct Json(Sha256);

impl Json {
    const fn text(&mut self, text: &str) {
        self.0.push(text.as_bytes());
    }

    const fn number(&mut self, number: u64) {
        let (digits, count) = digits(number);
        self.0.push(digits.split_at(digits.len() - count).1);
    }

    const fn individual(&mut self, type_name: &str, fields: &[Field]) {
        self.text("{\"type_name\": \"");
        self.text(type_name);
        self.text("\", \"fields\": [");
        if fields.is_empty() {
            self.field("structure_needs_at_least_one_member", [3, 0, 0], "");
        }
        let mut index = 0;
        while index < fields.len() {
            let of = &fields[index].field_type;
            let nested = match fields[index].nested() {
                Some(nested) => nested.type_name,
                None => "",
            };
            self.text(if index == 0 { "" } else { ", " });
            self.field(
                fields[index].name,
                [of.type_id() as u64, of.capacity(), of.string_capacity()],
                nested,
            );
            index += 1;
        }
        self.text("]}");
    }

    const fn field(&mut self, name: &str, numbers: [u64; 3], nested_type_name: &str) {
        self.text("{\"name\": \"");
        self.text(name);
        self.text("\", \"type\": {\"type_id\": ");
        self.number(numbers[0]);
        self.text(", \"capacity\": ");
        self.number(numbers[1]);
        self.text(", \"string_capacity\": ");
        self.number(numbers[2]);
        self.text(", \"nested_type_name\": \"");
        self.text(nested_type_name);
        self.text("\"}}");
    }
}

/// The maximum number of message types that a message without a generated description may refer to.
const MOST_REFERENCES: usize = 256;

/// The messages that fields refer to, directly or indirectly, sorted by name.
struct References {
    descriptions: [Option<&'static Description>; MOST_REFERENCES],
    count: usize,
}

impl References {
    const fn of(fields: &'static [Field]) -> Self {
        let mut references = Self { descriptions: [None; MOST_REFERENCES], count: 0 };
        references.collect(fields);
        references
    }

    const fn collect(&mut self, fields: &'static [Field]) {
        let mut index = 0;
        while index < fields.len() {
            if let Some(nested) = fields[index].nested()
                && self.insert(nested)
            {
                self.collect(nested.fields);
            }
            index += 1;
        }
    }

    /// Returns whether it was new.
    const fn insert(&mut self, new: &'static Description) -> bool {
        let mut place = 0;
        while let Some(old) = self.descriptions[place] {
            match compare(new.type_name, old.type_name) {
                0 => return false,
                order if order < 0 => break,
                _ => place += 1,
            }
        }
        if self.count + 1 == MOST_REFERENCES {
            panic!("the message refers to more than 254 other message types");
        }
        let mut index = self.count;
        while index > place {
            self.descriptions[index] = self.descriptions[index - 1];
            index -= 1;
        }
        self.descriptions[place] = Some(new);
        self.count += 1;
        true
    }
}

/// The state of a hash computation.
pub(super) struct Sha256 {
    state: [u32; 8],
    block: [u8; 64],
    /// Total bytes; those after the last complete block are in `block`.
    length: usize,
}

impl Sha256 {
    pub const fn new() -> Self {
        Self { state: INITIAL, block: [0; 64], length: 0 }
    }

    /// Adds bytes.
    pub const fn push(&mut self, bytes: &[u8]) {
        let mut index = 0;
        while index < bytes.len() {
            self.block[self.length % 64] = bytes[index];
            self.length += 1;
            index += 1;
            if self.length.is_multiple_of(64) {
                self.compress();
            }
        }
    }

    /// Returns the hash of all bytes.
    pub const fn finish(mut self) -> [u8; 32] {
        let bits = (self.length as u64 * 8).to_be_bytes();
        self.push(&[0x80]);
        while self.length % 64 != 56 {
            self.push(&[0]);
        }
        self.push(&bits);
        let mut digest = [0; 32];
        let mut index = 0;
        while index < 32 {
            digest[index] = self.state[index / 4].to_be_bytes()[index % 4];
            index += 1;
        }
        digest
    }

    const fn compress(&mut self) {
        let mut schedule = [0_u32; 64];
        let mut t = 0;
        while t < 64 {
            schedule[t] = if t < 16 {
                let at = t * 4;
                u32::from_be_bytes([
                    self.block[at],
                    self.block[at + 1],
                    self.block[at + 2],
                    self.block[at + 3],
                ])
            } else {
                let (two, fifteen) = (schedule[t - 2], schedule[t - 15]);
                let small_1 = two.rotate_right(17) ^ two.rotate_right(19) ^ (two >> 10);
                let small_0 = fifteen.rotate_right(7) ^ fifteen.rotate_right(18) ^ (fifteen >> 3);
                small_1.wrapping_add(schedule[t - 7]).wrapping_add(small_0).wrapping_add(schedule[t - 16])
            };
            t += 1;
        }
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = self.state;
        let mut t = 0;
        while t < 64 {
            let large_1 = e.rotate_right(6) ^ e.rotate_right(11) ^ e.rotate_right(25);
            let choice = (e & f) ^ (!e & g);
            let first =
                h.wrapping_add(large_1).wrapping_add(choice).wrapping_add(K[t]).wrapping_add(schedule[t]);
            let large_0 = a.rotate_right(2) ^ a.rotate_right(13) ^ a.rotate_right(22);
            let majority = (a & b) ^ (a & c) ^ (b & c);
            let second = large_0.wrapping_add(majority);
            (h, g, f, e) = (g, f, e, d.wrapping_add(first));
            (d, c, b, a) = (c, b, a, first.wrapping_add(second));
            t += 1;
        }
        let mixed = [a, b, c, d, e, f, g, h];
        let mut index = 0;
        while index < 8 {
            self.state[index] = self.state[index].wrapping_add(mixed[index]);
            index += 1;
        }
    }
}

const INITIAL: [u32; 8] =
    [0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19];

#[rustfmt::skip]
const K: [u32; 64] = [
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
];

#[cfg(test)]
mod tests {
    use super::{Sha256, hash};
    use crate::Message;

    #[test]
    fn the_hash_of_every_type_is_the_one_it_was_generated_with() {
        macro_rules! check {
            ($($message:ty),* $(,)?) => {$(
                let computed = hash(<$message>::TYPE_NAME, <$message as Message>::FIELDS);
                assert_eq!(computed.as_str(), <$message>::TYPE_HASH, "{}", <$message>::TYPE_NAME);
            )*};
        }
        for_each_message!(check);
    }

    #[test]
    fn the_compiler_can_compute_it() {
        use crate::sensor_msgs::msg::PointCloud2;
        const HASH: super::Hash = hash(PointCloud2::TYPE_NAME, PointCloud2::FIELDS);
        assert_eq!(HASH.as_str(), PointCloud2::TYPE_HASH);
    }

    /// The examples of FIPS 180-4, and lengths around that of a block.
    #[test]
    fn published_hashes_are_reproduced() {
        for (message, hash) in [
            (Vec::new(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"),
            (b"abc".to_vec(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"),
            (
                b"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq".to_vec(),
                "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1",
            ),
            (vec![b'a'; 1_000_000], "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0"),
        ] {
            let mut sha = Sha256::new();
            sha.push(&message);
            let found: String = sha.finish().iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(found, hash, "{} bytes", message.len());
        }
    }
}
