//! Definitions from folders.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use downbeat_files::{lines, user_file};

use super::Catalog;
use crate::{Error, Kind, Place, TypeName};

/// No definition is larger than this; a larger file is something else.
const LARGEST_FILE: u64 = 16 << 20;

/// What was found in an ament prefix.
#[derive(Debug)]
#[non_exhaustive]
pub struct AmentPrefix {
    /// How many files were read.
    pub files: usize,
    /// Why other files were left out: they are invalid, or the catalog already has a different definition of
    /// the type.
    pub faults: Vec<Error>,
}

impl Catalog {
    /// Adds the interfaces of one package: `<folder>/msg/*.msg`, `<folder>/srv/*.srv` and
    /// `<folder>/action/*.action`, and the `.idl` files in these folders beside which there is no such file.
    /// The package's name is that of [`Catalog::package_name`]. Returns how many files were read.
    ///
    /// # Errors
    /// Returns an error if a file cannot be read or parsed. A folder without interfaces is no error.
    pub fn add_package(&mut self, folder: &Path) -> Result<usize, Error> {
        let package = Self::package_name(folder);
        let mut count = 0;
        for kind in Kind::ALL {
            for file in interface_files(&folder.join(kind.as_str()), kind)? {
                self.add_file(&package, kind, &file)?;
                count += 1;
            }
        }
        Ok(count)
    }

    /// The name of the package in a folder: that in its `package.xml`, as for colcon, else that of the
    /// folder.
    #[must_use]
    pub fn package_name(folder: &Path) -> String {
        let manifest = read(&folder.join("package.xml")).unwrap_or_default();
        name_in_manifest(&manifest).map_or_else(|| name_of(folder), str::to_owned)
    }

    /// Adds every package below a folder of packages. Returns how many files were read.
    ///
    /// # Errors
    /// See [`Catalog::add_package`].
    pub fn add_packages(&mut self, folder: &Path) -> Result<usize, Error> {
        let mut count = 0;
        for package in packages_in(folder)? {
            count += self.add_package(&package)?;
        }
        Ok(count)
    }

    /// Adds the interfaces in a folder: of a package, of an ament prefix, or of all packages below it, as in
    /// the folder `src` of a workspace. Hidden folders and those with a file `COLCON_IGNORE` are left out.
    /// Returns how many files were read.
    ///
    /// # Errors
    /// See [`Catalog::add_package`]; also if the folder has no interfaces, or two packages of one name.
    pub fn add_folder(&mut self, folder: &Path) -> Result<usize, Error> {
        let mut count = 0;
        for package in Self::packages_below(folder)?.values() {
            count += self.add_package(package)?;
        }
        if count == 0 { Err(Error::NoInterfaces(folder.into())) } else { Ok(count) }
    }

    /// The folders of the packages with interfaces that [`Catalog::add_folder`] adds, by the names of the
    /// packages.
    ///
    /// # Errors
    /// Returns an error if a folder cannot be read, or two packages have one name.
    pub fn packages_below(folder: &Path) -> Result<BTreeMap<String, PathBuf>, Error> {
        // What follows `.` is no name of a package.
        let folder = &folder.canonicalize().map_err(|source| Error::Read { path: folder.into(), source })?;
        let installed = folder.join("share");
        let mut packages = BTreeMap::new();
        find_packages(if installed.is_dir() { &installed } else { folder }, DEPTH, &mut packages)?;
        Ok(packages)
    }

    /// Adds the interfaces of every package installed below an ament prefix, such as `/opt/ros/jazzy` or a
    /// workspace's `install/my_msgs`: those in `share/*/{msg,srv,action}`, from `.msg`, `.srv` and `.action`
    /// files, and from the `.idl` file if there is no such file.
    ///
    /// An invalid file does not prevent reading the others; it is reported in the result, since a prefix may
    /// contain packages that the program never needs.
    ///
    /// # Errors
    /// [`Error::Read`] if there is no folder `share`.
    pub fn add_ament_prefix(&mut self, prefix: &Path) -> Result<AmentPrefix, Error> {
        let mut found = AmentPrefix { files: 0, faults: Vec::new() };
        for folder in packages_in(&prefix.join("share"))? {
            for kind in Kind::ALL {
                match self.add_installed(&folder, kind, &mut found) {
                    Ok(()) => {}
                    Err(fault) => found.faults.push(fault),
                }
            }
        }
        Ok(found)
    }

    /// The interfaces of one kind of an installed package.
    fn add_installed(&mut self, folder: &Path, kind: Kind, found: &mut AmentPrefix) -> Result<(), Error> {
        let package = Self::package_name(folder);
        for file in interface_files(&folder.join(kind.as_str()), kind)? {
            match self.add_file(&package, kind, &file) {
                Ok(()) => found.files += 1,
                Err(fault) => found.faults.push(fault),
            }
        }
        Ok(())
    }

    fn add_file(&mut self, package: &str, kind: Kind, file: &Path) -> Result<(), Error> {
        if file.extension().is_some_and(|extension| extension == "idl") {
            return self.add_idl(&read(file)?, &file.display().to_string()).map(|_| ());
        }
        let name: TypeName =
            format!("{package}/{}/{}", kind.as_str(), name_of(&file.with_extension(""))).parse()?;
        let text = read(file)?;
        let origin = file.display().to_string();
        match kind {
            Kind::Message => self.add_message(name, &text, &origin),
            Kind::Service => self.add_service(name, &text, &origin),
            Kind::Action => self.add_action(name, &text, &origin),
        }
    }
}

fn read(file: &Path) -> Result<String, Error> {
    let failed = |source| Error::Read { path: file.into(), source };
    let bytes = user_file::read_within(file, LARGEST_FILE).map_err(failed)?;
    String::from_utf8(bytes).map_err(|error| {
        let valid = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
        let line = valid.rsplit('\n').next().unwrap_or_default();
        let place = Place {
            origin: file.display().to_string(),
            line: lines::line_of(&*valid, valid.len()),
            column: line.chars().count() + 1,
        };
        Error::Syntax { place, message: "invalid UTF-8 from here on: save the file as UTF-8".into() }
    })
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The first `<name>` of a `package.xml` that is no comment.
fn name_in_manifest(mut text: &str) -> Option<&str> {
    loop {
        let tag = text.find("<name>")?;
        match text.find("<!--") {
            Some(comment) if comment < tag => {
                text = &text[comment..];
                text = &text[text.find("-->")?..];
            }
            _ => {
                let (name, _) = text[tag + "<name>".len()..].split_once("</name>")?;
                return Some(name.trim()).filter(|name| !name.is_empty());
            }
        }
    }
}

/// How deep packages may lie in a workspace.
const DEPTH: u32 = 8;

/// Finds the packages in a folder, by name.
fn find_packages(folder: &Path, depth: u32, found: &mut BTreeMap<String, PathBuf>) -> Result<(), Error> {
    // Headers that were generated from a package lie in folders of the same names.
    let mut is_package = false;
    for kind in Kind::ALL {
        is_package |= !interface_files(&folder.join(kind.as_str()), kind)?.is_empty();
    }
    if is_package {
        let package = Catalog::package_name(folder);
        return match found.insert(package.clone(), folder.to_owned()) {
            Some(first) => Err(Error::TwoPackages { package, first, second: folder.to_owned() }),
            None => Ok(()),
        };
    }
    for inner in packages_in(folder)? {
        let is_left_out = name_of(&inner).starts_with('.') || inner.join("COLCON_IGNORE").exists();
        // A link could lead back here.
        if depth > 0 && !is_left_out && !inner.is_symlink() {
            find_packages(&inner, depth - 1, found)?;
        }
    }
    Ok(())
}

fn packages_in(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut packages = sorted_entries(folder)?;
    packages.retain(|entry| entry.is_dir());
    Ok(packages)
}

/// The files that define interfaces of that kind. `rosidl` generates an `.idl` file beside each other one,
/// which says the same.
fn interface_files(folder: &Path, kind: Kind) -> Result<Vec<PathBuf>, Error> {
    let mut files = files_with_extension(folder, kind.as_str())?;
    let mut idl = files_with_extension(folder, "idl")?;
    idl.retain(|file| files.binary_search(&file.with_extension(kind.as_str())).is_err());
    files.append(&mut idl);
    Ok(files)
}

fn files_with_extension(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, Error> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut files = sorted_entries(folder)?;
    files.retain(|file| file.extension().is_some_and(|found| found == extension));
    Ok(files)
}

/// Sorted, so that the same folder gives the same output everywhere.
fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::Read { path: folder.into(), source };
    let mut entries = fs::read_dir(folder)
        .map_err(failed)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    entries.sort();
    Ok(entries)
}
