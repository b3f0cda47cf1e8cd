//! Generates the types of px4_msgs in `interfaces/`, a module for each release of PX4.
//!
//! Most definitions are the same from one release to the next. A message that means the same as in the next
//! release, and so has the same bytes and hash, is the Rust type of that release: 219 definitions are 112
//! types.

use std::collections::BTreeSet;
use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use downbeat_msgs_definitions::{Element, MessageDefinition, Value};
use downbeat_msgs_generator::{Catalog, Modules, RustSource, TypeName};

const PACKAGE: &str = "px4_msgs";

/// The newest first: each one shares types with the one before it.
const RELEASES: [&str; 4] = ["1.17", "1.16", "1.15", "1.14"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=interfaces");
    let out =
        PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: cargo sets it for build scripts")?);
    let mut source = String::new();
    let mut newer: Option<(&str, Catalog)> = None;
    for release in RELEASES {
        let mut catalog = Catalog::new();
        catalog.add_package(&Path::new("interfaces").join(release).join(PACKAGE))?;
        catalog.check()?;
        let shared = newer.as_ref().map(|(_, newer)| shared(&catalog, newer)).unwrap_or_default();
        source.push_str(&module(release, &catalog, newer.as_ref().map(|(name, _)| *name), &shared)?);
        newer = Some((release, catalog));
    }
    fs::write(out.join("releases.rs"), source)?;
    Ok(())
}

/// The messages that are the same in the next release, with all that they contain and all that contains them.
fn shared(catalog: &Catalog, newer: &Catalog) -> BTreeSet<TypeName> {
    let mut shared: BTreeSet<TypeName> = catalog
        .messages()
        .filter(|message| newer.message(&message.name).is_ok_and(|other| means_the_same(message, other)))
        .map(|message| message.name.clone())
        .collect();
    // Generated types refer to types of their own release only.
    loop {
        let before = shared.len();
        for message in catalog.messages() {
            let parts: Vec<&TypeName> = parts(message).collect();
            if shared.contains(&message.name) {
                if parts.iter().any(|part| !shared.contains(part)) {
                    shared.remove(&message.name);
                }
            } else {
                for part in parts {
                    shared.remove(part);
                }
            }
        }
        if shared.len() == before {
            return shared;
        }
    }
}

fn parts(message: &MessageDefinition) -> impl Iterator<Item = &TypeName> {
    message.fields.iter().filter_map(|field| match &field.field_type.element {
        Element::Message(name) => Some(name),
        _ => None,
    })
}

/// Whether two releases have the same message. Without a constant for its version it has version 0.
fn means_the_same(one: &MessageDefinition, two: &MessageDefinition) -> bool {
    let without_version_0 = |message: &MessageDefinition| {
        let mut message = message.clone();
        message
            .constants
            .retain(|constant| !(constant.name == "MESSAGE_VERSION" && constant.value == Value::Integer(0)));
        message
    };
    without_version_0(one).means_the_same_as(&without_version_0(two))
}

/// The module of a release: the types that differ from the next one, all types under their names, and the set
/// of them.
fn module(
    release: &str,
    catalog: &Catalog,
    newer: Option<&str>,
    shared: &BTreeSet<TypeName>,
) -> Result<String, Box<dyn Error>> {
    let mut own = Catalog::new();
    for message in catalog.messages().filter(|message| !shared.contains(&message.name)) {
        own.add_alone_from(catalog, &message.name)?;
    }
    own.check()?;
    let modules = Modules::new("::downbeat_msgs", "super::super");
    let mut source = format!(
        "/// px4_msgs of PX4 {release}.\npub mod {} {{\nmod own {{\n{}}}\n/// The messages.\npub mod msg {{\n",
        path(release),
        RustSource::new(&own, &modules).module(PACKAGE)?,
    );
    for name in own.messages().map(|message| &message.name) {
        writeln!(source, "pub use super::own::{PACKAGE}::msg::{};", name.name)?;
    }
    let newer = path(newer.unwrap_or_default());
    for name in shared {
        writeln!(source, "pub use super::super::{newer}::msg::{};", name.name)?;
    }
    writeln!(
        source,
        "}}\n/// All messages of the release, to register them.\n#[derive(Clone, Copy, Debug)]\npub struct INTERFACES;\n\
         impl ::downbeat_msgs::InterfaceSet for INTERFACES {{\n\
         fn visit(&self, visitor: &mut impl ::downbeat_msgs::InterfaceVisitor) {{"
    )?;
    for message in catalog.messages() {
        writeln!(source, "visitor.message::<msg::{}>();", message.name.name)?;
    }
    source.push_str("}\n}\n/// The versions of the messages, by name, without those that are 0.\n");
    source.push_str("pub(crate) const MESSAGE_VERSIONS: &[(&str, u32)] = &[\n");
    for message in catalog.messages() {
        let version = message.constants.iter().find(|constant| constant.name == "MESSAGE_VERSION");
        if let Some(Value::Integer(version)) = version.map(|constant| &constant.value)
            && *version != 0
        {
            writeln!(source, "({:?}, {version}),", message.name.name)?;
        }
    }
    source.push_str("];\n}\n");
    Ok(source)
}

fn path(release: &str) -> String {
    format!("v{}", release.replace('.', "_"))
}
