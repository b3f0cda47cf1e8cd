//! Writes the Rust types of every package in `interfaces/`, and for the tests those of a package in `tests/data/`.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use downbeat_msgs_generator::{Catalog, Modules, RustSource};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=interfaces");
    println!("cargo::rerun-if-changed=tests/data");
    let out = env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: cargo sets it for build scripts")?;
    let out = Path::new(&out);

    let mut catalog = Catalog::new();
    catalog.add_packages(Path::new("interfaces"))?;
    catalog.check()?;
    let packages = catalog.packages();
    let here = Modules::new("crate", "crate");
    let source = RustSource::new(&catalog, &here);
    for package in &packages {
        fs::write(out.join(format!("{package}.rs")), source.package(package)?)?;
    }
    fs::write(out.join("interfaces.rs"), source.index(&packages) + &source.registry(&packages))?;

    // What users' own packages become: the tests include them as another crate would.
    let mut theirs = catalog.clone();
    theirs.add_package(Path::new("tests/data/odd_msgs"))?;
    theirs.check()?;
    let modules =
        Modules::new("::downbeat_msgs", "crate").with_packages("::downbeat_msgs", packages.iter().copied());
    fs::write(out.join("odd_msgs.rs"), RustSource::new(&theirs, &modules).package("odd_msgs")?)?;
    Ok(())
}
