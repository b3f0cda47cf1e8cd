//! The definitions in this crate, for types known only at run time.

use std::sync::LazyLock;

use downbeat_msgs_definitions::{Catalog, Error, Kind, TypeName};

/// The name and text of every `.msg`, `.srv` and `.action` file in `interfaces/`.
const TEXTS: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/carried.rs"));

/// The definitions of all packages in `interfaces/`, regardless of features, parsed on first use.
///
/// ```
/// let catalog = downbeat_msgs::carried();
/// let header = catalog.message(&"std_msgs/msg/Header".parse()?)?;
/// assert_eq!(header.fields[1].name, "frame_id");
/// # Ok::<(), downbeat_msgs::definitions::Error>(())
/// ```
///
/// # Panics
/// Never: the texts were parsed when this crate was built.
pub fn carried() -> &'static Catalog {
    static CATALOG: LazyLock<Catalog> = LazyLock::new(|| {
        parse().unwrap_or_else(|error| panic!("the built-in definitions are invalid: {error}"))
    });
    &CATALOG
}

fn parse() -> Result<Catalog, Error> {
    let mut catalog = Catalog::new();
    for (name, text) in TEXTS {
        let of: TypeName = name.parse()?;
        match of.kind {
            Kind::Message => catalog.add_message(of, text, name)?,
            Kind::Service => catalog.add_service(of, text, name)?,
            Kind::Action => catalog.add_action(of, text, name)?,
        }
    }
    Ok(catalog)
}
