//! Finds the packages to generate and those they refer to.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use downbeat_msgs_definitions::{Catalog, Element, Field, MessageDefinition, TypeName};

use super::environment::{Environment, has_interfaces, interface_folders};
use super::{BuildError, Request};
use crate::Error;

/// Definitions and their packages.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// All definitions.
    pub catalog: Catalog,
    /// The packages to generate.
    pub generated: BTreeSet<String>,
    /// The packages in `downbeat-msgs`.
    pub carried: BTreeSet<String>,
}

/// Reads the requested packages and those they refer to; calls `watch` with the dependencies in cargo's
/// format.
pub(super) fn collect(
    requests: &[Request],
    environment: &Environment,
    watch: &mut dyn FnMut(String),
) -> Result<Found, BuildError> {
    watch("rerun-if-env-changed=AMENT_PREFIX_PATH".into());
    let mut found = Found::default();
    for request in requests {
        match request {
            Request::Folder(folder) => found.add(folder, environment, watch)?,
            Request::Below(folder) => {
                watch_path(folder, watch);
                let packages = packages_below(folder)?;
                if packages.is_empty() {
                    return Err(BuildError::NoInterfaces { folder: folder.clone() });
                }
                for package in packages {
                    found.add(&package, environment, watch)?;
                }
            }
            Request::Installed(package) => {
                let folder = environment.installed(package).ok_or_else(|| BuildError::NotInstalled {
                    package: package.clone(),
                    searched: environment.ament_prefixes.clone(),
                })?;
                found.add(&folder, environment, watch)?;
            }
            Request::OtherVersion(folder) => found.add_version(folder, watch)?,
        }
    }
    while let Some((owner, field, wanted)) = found.missing_package() {
        if let Some(folder) = environment.carried(&wanted.package) {
            if !environment.enabled.contains(&wanted.package) {
                return Err(BuildError::Feature {
                    place: Box::new(field.place.clone()),
                    owner: Box::new(owner.name.clone()),
                    field: field.name.clone(),
                    wanted: Box::new(wanted.clone()),
                });
            }
            // Not watched: cargo runs the script again when downbeat-msgs changes.
            found.catalog.add_package(&folder)?;
            found.carried.insert(wanted.package);
        } else if let Some(folder) = environment.installed(&wanted.package) {
            found.add(&folder, environment, watch)?;
        } else {
            break; // The check of the catalog reports where it is referred to.
        }
    }
    Ok(found)
}

impl Found {
    fn add(
        &mut self,
        folder: &Path,
        environment: &Environment,
        watch: &mut dyn FnMut(String),
    ) -> Result<(), BuildError> {
        let package = Catalog::package_name(folder);
        if environment.enabled.contains(&package) {
            watch_package(folder, watch);
            return Err(BuildError::Carried { folder: folder.into(), package });
        }
        self.add_version(folder, watch)
    }

    /// Adds a package that `downbeat-msgs` may have too.
    fn add_version(&mut self, folder: &Path, watch: &mut dyn FnMut(String)) -> Result<(), BuildError> {
        watch_package(folder, watch);
        let package = Catalog::package_name(folder);
        if !has_interfaces(folder) || self.catalog.add_package(folder)? == 0 {
            return Err(BuildError::NoInterfaces { folder: folder.into() });
        }
        self.generated.insert(package);
        Ok(())
    }

    /// A type of an unknown package, and the field that refers to it.
    fn missing_package(&self) -> Option<(&MessageDefinition, &Field, TypeName)> {
        let known = self.catalog.packages();
        self.catalog
            .messages()
            .flat_map(|owner| owner.fields.iter().map(move |field| (owner, field)))
            .find_map(|(owner, field)| match &field.field_type.element {
                Element::Message(wanted) if known.binary_search(&wanted.package.as_str()).is_err() => {
                    Some((owner, field, wanted.clone()))
                }
                _ => None,
            })
    }
}

/// Watches for files that change, appear or disappear: cargo watches everything in a folder. Watching the
/// package's own folder detects new folders in it, but if that is the crate's folder, everything else in it
/// would be watched too.
fn watch_package(folder: &Path, watch: &mut dyn FnMut(String)) {
    let is_crate = folder.join("Cargo.toml").exists();
    if is_crate {
        interface_folders(folder).for_each(|folder| watch_path(&folder, watch));
    } else {
        watch_path(folder, watch);
    }
}

fn watch_path(path: &Path, watch: &mut dyn FnMut(String)) {
    watch(format!("rerun-if-changed={}", path.display()));
}

fn packages_below(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::Read { path: folder.into(), source };
    let mut packages = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if has_interfaces(&path) {
            packages.push(path);
        }
    }
    packages.sort();
    Ok(packages)
}
