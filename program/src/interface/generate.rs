//! `downbeat interface generate`

use anyhow::Context;
use downbeat_library_host::messages::{Language, generate as generate_headers};

use super::interfaces::Interfaces;
use super::{GenerateArguments, HeaderLanguage, Registered};
use crate::unfinished::write_file;
use downbeat_msgs::definitions::TypeName;

pub(super) fn generate(arguments: &GenerateArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.source, registered)?;
    let mut names = Vec::new();
    for name in &arguments.names {
        names.extend(chosen(&interfaces, name)?);
    }
    let language = match arguments.lang {
        HeaderLanguage::C => Language::C,
        HeaderLanguage::Cpp => Language::Cpp,
    };
    let headers = generate_headers(&interfaces.catalog, &names, language)?;
    for header in &headers {
        let path = arguments.out.join(&header.path);
        let folder = path.parent().unwrap_or(&arguments.out);
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        // A build starts again only for what has changed.
        if std::fs::read(&path).is_ok_and(|written| written == header.text.as_bytes()) {
            continue;
        }
        write_file(&path, &header.text)?;
    }
    println!("{} headers in {}", headers.len(), arguments.out.display());
    Ok(())
}

/// The interface with a name, or those of a package.
fn chosen(interfaces: &Interfaces, name: &str) -> anyhow::Result<Vec<TypeName>> {
    if name.contains('/') {
        return Ok(vec![interfaces.named(name)?]);
    }
    interfaces.check_package(name)?;
    let names = interfaces.names().into_iter();
    Ok(names.filter(|of| of.package == name && interfaces.is_whole(of)).collect())
}
