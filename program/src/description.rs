//! `downbeat description`

use std::path::Path;

use downbeat_kinematics::{Robot, Root, to_mjcf};

pub(crate) fn mjcf(urdf: &Path, is_fixed: bool) -> anyhow::Result<()> {
    let root = if is_fixed { Root::Fixed } else { Root::Free };
    let robot = Robot::read(urdf)?;
    robot.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
    print!("{}", to_mjcf(&robot, root)?);
    Ok(())
}
