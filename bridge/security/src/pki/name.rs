//! Names of subjects and issuers as text (RFC 2253), as OpenSSL prints them.

use std::fmt::Write;

use der::{Encode, Tag};
use x509_cert::attr::AttributeTypeAndValue;
use x509_cert::name::Name;

/// Short names of the attributes, as OpenSSL has them. Others are written by number.
const SHORT_NAMES: [(&str, &str); 20] = [
    ("2.5.4.3", "CN"),
    ("2.5.4.4", "SN"),
    ("2.5.4.5", "serialNumber"),
    ("2.5.4.6", "C"),
    ("2.5.4.7", "L"),
    ("2.5.4.8", "ST"),
    ("2.5.4.9", "street"),
    ("2.5.4.10", "O"),
    ("2.5.4.11", "OU"),
    ("2.5.4.12", "title"),
    ("2.5.4.13", "description"),
    ("2.5.4.41", "name"),
    ("2.5.4.42", "GN"),
    ("2.5.4.43", "initials"),
    ("2.5.4.44", "generationQualifier"),
    ("2.5.4.46", "dnQualifier"),
    ("2.5.4.65", "pseudonym"),
    ("0.9.2342.19200300.100.1.25", "DC"),
    ("0.9.2342.19200300.100.1.1", "UID"),
    ("1.2.840.113549.1.9.1", "emailAddress"),
];

/// Writes `name` as `openssl x509 -nameopt RFC2253,-esc_msb` does: the last attribute first, special
/// characters escaped, letters beyond ASCII not. Peers write subjects so in identity tokens and compare them
/// so with permissions.
pub(super) fn text(name: &Name) -> String {
    let mut text = String::new();
    let sets: Vec<_> = name.iter_rdn().collect();
    for set in sets.into_iter().rev() {
        let attributes: Vec<_> = set.iter().collect();
        for (index, attribute) in attributes.into_iter().rev().enumerate() {
            if !text.is_empty() {
                text.push(if index == 0 { ',' } else { '+' });
            }
            write_attribute(&mut text, attribute);
        }
    }
    text
}

fn write_attribute(text: &mut String, attribute: &AttributeTypeAndValue) {
    let oid = attribute.oid.to_string();
    let short_name = SHORT_NAMES.iter().find(|(known, _)| *known == oid);
    text.push_str(short_name.map_or(&*oid, |(_, name)| name));
    text.push('=');
    match value(attribute) {
        Some(value) if short_name.is_some() => write_escaped(text, &value),
        _ => {
            text.push('#');
            let der = attribute.value.to_der().unwrap_or_default();
            der.iter().for_each(|byte| write_hex(text, *byte));
        }
    }
}

/// The value, or `None` if it is not a string.
fn value(attribute: &AttributeTypeAndValue) -> Option<String> {
    let bytes = attribute.value.value();
    match attribute.value.header().tag() {
        Tag::Utf8String => String::from_utf8(bytes.to_vec()).ok(),
        Tag::PrintableString
        | Tag::Ia5String
        | Tag::NumericString
        | Tag::VisibleString
        | Tag::TeletexString => Some(bytes.iter().copied().map(char::from).collect()),
        Tag::BmpString => {
            let (units, []) = bytes.as_chunks() else { return None };
            char::decode_utf16(units.iter().map(|unit| u16::from_be_bytes(*unit)))
                .collect::<Result<_, _>>()
                .ok()
        }
        _ => None,
    }
}

fn write_escaped(text: &mut String, value: &str) {
    let last = value.chars().count().saturating_sub(1);
    for (index, character) in value.chars().enumerate() {
        match character {
            ',' | '+' | '"' | '\\' | '<' | '>' | ';' => text.extend(['\\', character]),
            ' ' if index == 0 || index == last => text.push_str("\\ "),
            '#' if index == 0 => text.push_str("\\#"),
            '\0'..='\x1f' | '\x7f' => {
                text.push('\\');
                write_hex(text, character as u8);
            }
            _ => text.push(character),
        }
    }
}

fn write_hex(text: &mut String, byte: u8) {
    write!(text, "{byte:02X}").expect("writing to a string succeeds");
}

#[cfg(test)]
mod tests {
    use crate::pki::Certificate;
    use crate::pki::openssl::{Folder, Subject};

    #[test]
    fn names_are_written_as_openssl_writes_them() {
        let Some(folder) = Folder::new() else { return };
        let subjects = [
            "/CN=\\/talker_listener\\/talker",
            "/C=DE/ST=Hessen/O=Example, Inc./OU=a+b/CN=back\\\\slash",
            "/O=#hash/CN= both ends ",
            "/CN=<\"quoted\">;=",
            "/DC=org/DC=example/UID=7/CN=with mail/emailAddress=a@example.org",
            "/CN=Jürgen Größe",
            "/CN=one+OU=two/O=multi",
            "/CN=tab\there",
            "/2.5.4.97=not known here to us/CN=a",
        ];
        for subject in subjects {
            let name = Subject { name: subject, ..Subject::default() };
            let pem = folder.self_signed("name", &name);
            let printed = folder.run(&[
                "x509",
                "-in",
                "name.pem",
                "-noout",
                "-subject",
                "-nameopt",
                "RFC2253,-esc_msb",
            ]);
            let printed = String::from_utf8(printed).unwrap();
            let printed = printed.trim_end_matches('\n').strip_prefix("subject=").unwrap();
            let certificate = Certificate::from_pem(&pem).unwrap();
            // An attribute for which we have no short name is written by number, which is as unique.
            if !subject.contains("2.5.4.97") {
                assert_eq!(certificate.subject(), printed, "{subject}");
            }
            assert_eq!(certificate.subject(), certificate.issuer());
        }
    }
}
