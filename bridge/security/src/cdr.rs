//! Values of tokens in CDR, in both byte orders: numbers, strings and sequences of bytes.

/// Byte order of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// As all hashed and signed values are.
    Big,
    /// As most messages are.
    Little,
}

/// Why bytes are not a token or a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// The bytes end within a value.
    #[error("{field} goes beyond the end of the message")]
    Truncated {
        /// The value.
        field: &'static str,
    },
    /// A string is not UTF-8, or has no terminator, or has one within.
    #[error("{field} is not a valid string")]
    String {
        /// The string.
        field: &'static str,
    },
    /// A sequence has more elements than any peer sends.
    #[error("{count} {field} are too many, the limit is {limit}")]
    TooMany {
        /// What the sequence holds.
        field: &'static str,
        /// How many it declares.
        count: u32,
        /// How many are accepted.
        limit: u32,
    },
    /// The bytes are longer than any message of a peer.
    #[error("{length} bytes are too many for a message, the limit is {limit}")]
    TooLong {
        /// How many there are.
        length: usize,
        /// How many are accepted.
        limit: usize,
    },
    /// The first bytes do not say that plain CDR follows.
    #[error("the message is not in CDR encapsulation")]
    Encapsulation,
    /// More bytes than padding follow the last value.
    #[error("{count} bytes follow the end of the message")]
    Trailing {
        /// How many.
        count: usize,
    },
}

/// Reads values one after the other. Alignment counts from the first byte.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    position: usize,
    order: ByteOrder,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8], order: ByteOrder) -> Self {
        Self { bytes, position: 0, order }
    }

    pub(crate) fn take(&mut self, length: usize, field: &'static str) -> Result<&'a [u8], Malformed> {
        let end = self.position.checked_add(length);
        let taken = end.and_then(|end| self.bytes.get(self.position..end));
        let taken = taken.ok_or(Malformed::Truncated { field })?;
        self.position += length;
        Ok(taken)
    }

    pub(crate) fn array<const LENGTH: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<[u8; LENGTH], Malformed> {
        self.take(LENGTH, field)?.try_into().map_err(|_| Malformed::Truncated { field })
    }

    fn align(&mut self, to: usize) {
        self.position = self.position.next_multiple_of(to);
    }

    pub(crate) fn u32(&mut self, field: &'static str) -> Result<u32, Malformed> {
        self.align(4);
        let bytes = self.array(field)?;
        Ok(match self.order {
            ByteOrder::Big => u32::from_be_bytes(bytes),
            ByteOrder::Little => u32::from_le_bytes(bytes),
        })
    }

    pub(crate) fn i64(&mut self, field: &'static str) -> Result<i64, Malformed> {
        self.align(8);
        let bytes = self.array(field)?;
        Ok(match self.order {
            ByteOrder::Big => i64::from_be_bytes(bytes),
            ByteOrder::Little => i64::from_le_bytes(bytes),
        })
    }

    pub(crate) fn octets(&mut self, field: &'static str) -> Result<&'a [u8], Malformed> {
        let length = self.u32(field)?;
        self.take(usize::try_from(length).unwrap_or(usize::MAX), field)
    }

    pub(crate) fn string(&mut self, field: &'static str) -> Result<&'a str, Malformed> {
        let invalid = Malformed::String { field };
        let [text @ .., 0] = self.octets(field)? else { return Err(invalid) };
        match std::str::from_utf8(text) {
            Ok(text) if !text.contains('\0') => Ok(text),
            _ => Err(invalid),
        }
    }

    /// Reads the number of elements of a sequence.
    pub(crate) fn count(&mut self, field: &'static str, limit: u32) -> Result<u32, Malformed> {
        match self.u32(field)? {
            count if count > limit => Err(Malformed::TooMany { field, count, limit }),
            count => Ok(count),
        }
    }

    /// Checks that at most padding is left.
    pub(crate) fn finish(self) -> Result<(), Malformed> {
        match self.bytes.len().saturating_sub(self.position) {
            0..4 => Ok(()),
            count => Err(Malformed::Trailing { count }),
        }
    }
}

/// Appends values. Alignment counts from where it begins.
#[derive(Debug)]
pub(crate) struct Writer<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    order: ByteOrder,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(out: &'a mut Vec<u8>, order: ByteOrder) -> Self {
        Self { start: out.len(), out, order }
    }

    pub(crate) fn align(&mut self, to: usize) {
        let length = (self.out.len() - self.start).next_multiple_of(to);
        self.out.resize(self.start + length, 0);
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.out.extend_from_slice(bytes);
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes(&match self.order {
            ByteOrder::Big => value.to_be_bytes(),
            ByteOrder::Little => value.to_le_bytes(),
        });
    }

    pub(crate) fn i64(&mut self, value: i64) {
        self.align(8);
        self.bytes(&match self.order {
            ByteOrder::Big => value.to_be_bytes(),
            ByteOrder::Little => value.to_le_bytes(),
        });
    }

    /// Appends the length of a sequence.
    ///
    /// # Panics
    /// Panics if it has more than 2³² elements.
    pub(crate) fn count(&mut self, count: usize) {
        self.u32(u32::try_from(count).expect("a sequence below 4 GB"));
    }

    pub(crate) fn octets(&mut self, bytes: &[u8]) {
        self.count(bytes.len());
        self.bytes(bytes);
    }

    pub(crate) fn string(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.bytes(text.as_bytes());
        self.bytes(&[0]);
    }
}
