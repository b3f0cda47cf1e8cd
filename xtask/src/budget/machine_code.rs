//! How much machine code a library or program is: the sizes of the sections of its object files that are
//! code.
//!
//! # References
//! - The archive format of System V and GNU, `ar(5)`.
//! - System V Application Binary Interface, ELF-64: file header and section headers.

use anyhow::{Context, bail};

/// Whether object files have the format that is read here.
pub(super) const IS_COUNTED: bool =
    cfg!(all(target_os = "linux", target_pointer_width = "64", target_endian = "little"));

const ARCHIVE: &[u8] = b"!<arch>\n";
const ELF: &[u8] = b"\x7fELF";
/// `SHF_EXECINSTR`
const IS_CODE: u64 = 4;

/// The bytes of machine code in an archive of object files, or in one object file.
pub(super) fn size(bytes: &[u8]) -> anyhow::Result<u64> {
    let Some(mut rest) = bytes.strip_prefix(ARCHIVE) else { return size_of_object(bytes) };
    let mut size = 0;
    while !rest.is_empty() {
        let (header, after) = rest.split_at_checked(60).context("a header of the archive is cut off")?;
        let length =
            std::str::from_utf8(&header[48..58]).ok().and_then(|text| text.trim().parse::<usize>().ok());
        let length = length.context("a length in the archive is no number")?;
        let member = after.get(..length).context("a member of the archive is cut off")?;
        // Others are indices and the metadata of the compiler.
        if member.starts_with(ELF) {
            size += size_of_object(member)?;
        }
        // Members begin at even positions.
        rest = after.get(length.next_multiple_of(2)..).unwrap_or_default();
    }
    Ok(size)
}

fn size_of_object(object: &[u8]) -> anyhow::Result<u64> {
    if !object.starts_with(ELF) {
        bail!("no ELF file");
    }
    let number = |at: u64, bytes: usize| {
        let at = usize::try_from(at).ok()?;
        let field = object.get(at..at.checked_add(bytes)?)?;
        Some(field.iter().rev().fold(0_u64, |number, byte| (number << 8) | u64::from(*byte)))
    };
    let read = || {
        let (table, each, count) = (number(0x28, 8)?, number(0x3a, 2)?, number(0x3c, 2)?);
        // The number of more than 65 279 sections is the size of the first one.
        let count = if count == 0 { number(table.checked_add(0x20)?, 8)? } else { count };
        let mut size = 0_u64;
        for index in 0..count {
            let section = table.checked_add(index.checked_mul(each)?)?;
            if number(section.checked_add(8)?, 8)? & IS_CODE != 0 {
                size = size.checked_add(number(section.checked_add(0x20)?, 8)?)?;
            }
        }
        Some(size)
    };
    read().context("the ELF file is damaged")
}

#[cfg(all(test, target_os = "linux", target_pointer_width = "64", target_endian = "little"))]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn an_archive_has_the_code_of_its_object_files() {
        let program = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        let code = size(&program).unwrap();
        assert!(code > 100_000 && code < program.len() as u64, "{code} of {}", program.len());
        let mut archive = ARCHIVE.to_vec();
        for member in [b"some metadata".as_slice(), &program, &program] {
            archive.extend(format!("{:<48}{:<10}`\n", "name/", member.len()).bytes());
            archive.extend(member);
            archive.resize(archive.len().next_multiple_of(2), b'\n');
        }
        assert_eq!(size(&archive).unwrap(), 2 * code);
        assert!(size(&archive[..archive.len() - 1000]).is_err());
        assert!(size(b"text").is_err());
    }
}
