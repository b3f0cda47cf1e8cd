//! Serde for arrays longer than 32 elements, which serde itself does not support: `#[serde(with =
//! "large_array")]`.
//!
//! They are written as tuples, like shorter arrays.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Writes an array.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer, T: Serialize, const N: usize>(
    array: &[T; N],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut tuple = serializer.serialize_tuple(N)?;
    for element in array {
        tuple.serialize_element(element)?;
    }
    tuple.end()
}

/// Reads an array.
///
/// # Errors
/// Those of the deserializer, and if there are not exactly `N` elements.
pub fn deserialize<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(
    deserializer: D,
) -> Result<[T; N], D::Error> {
    deserializer.deserialize_tuple(N, ArrayVisitor(PhantomData))
}

struct ArrayVisitor<T, const N: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for ArrayVisitor<T, N> {
    type Value = [T; N];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array of {N} elements")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<[T; N], A::Error> {
        let mut elements = Vec::with_capacity(N);
        while let Some(element) = sequence.next_element()? {
            if elements.len() == N {
                return Err(A::Error::invalid_length(N + 1, &self));
            }
            elements.push(element);
        }
        let found = elements.len();
        elements.try_into().map_err(|_| A::Error::invalid_length(found, &self))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::geometry_msgs::msg::PoseWithCovariance;

    #[test]
    fn an_array_of_36_goes_through_json_and_back() {
        let mut pose = PoseWithCovariance::default();
        pose.covariance[35] = 0.5;
        let json = serde_json::to_string(&pose).unwrap();
        assert_eq!(serde_json::from_str::<PoseWithCovariance>(&json).unwrap(), pose);
    }

    #[test]
    fn an_array_of_another_length_is_refused() {
        for length in [35, 37] {
            let json = serde_json::json!({ "covariance": vec![0.0; length] });
            let error = serde_json::from_value::<PoseWithCovariance>(json).unwrap_err().to_string();
            assert!(error.contains("an array of 36 elements"), "{error}");
        }
    }
}
