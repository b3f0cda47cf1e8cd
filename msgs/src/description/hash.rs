//! The RIHS01 hash of a message, computed at compile time.

use super::sha256::Sha256;
use super::text::{compare, digits};
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

/// JSON with the spacing the hash depends on. Names are ASCII without quotes or backslashes, so it needs no escapes.
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
            let nested = match of.nested {
                Some(nested) => nested.type_name,
                None => "",
            };
            self.text(if index == 0 { "" } else { ", " });
            self.field(fields[index].name, [of.type_id() as u64, of.capacity(), of.string_capacity], nested);
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
            if let Some(nested) = fields[index].field_type.nested
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

#[cfg(test)]
mod tests {
    use super::hash;
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
}
