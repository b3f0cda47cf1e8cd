//! The two parts of a signed message (RFC 8551, multipart/signed): a text, and its signature in base64.

use der::pem::{self, LineEnding};

use super::SmimeError;

/// A message of two parts.
pub(super) struct Parts {
    /// The first part with the line ends that are signed.
    pub text: Vec<u8>,
    /// The content of the second part.
    pub signature: Vec<u8>,
}

pub(super) fn split(document: &[u8]) -> Result<Parts, SmimeError> {
    let (header, body) = head(document).ok_or(SmimeError::NotSigned)?;
    let content_type = field(&header, "content-type").ok_or(SmimeError::NotSigned)?;
    let kind = content_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match &*kind {
        "multipart/signed" => {}
        "application/pkcs7-mime" | "application/x-pkcs7-mime" => return Err(SmimeError::Opaque),
        _ => return Err(SmimeError::NotSigned),
    }
    let boundary = parameter(&content_type, "boundary").ok_or(SmimeError::NoBoundary)?;
    let parts = between(body, &format!("--{boundary}")).ok_or(SmimeError::CutOff)?;
    let [text, signature] = &parts[..] else { return Err(SmimeError::CutOff) };
    let signature = signature.join(&b'\n');
    let (header, base64) = head(&signature).ok_or(SmimeError::SignaturePart)?;
    let encoding = field(&header, "content-transfer-encoding").unwrap_or_default();
    if !encoding.eq_ignore_ascii_case("base64") {
        return Err(SmimeError::SignaturePart);
    }
    let signature = decode(base64).ok_or(SmimeError::SignaturePart)?;
    Ok(Parts { text: text.join(&b"\r\n"[..]), signature })
}

/// The lines of the two parts, without their ends. `None` if the message has no end, or other parts.
fn between<'a>(body: &'a [u8], delimiter: &str) -> Option<Vec<Vec<&'a [u8]>>> {
    let mut parts: Vec<Vec<&[u8]>> = Vec::new();
    for line in body.split(|byte| *byte == b'\n') {
        let line = trim_end(line, b"\r");
        let after = line.strip_prefix(delimiter.as_bytes()).map(|after| trim_end(after, b" \t"));
        match after {
            Some(b"--") => return Some(parts),
            Some(b"") if parts.len() < 2 => parts.push(Vec::new()),
            Some(b"") => return None,
            _ => {
                if let Some(part) = parts.last_mut() {
                    part.push(line);
                }
            }
        }
    }
    None
}

/// The lines of a header, with continuations joined, and what follows the empty line after it.
fn head(part: &[u8]) -> Option<(Vec<String>, &[u8])> {
    let mut lines: Vec<String> = Vec::new();
    let mut rest = part;
    loop {
        let end = rest.iter().position(|byte| *byte == b'\n')?;
        let (line, after) = rest.split_at_checked(end)?;
        rest = after.get(1..)?;
        let line = std::str::from_utf8(trim_end(line, b"\r \t")).ok()?;
        match lines.last_mut() {
            _ if line.is_empty() => return Some((lines, rest)),
            Some(last) if line.starts_with([' ', '\t']) => last.push_str(line),
            _ => lines.push(line.to_owned()),
        }
    }
}

fn field(header: &[String], name: &str) -> Option<String> {
    let mut fields = header.iter().filter_map(|line| line.split_once(':'));
    let (_, value) = fields.find(|(field, _)| field.trim().eq_ignore_ascii_case(name))?;
    Some(value.trim().to_owned())
}

/// A parameter of a field, with or without quotation marks.
fn parameter(field: &str, name: &str) -> Option<String> {
    let mut rest = field.split_once(';')?.1;
    loop {
        let (key, value) = rest.split_once('=')?;
        let value = value.trim_start();
        let (value, after) = match value.strip_prefix('"') {
            Some(quoted) => quoted.split_once('"')?,
            None => value.split_at(value.find(';').unwrap_or(value.len())),
        };
        if key.trim().eq_ignore_ascii_case(name) {
            let value = value.trim();
            return (!value.is_empty()).then(|| value.to_owned());
        }
        rest = after.split_once(';')?.1;
    }
}

/// The text of a part that is signed, without its own header, which says `text/plain`.
pub(super) fn content(part: &[u8]) -> Result<&[u8], SmimeError> {
    if part.trim_ascii_start().starts_with(b"<") {
        return Ok(part.trim_ascii_start());
    }
    let (header, content) = head(part).ok_or(SmimeError::TextPart)?;
    let content_type = field(&header, "content-type").unwrap_or_default().to_ascii_lowercase();
    if content_type.split(';').next().map(str::trim) != Some("text/plain") {
        return Err(SmimeError::TextPart);
    }
    Ok(content)
}

/// The part that is signed for a text.
pub(super) fn text_part(content: &[u8]) -> Vec<u8> {
    let lines: Vec<&[u8]> = content.split(|byte| *byte == b'\n').map(|line| trim_end(line, b"\r")).collect();
    [&b"Content-Type: text/plain\r\n\r\n"[..], &lines.join(&b"\r\n"[..])].concat()
}

/// A whole message; `boundary` must be in no line of the text.
pub(super) fn join(part: &[u8], signature: &[u8], boundary: &str) -> Vec<u8> {
    let head = format!(
        "MIME-Version: 1.0\r\nContent-Type: multipart/signed; protocol=\"application/x-pkcs7-signature\"; \
         micalg=\"sha-256\"; boundary=\"{boundary}\"\r\n\r\nThis is an S/MIME signed message\r\n\r\n\
         --{boundary}\r\n"
    );
    let between = format!(
        "\r\n--{boundary}\r\nContent-Type: application/x-pkcs7-signature; name=\"smime.p7s\"\r\n\
         Content-Transfer-Encoding: base64\r\nContent-Disposition: attachment; filename=\"smime.p7s\"\r\n\r\n"
    );
    let end = format!("\r\n--{boundary}--\r\n");
    let signature = encode(signature);
    [head.as_bytes(), part, between.as_bytes(), signature.as_bytes(), end.as_bytes()].concat()
}

const LABEL: &str = "PKCS7";

/// In lines of 64 characters, each of which ends.
fn encode(bytes: &[u8]) -> String {
    let pem = pem::encode_string(LABEL, LineEnding::CRLF, bytes).unwrap_or_default();
    pem.split_inclusive('\n').filter(|line| !line.starts_with('-')).collect()
}

/// Lines may have any length.
fn decode(base64: &[u8]) -> Option<Vec<u8>> {
    let digits: Vec<u8> = base64.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect();
    let lines: Vec<&[u8]> = digits.chunks(64).collect();
    let begin = format!("-----BEGIN {LABEL}-----\n");
    let end = format!("\n-----END {LABEL}-----\n");
    let pem = [begin.as_bytes(), &lines.join(&b'\n'), end.as_bytes()].concat();
    pem::decode_vec(&pem).ok().map(|(_, bytes)| bytes)
}

fn trim_end<'a>(mut line: &'a [u8], characters: &[u8]) -> &'a [u8] {
    while let Some((last, rest)) = line.split_last()
        && characters.contains(last)
    {
        line = rest;
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_split_into_what_it_was_joined_of() {
        for content in ["<dds>\n</dds>\n", "<dds/>", "<dds>\r\n\r\n</dds>\r\n"] {
            for length in [1, 47, 48, 49, 500] {
                let signature: Vec<u8> = (0..=255).cycle().take(length).collect();
                let message = join(&text_part(content.as_bytes()), &signature, "b=");
                let parts = split(&message).unwrap();
                assert_eq!(parts.signature, signature);
                let text = String::from_utf8(super::content(&parts.text).unwrap().to_vec()).unwrap();
                assert_eq!(text.replace("\r\n", "\n"), content.replace("\r\n", "\n"));
            }
        }
    }

    #[test]
    fn line_ends_and_folded_headers_make_no_difference() {
        let message = join(&text_part(b"<dds>\n</dds>"), b"signature", "b");
        let message = String::from_utf8(message).unwrap();
        let unix = message.replace("\r\n", "\n");
        let folded = unix.replace("; boundary=\"b\"", ";\n boundary=b");
        for other in [unix, folded] {
            let parts = split(other.as_bytes()).unwrap();
            assert_eq!(parts.text, text_part(b"<dds>\n</dds>"));
            assert_eq!(parts.signature, b"signature");
        }
    }
}
