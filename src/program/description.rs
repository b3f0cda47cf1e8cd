//! `downbeat description`

use std::path::Path;

use crate::modules::kinematics::{Robot, Root, to_mjcf};

pub(crate) fn mjcf(urdf: &Path, is_fixed: bool) -> anyhow::Result<()> {
    let root = if is_fixed { Root::Fixed } else { Root::Free };
    print!("{}", to_mjcf(&Robot::read(urdf)?, root)?);
    Ok(())
}
