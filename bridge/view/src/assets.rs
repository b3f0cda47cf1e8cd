//! Files that viewers fetch, such as the meshes of a robot description: only those inside known folders.

use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

/// The folders of packages.
pub(crate) struct Assets {
    packages: Vec<(String, PathBuf)>,
    /// Installed packages are in `share/<name>` of these.
    prefixes: Vec<PathBuf>,
    most_bytes: u64,
}

impl Assets {
    pub(crate) fn new(packages: Vec<(String, PathBuf)>, prefixes: Vec<PathBuf>, most_bytes: u64) -> Self {
        Self { packages, prefixes, most_bytes }
    }

    /// The prefixes in `AMENT_PREFIX_PATH`.
    pub(crate) fn ament_prefixes() -> Vec<PathBuf> {
        let path = std::env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
        std::env::split_paths(&path).filter(|prefix| !prefix.as_os_str().is_empty()).collect()
    }

    /// The contents of the file behind `package://NAME/PATH`: a robot description, a mesh or a picture. Other
    /// files of the folder may hold secrets, such as the token in a robot file.
    ///
    /// # Errors
    /// In words for the viewer, without paths of this machine, if there is no such file in the folder of the
    /// package.
    pub(crate) fn read(&self, uri: &str) -> Result<Vec<u8>, String> {
        let expected = || format!("{uri}: expected package://NAME/PATH");
        let (package, path) =
            uri.strip_prefix("package://").and_then(|rest| rest.split_once('/')).ok_or_else(expected)?;
        let is_plain = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let path = unescaped(path).ok_or_else(expected)?;
        let (package, path) = (Path::new(package), Path::new(&path));
        if !is_plain(package) || package.components().count() != 1 || !is_plain(path) {
            return Err(format!("{uri} leaves the folder of its package"));
        }
        let extension = path.extension().and_then(OsStr::to_str).unwrap_or_default().to_ascii_lowercase();
        if !EXTENSIONS.contains(&extension.as_str()) {
            return Err(format!("{uri} is no robot description, mesh or picture: {}", EXTENSIONS.join(", ")));
        }
        let given = self.packages.iter().filter(|(name, _)| Path::new(name) == package);
        let given = given.map(|(_, folder)| folder.clone());
        let installed = self.prefixes.iter().map(|prefix| prefix.join("share").join(package));
        let mut folders: Vec<_> =
            given.chain(installed).filter_map(|folder| folder.canonicalize().ok()).collect();
        folders.dedup();
        if folders.is_empty() {
            return Err(format!(
                "{uri}: no package \"{}\" is known; name its folder in the options of the viewer, or source its workspace \
                 (AMENT_PREFIX_PATH)",
                package.display()
            ));
        }
        let missing = || format!("{uri}: the package has no such file");
        let found = folders.iter().find_map(|folder| {
            // Links are followed, and must not lead out of the folder.
            let file = folder.join(path).canonicalize().ok()?;
            file.starts_with(folder).then_some(file)
        });
        let file = found.ok_or_else(missing)?;
        let about = file.metadata().map_err(|_| missing())?;
        if !about.is_file() {
            return Err(missing());
        }
        if about.len() > self.most_bytes {
            return Err(format!("{uri} has {} bytes, and at most {} are sent", about.len(), self.most_bytes));
        }
        std::fs::read(&file).map_err(|error| format!("{uri} cannot be read: {}", error.kind()))
    }
}

/// Those that `foxglove_bridge` sends, and what glTF refers to.
const EXTENSIONS: [&str; 16] = [
    "bin", "dae", "fbx", "glb", "gltf", "jpeg", "jpg", "mtl", "obj", "png", "stl", "tif", "tiff", "urdf",
    "webp", "xacro",
];

/// Replaces `%20` and the like; `None` if that is no UTF-8 text.
fn unescaped(path: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(path.len());
    let mut rest = path.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        rest = after;
        if first == b'%' {
            let digits = std::str::from_utf8(rest.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &rest[2..];
        } else {
            bytes.push(first);
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;

    fn assets() -> (tempfile::TempDir, Assets) {
        let root = tempfile::tempdir().unwrap();
        let package = root.path().join("package");
        fs::create_dir_all(package.join("meshes")).unwrap();
        fs::create_dir_all(root.path().join("prefix/share/installed")).unwrap();
        fs::write(package.join("meshes/arm 1.stl"), "arm").unwrap();
        fs::write(package.join("large.stl"), vec![0; 101]).unwrap();
        fs::write(root.path().join("secret.stl"), "secret").unwrap();
        fs::write(package.join("robot.toml"), "token").unwrap();
        fs::write(root.path().join("prefix/share/installed/a.dae"), "leg").unwrap();
        let assets = Assets::new(vec![("robot".into(), package)], vec![root.path().join("prefix")], 100);
        (root, assets)
    }

    #[test]
    fn files_of_packages_are_found() {
        let (_root, assets) = assets();
        assert_eq!(assets.read("package://robot/meshes/arm 1.stl").unwrap(), b"arm");
        assert_eq!(assets.read("package://robot/meshes/arm%201.stl").unwrap(), b"arm");
        assert_eq!(assets.read("package://installed/a.dae").unwrap(), b"leg");
    }

    #[test]
    fn no_path_leaves_the_folder() {
        let (root, assets) = assets();
        let absolute = format!("package://robot/{}", root.path().join("secret.stl").display());
        for uri in [
            "package://robot/../secret.stl",
            "package://robot/%2e%2e/secret.stl",
            "package://robot/meshes/../../secret.stl",
            "package://robot/..%2Fsecret.stl",
            "package://robot//etc/passwd",
            "package://../secret.stl",
            "package://./secret.stl",
            "package:///secret.stl",
            absolute.as_str(),
            "file:///etc/passwd",
            "/etc/passwd",
            "http://example.org/a.stl",
            "package://robot",
            "package://robot/%zz",
            "package://robot/%",
            "package://robot/",
            "package://robot/meshes",
            "package://robot/robot.toml",
            "package://robot/no.stl",
            "package://unknown/no.stl",
        ] {
            let error = assets.read(uri).unwrap_err();
            assert!(error.contains(uri), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_link_out_of_the_folder_is_not_followed() {
        let (root, assets) = assets();
        std::os::unix::fs::symlink(root.path().join("secret.stl"), root.path().join("package/link.stl"))
            .unwrap();
        std::os::unix::fs::symlink("meshes", root.path().join("package/inside")).unwrap();
        assert!(assets.read("package://robot/link.stl").unwrap_err().contains("no such file"));
        assert_eq!(assets.read("package://robot/inside/arm 1.stl").unwrap(), b"arm");
    }

    #[test]
    fn a_large_file_is_refused_with_its_size() {
        let (_root, assets) = assets();
        assert!(assets.read("package://robot/large.stl").unwrap_err().contains("101 bytes"));
    }
}
