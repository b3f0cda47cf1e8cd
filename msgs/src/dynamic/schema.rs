//! Definition texts with their dependencies, as bags have them.

use downbeat_msgs_definitions::{Catalog, TypeName};

use super::TypeError;

/// What the messages made from services and actions contain, which definition texts of rosbag2 leave out.
const IMPLIED: [(&str, &str); 3] = [
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
    (
        "service_msgs/msg/ServiceEventInfo",
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n",
    ),
    ("unique_identifier_msgs/msg/UUID", "uint8[16] uuid\n"),
];

/// The definitions in a text in which `name` is the first.
pub(super) fn catalog_of(name: &TypeName, encoding: &str, text: &str) -> Result<Catalog, TypeError> {
    match encoding {
        "ros2msg" => ros2msg(name, text),
        _ => Err(TypeError::Encoding { name: name.clone(), encoding: encoding.into() }),
    }
}

/// Parts are separated by lines of `=`; each but the first begins with a line that says what it defines.
///
/// What `Catalog::definition_text` writes, and `rosbag2_cpp/message_definitions/local_message_definition_source.cpp`.
fn ros2msg(name: &TypeName, text: &str) -> Result<Catalog, TypeError> {
    let origin = format!("definition of {name}");
    let mut catalog = Catalog::new();
    let mut rest = text;
    let mut line = 1;
    let mut is_first = true;
    loop {
        let (section, next) = match separator(rest) {
            Some((start, end)) => (&rest[..start], Some(&rest[end..])),
            None => (rest, None),
        };
        // The line before a separator is ended twice.
        let section = if next.is_some() { section.strip_suffix('\n').unwrap_or(section) } else { section };
        if is_first {
            // The definition of a service begins with a separator.
            if !(section.is_empty() && next.is_some_and(begins_with_service)) {
                catalog.add_message(name.clone(), section, &origin)?;
            }
        } else {
            add_section(&mut catalog, name, section, line, &origin)?;
        }
        is_first = false;
        let Some(next) = next else {
            return add_implied(catalog);
        };
        line += rest[..rest.len() - next.len()].matches('\n').count();
        rest = next;
    }
}

/// Adds what a text may leave out, where it has left it out.
fn add_implied(mut catalog: Catalog) -> Result<Catalog, TypeError> {
    for (name, text) in IMPLIED {
        let name: TypeName = name.parse()?;
        if catalog.message(&name).is_err() {
            catalog.add_message(name, text, "implied")?;
        }
    }
    Ok(catalog)
}

fn add_section(
    catalog: &mut Catalog,
    name: &TypeName,
    section: &str,
    line: usize,
    origin: &str,
) -> Result<(), TypeError> {
    let (head, body) = section.split_once('\n').unwrap_or((section, ""));
    let head = head.trim_end();
    let unknown = || TypeError::Section { name: name.clone(), line, found: head.chars().take(80).collect() };
    let (kind, of) = head.split_once(": ").ok_or_else(unknown)?;
    match kind {
        "MSG" => {
            // Usually `package/Type`; some writers put the full name.
            let of = if of.contains("/msg/") { of.to_owned() } else { of.replacen('/', "/msg/", 1) };
            catalog.add_message(of.parse()?, body, &format!("{origin} ({of})"))?;
        }
        "SRV" => catalog.add_service(of.parse()?, body, &format!("{origin} ({of})"))?,
        _ => return Err(unknown()),
    }
    Ok(())
}

fn begins_with_service(text: &str) -> bool {
    text.starts_with("SRV: ")
}

/// Start and end of the first line that has nothing but 80 `=`.
fn separator(text: &str) -> Option<(usize, usize)> {
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let content = line.trim_end();
        if content.len() == 80 && content.bytes().all(|byte| byte == b'=') {
            return Some((start, start + line.len()));
        }
        start += line.len();
    }
    None
}
