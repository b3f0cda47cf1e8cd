//! Blocks of PEM files (RFC 7468), which may have other text around them.

use der::zeroize::Zeroizing;

use super::PkiError;

/// Longer than any certificate and key, and room for some thousand revoked certificates.
const MAX_LEN: usize = 256 * 1024;

pub(super) struct Block<'a> {
    pub(super) label: &'static str,
    /// From its first to its last line, as in the file.
    text: &'a str,
    /// Of its first line in the file, from 1.
    line: usize,
}

/// Finds the only block with one of `labels`; the first of them is named if there is none.
pub(super) fn find<'a>(file: &'a [u8], labels: &[&'static str]) -> Result<Block<'a>, PkiError> {
    if file.len() > MAX_LEN {
        return Err(PkiError::TooLong { length: file.len(), limit: MAX_LEN });
    }
    let missing = PkiError::NoBlock { expected: labels.first().copied().unwrap_or_default() };
    let Ok(file) = std::str::from_utf8(file) else { return Err(missing) };
    let mut found: Option<Block<'a>> = None;
    // The label, the first line and the offset of a block whose end has not been read.
    let mut open: Option<(&'static str, usize, usize)> = None;
    let mut offset = 0;
    for (index, line) in file.split_inclusive('\n').enumerate() {
        let (start, line_number) = (offset, index + 1);
        offset += line.len();
        let line = line.trim_end();
        let label = |begin| {
            let label = line.strip_prefix(begin)?.strip_suffix("-----")?;
            labels.iter().find(|known| **known == label).copied()
        };
        if let Some(label) = label("-----BEGIN ") {
            if found.is_some() {
                return Err(PkiError::SecondBlock { label, line: line_number });
            }
            open = Some((label, line_number, start));
        }
        if let (Some(label), Some((begun, line, start))) = (label("-----END "), open)
            && label == begun
        {
            let text = file.get(start..offset).unwrap_or_default();
            found = Some(Block { label, text, line });
            open = None;
        }
    }
    match open {
        Some((label, line, _)) => Err(PkiError::Pem { label, line }),
        None => found.ok_or(missing),
    }
}

impl Block<'_> {
    pub(super) fn text(&self) -> &[u8] {
        self.text.as_bytes()
    }

    pub(super) fn der(&self) -> Result<Zeroizing<Vec<u8>>, PkiError> {
        let damaged = |_| PkiError::Pem { label: self.label, line: self.line };
        let (_, document) = der::SecretDocument::from_pem(self.text).map_err(damaged)?;
        Ok(document.to_bytes())
    }
}
