//! `downbeat bag`

pub(super) mod play;
pub(super) mod record;

use std::path::Path;

use downbeat::bags::{BagInfo, Reader};

/// Prints what a bag holds, and on standard error what of it is lost.
pub(crate) fn info(bag: &Path) -> anyhow::Result<()> {
    let reader = Reader::open(bag)?;
    print!("{}", BagInfo::of(&reader)?);
    for truncation in reader.truncation() {
        eprintln!("downbeat: {truncation}");
    }
    Ok(())
}
