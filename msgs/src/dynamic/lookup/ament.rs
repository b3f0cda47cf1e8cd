//! Definitions in the files of installed ROS 2 packages.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use downbeat_msgs_definitions::{Catalog, Error, Kind, TypeName};

use super::{DefinitionSource, Found};

/// No definition is larger than this; a larger file is something else.
const LARGEST_FILE: u64 = 16 << 20;

/// Ament prefixes: `/opt/ros/jazzy`, `install/my_msgs`. The first one that contains the file of a type is
/// used, as in ROS 2.
#[derive(Clone, Debug)]
pub struct AmentPrefixPath {
    name: String,
    prefixes: Vec<PathBuf>,
}

impl AmentPrefixPath {
    /// Searches these prefixes, each with a folder `share` of packages.
    #[must_use]
    pub fn new(prefixes: impl IntoIterator<Item = PathBuf>) -> Self {
        Self { name: "the ament prefixes".into(), prefixes: prefixes.into_iter().collect() }
    }

    /// The prefixes in the environment variable `AMENT_PREFIX_PATH`, which sourcing a workspace sets.
    #[must_use]
    pub fn from_environment() -> Self {
        let path = std::env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
        let prefixes = std::env::split_paths(&path).filter(|prefix| !prefix.as_os_str().is_empty());
        Self { name: "AMENT_PREFIX_PATH".into(), prefixes: prefixes.collect() }
    }
}

impl DefinitionSource for AmentPrefixPath {
    fn description(&self) -> String {
        self.name.clone()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, Error> {
        // The name becomes a path, so it must be a valid name.
        let name: TypeName = name.to_string().parse()?;
        let kind = name.kind.as_str();
        // A message of a service or an action is defined in the file of the latter.
        let stem = match name.kind {
            Kind::Message => name.name.as_str(),
            _ => name.name.split('_').next().unwrap_or_default(),
        };
        for prefix in &self.prefixes {
            let folder = prefix.join("share").join(&name.package).join(kind);
            for extension in [kind, "idl"] {
                let file = folder.join(stem).with_extension(extension);
                if let Some(text) = read(&file)? {
                    return definition(&name, stem, extension, &text, &file);
                }
            }
        }
        Ok(Found::Nothing(match self.prefixes.as_slice() {
            [] => "it is empty: no workspace is sourced".into(),
            prefixes => {
                let folders: Vec<String> =
                    prefixes.iter().map(|prefix| prefix.display().to_string()).collect();
                format!("no share/{}/{kind}/{stem}.{kind} or .idl in {}", name.package, folders.join(", "))
            }
        }))
    }
}

fn definition(
    name: &TypeName,
    stem: &str,
    extension: &str,
    text: &str,
    file: &Path,
) -> Result<Found<'static>, Error> {
    let origin = file.display().to_string();
    let mut catalog = Catalog::new();
    let whole = TypeName::new(&name.package, name.kind, stem);
    match (extension, name.kind) {
        ("idl", _) => {
            catalog.add_idl(text, &origin)?;
        }
        (_, Kind::Message) => catalog.add_message(whole, text, &origin)?,
        (_, Kind::Service) => catalog.add_service(whole, text, &origin)?,
        (_, Kind::Action) => catalog.add_action(whole, text, &origin)?,
    }
    // The file may define something else, or lack the part.
    catalog.message(name)?;
    Ok(Found::Alone(Box::new(catalog)))
}

/// The text of a file; `None` if there is no such file.
fn read(file: &Path) -> Result<Option<String>, Error> {
    let failed = |source| Error::Read { path: file.into(), source };
    let open = match File::open(file) {
        Ok(open) => open,
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(None);
        }
        Err(error) => return Err(failed(error)),
    };
    let mut text = String::new();
    open.take(LARGEST_FILE + 1).read_to_string(&mut text).map_err(failed)?;
    if text.len() as u64 > LARGEST_FILE {
        return Err(failed(io::Error::other(format!("it has more than {LARGEST_FILE} bytes"))));
    }
    Ok(Some(text))
}
