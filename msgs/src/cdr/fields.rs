//! Reading the fields of a message: errors name the field, and bounds are checked.

use super::{Count, FromReader, Problem, Reader, Result, Sequence, Text};

impl<'a> Reader<'a> {
    /// Reads a value; errors name the field.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    #[inline]
    pub fn field<T: FromReader<'a>>(&mut self, name: &'static str) -> Result<T> {
        T::from_reader(self).map_err(|error| error.in_field(name))
    }

    /// Like [`Reader::field`], for a sequence of at most `bound` elements.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn bounded_field<T: FromReader<'a> + Count>(
        &mut self,
        name: &'static str,
        bound: usize,
    ) -> Result<T> {
        self.bounded(bound, T::count).map_err(|error| error.in_field(name))
    }

    /// Like [`Reader::field`], for strings of at most `bound` bytes (wide strings: UTF-16 code units), alone
    /// or several.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn text_field<T: FromReader<'a> + Text>(&mut self, name: &'static str, bound: usize) -> Result<T> {
        self.bounded(bound, T::longest).map_err(|error| error.in_field(name))
    }

    /// Like [`Reader::field`], for a sequence of at most `bound` strings, each of at most `text_bound` as in
    /// [`Reader::text_field`].
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn bounded_texts_field<T: FromReader<'a> + Count + Text>(
        &mut self,
        name: &'static str,
        bound: usize,
        text_bound: usize,
    ) -> Result<T> {
        let start = self.clone();
        self.bounded_field(name, bound).and_then(|texts| {
            start.check(texts, text_bound, T::longest).map_err(|error| error.in_field(name))
        })
    }

    /// Like [`Reader::field`], for the view of an array.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn array_field<V: FromReader<'a>>(
        &mut self,
        name: &'static str,
        count: usize,
    ) -> Result<Sequence<'a, V>> {
        Sequence::of_array(count, self).map_err(|error| error.in_field(name))
    }

    /// Like [`Reader::array_field`], for strings as in [`Reader::text_field`].
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn texts_array_field<V: FromReader<'a> + Text>(
        &mut self,
        name: &'static str,
        count: usize,
        text_bound: usize,
    ) -> Result<Sequence<'a, V>> {
        let start = self.clone();
        let texts = Sequence::of_array(count, self);
        texts
            .and_then(|texts| start.check(texts, text_bound, Text::longest))
            .map_err(|error| error.in_field(name))
    }

    fn bounded<T: FromReader<'a>>(&mut self, bound: usize, measure: fn(&T) -> usize) -> Result<T> {
        let start = self.clone();
        let value = T::from_reader(self)?;
        start.check(value, bound, measure)
    }

    fn check<T>(&self, value: T, bound: usize, measure: fn(&T) -> usize) -> Result<T> {
        match measure(&value) {
            found if found > bound => Err(self.error(Problem::Bound { found, bound })),
            _ => Ok(value),
        }
    }
}
