//! Writes the Rust types of the packages in `interfaces/` whose features are enabled, and for the tests those
//! of a package in `tests/data/`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{env, fs};

use downbeat_msgs_generator::{Catalog, Modules, RustSource};

/// Packages that the crate itself and every generated service or action refer to; included regardless of
/// features.
const ALWAYS: [&str; 4] =
    ["builtin_interfaces", "service_msgs", "type_description_interfaces", "unique_identifier_msgs"];

fn main() -> Result<(), Box<dyn Error>> {
    // A package from the registry has no tests; a path that is missing would make cargo build it each time.
    let for_tests = Path::new("tests/data/odd_msgs");
    let for_tests = Some(for_tests).filter(|package| package.exists());
    for path in [Path::new("build.rs"), Path::new("interfaces")].into_iter().chain(for_tests) {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    let out =
        PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: cargo sets it for build scripts")?);
    let interfaces = env::current_dir()?.join("interfaces");

    let mut catalog = Catalog::new();
    for package in enabled_packages(&interfaces)? {
        catalog.add_package(&Path::new("interfaces").join(package))?;
    }
    catalog.check().map_err(|error| {
        format!("{error}\nIn Cargo.toml the feature of a package has to enable those of the packages it refers to.")
    })?;
    let packages = catalog.packages();
    let here = Modules::new("crate", "crate");
    let source = RustSource::new(&catalog, &here);
    for package in &packages {
        fs::write(out.join(format!("{package}.rs")), source.package(package)?)?;
    }
    fs::write(
        out.join("interfaces.rs"),
        source.index(&packages) + &source.interface_set(&packages) + &source.registry(&packages),
    )?;
    fs::write(out.join("carried.rs"), carried_texts(&interfaces)?)?;

    // Read by `downbeat_msgs_generator::Build` in the build scripts of other crates.
    println!("cargo::metadata=interfaces={}", interfaces.display());
    println!("cargo::metadata=packages={}", packages.join(","));

    // The types of a user's package: the tests, which enable all features, include it like another crate.
    if let Some(package) = for_tests.filter(|_| env::var_os("CARGO_FEATURE_ALL").is_some()) {
        let mut theirs = catalog.clone();
        theirs.add_package(package)?;
        theirs.check()?;
        let modules = Modules::new("::downbeat_msgs", "crate")
            .with_packages("::downbeat_msgs", packages.iter().copied());
        fs::write(out.join("odd_msgs.rs"), RustSource::new(&theirs, &modules).package("odd_msgs")?)?;
    }
    Ok(())
}

/// The folders of `interfaces/` that are always included or whose feature is enabled.
fn enabled_packages(interfaces: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let mut packages = all_packages(interfaces)?;
    packages.retain(|package| {
        let feature = format!("CARGO_FEATURE_{}", package.to_uppercase());
        ALWAYS.contains(&package.as_str()) || env::var_os(feature).is_some()
    });
    Ok(packages)
}

/// Rust source that maps names to the texts in `interfaces/`, for all packages: for types known only at run
/// time.
fn carried_texts(interfaces: &Path) -> Result<String, Box<dyn Error>> {
    let mut source = String::from("&[\n");
    for package in all_packages(interfaces)? {
        for kind in sorted_entries(&interfaces.join(&package))? {
            for file in sorted_entries(&interfaces.join(&package).join(&kind))? {
                let path = interfaces.join(&package).join(&kind).join(&file);
                let name = file.strip_suffix(&format!(".{kind}")).unwrap_or(&file);
                source.push_str(&format!("    (\"{package}/{kind}/{name}\", include_str!({path:?})),\n"));
            }
        }
    }
    Ok(source + "]\n")
}

/// The folders of `interfaces/`, which also holds a README.
fn all_packages(interfaces: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let mut packages = sorted_entries(interfaces)?;
    packages.retain(|entry| interfaces.join(entry).is_dir());
    Ok(packages)
}

fn sorted_entries(folder: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder)? {
        names.push(entry?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
