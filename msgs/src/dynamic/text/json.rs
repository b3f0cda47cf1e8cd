//! Messages as JSON: the feature `json`.

use super::fill::Nothing;
use super::{Stamps, TextError, without_stamps};
use crate::dynamic::{DynamicMessage, DynamicType};

impl DynamicMessage {
    /// The message as JSON, on one line, with the names and values with which serde writes the struct of the
    /// same definition. Numbers that are not finite become `null`.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Keys are strings, so this cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Parses a message from JSON: missing fields keep their defaults.
    ///
    /// # Errors
    /// See [`DynamicMessage::fill_json`]. Also if the text asks for the time of sending, which is not known
    /// here.
    pub fn from_json(of: &DynamicType, json: &str) -> Result<Self, TextError> {
        let mut message = Self::new(of);
        let stamps = message.fill_json(json)?;
        without_stamps(&stamps, "JSON").map(|()| message)
    }

    /// Sets the fields in the JSON text. `null` is NaN for a number. Otherwise like
    /// [`DynamicMessage::fill_yaml`].
    ///
    /// # Errors
    /// See [`DynamicMessage::fill_yaml`].
    pub fn fill_json(&mut self, json: &str) -> Result<Stamps, TextError> {
        let mut filled = self.clone();
        let mut deserializer = serde_json::Deserializer::from_str(json);
        let failed = |error: serde_json::Error, field| {
            TextError::new("JSON", error.line(), error.column(), &error, field)
        };
        let stamps = filled
            .fill_from(&mut deserializer, Nothing::IsNan)
            .map_err(|(error, field)| failed(error, field))?;
        deserializer.end().map_err(|error| failed(error, None))?;
        *self = filled;
        Ok(stamps)
    }
}
