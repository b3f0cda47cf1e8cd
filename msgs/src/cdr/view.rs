//! Reading without copying: views that borrow from the input.

use std::fmt;
use std::marker::PhantomData;

use super::plain::PlainReader;
use super::{Cdr, Count, Endianness, Plain, Reader, Result, Text};

/// A type that can be read from CDR: every [`Cdr`] type, and views, which borrow from the input.
///
/// The module `msg::view` of a package has the views of its messages. They have the same fields, in which
/// strings, bytes and sequences are not copied. Reading a view validates all of it, like reading the message.
///
/// ```
/// use downbeat_msgs::sensor_msgs::msg::{self, view};
/// use downbeat_msgs::cdr;
///
/// let image = msg::Image { width: 640, encoding: "rgb8".into(), data: vec![7; 1024], ..Default::default() };
/// let bytes = cdr::to_vec(&image);
///
/// let image: view::Image = cdr::from_slice(&bytes)?;
/// assert_eq!((image.width, image.encoding), (640, "rgb8"));
/// assert_eq!(image.data, &bytes[bytes.len() - 1024..]); // the same memory
/// # Ok::<(), cdr::Error>(())
/// ```
pub trait FromReader<'a>: Sized {
    /// See [`Cdr::LEAST_SIZE`].
    const FEWEST_BYTES: usize;

    /// See [`Cdr::IS_PRIMITIVE`].
    const IS_NUMBER_OR_BOOL: bool = false;

    /// Reads a value.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    fn from_reader(reader: &mut Reader<'a>) -> Result<Self>;
}

/// Relates a message to its view, for code that is generic over messages.
pub trait Viewed: Cdr {
    /// The view; the message itself if it has nothing to borrow.
    type View<'a>: FromReader<'a> + fmt::Debug;
}

impl<'a, T: Cdr> FromReader<'a> for T {
    const FEWEST_BYTES: usize = T::LEAST_SIZE;
    const IS_NUMBER_OR_BOOL: bool = T::IS_PRIMITIVE;

    #[inline]
    fn from_reader(reader: &mut Reader<'a>) -> Result<Self> {
        T::decode(reader)
    }
}

/// A `uint8[]`, borrowed from the input.
impl<'a> FromReader<'a> for &'a [u8] {
    const FEWEST_BYTES: usize = 4;

    #[inline]
    fn from_reader(reader: &mut Reader<'a>) -> Result<Self> {
        let length = reader.length(1)?;
        reader.bytes(length)
    }
}

/// A sequence of numbers that remains in the input, in either byte order and with any alignment.
///
/// ```
/// use downbeat_msgs::{cdr, sensor_msgs::msg::{self, view}};
///
/// let bytes = cdr::to_vec(&msg::JointState { position: vec![0.5, 0.25], ..Default::default() });
/// let state: view::JointState = cdr::from_slice(&bytes)?;
/// assert_eq!((state.position.len(), state.position.get(1)), (2, Some(0.25)));
/// assert_eq!(state.position.iter().sum::<f64>(), 0.75);
/// # Ok::<(), cdr::Error>(())
/// ```
#[derive(Clone, Copy)]
pub struct Numbers<'a, T> {
    bytes: &'a [u8],
    endianness: Endianness,
    number: PhantomData<T>,
}

impl<'a, T: Plain> Numbers<'a, T> {
    /// The number of elements.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / T::SIZE
    }

    /// Returns whether there are none.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The number at an index.
    #[inline]
    #[must_use]
    pub fn get(&self, index: usize) -> Option<T> {
        let start = index.checked_mul(T::SIZE)?;
        let bytes = self.bytes.get(start..)?.get(..T::SIZE)?;
        Some(read(bytes, self.endianness))
    }

    /// The numbers, one after another.
    #[inline]
    pub fn iter(&self) -> impl ExactSizeIterator<Item = T> + DoubleEndedIterator + use<'a, T> {
        let endianness = self.endianness;
        self.bytes.chunks_exact(T::SIZE).map(move |bytes| read(bytes, endianness))
    }

    /// A copy.
    #[must_use]
    pub fn to_vec(&self) -> Vec<T> {
        T::collect(self.bytes, self.endianness)
    }

    /// The bytes, in the order of [`Numbers::endianness`].
    #[inline]
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The order of the bytes of each number.
    #[inline]
    #[must_use]
    pub fn endianness(&self) -> Endianness {
        self.endianness
    }
}

impl<T: Plain + fmt::Debug> fmt::Debug for Numbers<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<'a, T: Plain + Cdr> FromReader<'a> for Numbers<'a, T> {
    const FEWEST_BYTES: usize = 4;

    #[inline]
    fn from_reader(reader: &mut Reader<'a>) -> Result<Self> {
        let count = reader.length(T::SIZE)?;
        let bytes = reader.numbers::<T>(count)?;
        Ok(Self { bytes, endianness: reader.endianness(), number: PhantomData })
    }
}

/// A sequence or array that remains in the input: its elements, which are views, are read during iteration.
///
/// ```
/// use downbeat_msgs::{cdr, sensor_msgs::msg::{self, view}};
///
/// let names = ["head_pan", "head_tilt"];
/// let bytes = cdr::to_vec(&msg::JointState { name: names.map(String::from).into(), ..Default::default() });
/// let state: view::JointState = cdr::from_slice(&bytes)?;
/// assert!(state.name.iter().eq(names));
/// # Ok::<(), cdr::Error>(())
/// ```
#[derive(Clone)]
pub struct Sequence<'a, V> {
    /// At the first element.
    start: Reader<'a>,
    count: usize,
    element: PhantomData<V>,
}

impl<'a, V: FromReader<'a>> Sequence<'a, V> {
    /// The number of elements.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are none.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The elements, one after another.
    pub fn iter(&self) -> impl Iterator<Item = V> + use<'a, V> {
        let mut reader = self.start.clone();
        // Each element was already read without an error, so the iterator does not end early.
        (0..self.count).map_while(move |_| V::from_reader(&mut reader).ok())
    }

    /// Reads the elements of an array.
    ///
    /// # Errors
    /// Returns an error if the bytes are not valid elements.
    pub fn of_array(count: usize, reader: &mut Reader<'a>) -> Result<Self> {
        reader.elements(V::IS_NUMBER_OR_BOOL, |reader| Self::read(count, reader))
    }

    fn read(count: usize, reader: &mut Reader<'a>) -> Result<Self> {
        let start = reader.clone();
        for index in 0..count {
            V::from_reader(reader).map_err(|error| error.at_index(index))?;
        }
        Ok(Self { start, count, element: PhantomData })
    }
}

impl<'a, V: FromReader<'a> + fmt::Debug> fmt::Debug for Sequence<'a, V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<'a, V: FromReader<'a>> FromReader<'a> for Sequence<'a, V> {
    const FEWEST_BYTES: usize = 4;

    fn from_reader(reader: &mut Reader<'a>) -> Result<Self> {
        reader.elements(V::IS_NUMBER_OR_BOOL, |reader| {
            let count = reader.length(V::FEWEST_BYTES)?;
            Self::read(count, reader)
        })
    }
}

impl<T: Plain> Count for Numbers<'_, T> {
    fn count(&self) -> usize {
        self.len()
    }
}

impl<'a, V: FromReader<'a>> Count for Sequence<'a, V> {
    fn count(&self) -> usize {
        self.len()
    }
}

impl<'a, V: FromReader<'a> + Text> Text for Sequence<'a, V> {
    fn longest(&self) -> usize {
        self.iter().map(|text| text.longest()).max().unwrap_or(0)
    }
}

#[inline]
fn read<T: Plain>(bytes: &[u8], endianness: Endianness) -> T {
    T::get(&mut PlainReader::new(bytes, endianness))
}
