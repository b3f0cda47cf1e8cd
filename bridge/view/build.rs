//! Lists the files of the page, which the program carries.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let folder = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default()).join("page");
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut files = Vec::new();
    collect(&folder, "", &mut files)?;
    files.sort();
    let mut list = String::from("&[\n");
    for (name, path) in files {
        let _ = writeln!(list, "    ({name:?}, include_bytes!({path:?})),");
    }
    list.push_str("]\n");
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    fs::write(out.join("page_files.rs"), list)
}

/// Adds what browsers fetch of a folder and of the folders in it; tests end in `.mjs`.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let (path, name) = {
            let entry = entry?;
            (entry.path(), entry.file_name().to_string_lossy().into_owned())
        };
        if path.is_dir() {
            println!("cargo::rerun-if-changed={}", path.display());
            if name != "tests" {
                collect(&path, &format!("{prefix}{name}/"), files)?;
            }
        } else if ["html", "css", "js", "svg"].iter().any(|kind| path.extension() == Some(kind.as_ref())) {
            files.push((format!("{prefix}{name}"), path));
        }
    }
    Ok(())
}
