//! Parses the names of interfaces.

use std::str::FromStr;

use crate::{Error, Kind, TypeName};

impl FromStr for TypeName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let mut parts = text.split('/');
        let (package, kind, name) = (parts.next(), parts.next(), parts.next());
        let Some(kind) = Kind::ALL.into_iter().find(|of| kind == Some(of.as_str())) else {
            return Err(Error::Name(text.into()));
        };
        let name = match (package, name, parts.next()) {
            (Some(package), Some(name), None) => Self::checked(package, kind, name),
            _ => None,
        };
        name.ok_or_else(|| Error::Name(text.into()))
    }
}
