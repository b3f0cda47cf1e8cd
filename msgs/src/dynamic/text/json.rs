//! Messages as JSON: the feature `json`.

use super::{Stamps, TextError, without_stamps};
use crate::dynamic::{DynamicMessage, DynamicType};

impl DynamicMessage {
    /// The message as JSON, on one line, with the names and values that serde gives the struct of the same definition.
    /// What is not finite becomes `null`.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Keys are strings and nothing else can fail.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// A message from JSON: fields that are not named keep their defaults.
    ///
    /// # Errors
    /// As [`DynamicMessage::fill_json`]. Also if the text leaves times to the sender: there is no time to give them here.
    pub fn from_json(of: &DynamicType, json: &str) -> Result<Self, TextError> {
        let mut message = Self::new(of);
        let stamps = message.fill_json(json)?;
        without_stamps(&stamps, "JSON").map(|()| message)
    }

    /// Changes the fields that the JSON names. `null` is NaN where a number is wanted. Else as
    /// [`DynamicMessage::fill_yaml`].
    ///
    /// # Errors
    /// As [`DynamicMessage::fill_yaml`].
    pub fn fill_json(&mut self, json: &str) -> Result<Stamps, TextError> {
        let mut filled = self.clone();
        let mut deserializer = serde_json::Deserializer::from_str(json);
        let failed = |error: serde_json::Error, field| {
            TextError::new("JSON", error.line(), error.column(), &error, field)
        };
        let stamps = filled.fill_from(&mut deserializer).map_err(|(error, field)| failed(error, field))?;
        deserializer.end().map_err(|error| failed(error, None))?;
        *self = filled;
        Ok(stamps)
    }
}
