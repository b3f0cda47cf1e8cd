//! `downbeat new`
//!
//! The templates are whole projects named `my_robot` that depend on `/checkout`; both are replaced.

mod name;
mod origin;
mod template;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use name::Name;
use origin::Origin;
pub(crate) use template::Template;

#[derive(Args)]
pub(crate) struct NewArguments {
    /// The folder to create. Its last part is the name of the project: lower-case letters, digits and
    /// underscores, like names of ROS 2 packages.
    #[arg(value_name = "NAME")]
    pub(crate) folder: PathBuf,
    /// The kind of project.
    #[arg(long, value_enum, default_value_t = Template::Robot)]
    pub(crate) template: Template,
    /// Depend on downbeat in this git repository, instead of the folder that this program was built from.
    #[arg(long, value_name = "URL", requires = "rev")]
    pub(crate) git: Option<String>,
    /// The revision in that repository.
    #[arg(long, value_name = "REV", requires = "git")]
    pub(crate) rev: Option<String>,
    /// Write into a folder that is not empty: files of the template replace existing ones, others are kept.
    #[arg(long)]
    pub(crate) force: bool,
}

pub(crate) fn new(arguments: &NewArguments) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    let name = Name::of_folder(folder)?;
    let origin = match (&arguments.git, &arguments.rev) {
        (Some(url), Some(revision)) => Origin::git(url, revision),
        _ => Origin::checkout()?,
    };
    if !arguments.force {
        check_empty(folder)?;
    }
    for (path, content) in arguments.template.files() {
        let path = folder.join(name.put_into(path));
        match std::str::from_utf8(content) {
            Ok(text) => write(&path, origin.put_into(&name.put_into(text)).as_bytes())?,
            Err(_) => write(&path, content)?, // a bag file
        }
    }
    for (path, content) in origin.files()? {
        write(&folder.join(path), content.as_bytes())?;
    }
    println!("{} is ready. Next:\n", folder.display());
    println!("    cd {}", folder.display());
    arguments.template.commands().iter().for_each(|command| println!("    {command}"));
    Ok(())
}

fn check_empty(folder: &Path) -> anyhow::Result<()> {
    let shown = folder.display();
    match fs::read_dir(folder).map(|mut entries| entries.next()) {
        Ok(Some(_)) => {
            bail!(
                "{shown} exists already and is not empty; choose another name, or write into it with --force"
            )
        }
        Ok(None) => Ok(()),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error).with_context(|| format!("cannot create the folder {shown}")),
    }
}

fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    fs::write(path, content).with_context(|| format!("cannot write {}", path.display()))
}
