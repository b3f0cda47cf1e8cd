//! Writes the Rust types of every package in `interfaces/`, and for the tests those of `tests/data/test_msgs/`.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use downbeat_msgs_generator::{Catalog, Modules, RustSource};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=interfaces");
    println!("cargo::rerun-if-changed=tests/data/test_msgs");
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

    // What a user's own package becomes: the tests include it as another crate would.
    let mut with_test_msgs = catalog.clone();
    with_test_msgs.add_package(Path::new("tests/data/test_msgs"))?;
    with_test_msgs.check()?;
    let elsewhere =
        Modules::new("::downbeat_msgs", "crate").with_packages("::downbeat_msgs", packages.iter().copied());
    fs::write(out.join("test_msgs.rs"), RustSource::new(&with_test_msgs, &elsewhere).package("test_msgs")?)?;
    Ok(())
}
