//! Keystores and their enclaves.

use std::path::Path;
use std::time::SystemTime;

use downbeat_security::enclave::Enclave;
use downbeat_security::guard::Credentials;
use downbeat_security::keystore::Keystore;
use downbeat_security::pki::Date;
use serde_json::json;

use super::{EnclaveArguments, policy};

pub(super) fn create(path: &Path, domain_id: u32) -> anyhow::Result<()> {
    Keystore::create(path, domain_id, SystemTime::now(), &mut random)?;
    println!("created keystore {} for domain {domain_id}", path.display());
    Ok(())
}

pub(super) fn create_enclave(arguments: &EnclaveArguments) -> anyhow::Result<()> {
    let EnclaveArguments { keystore, name, domain } = arguments;
    let domain_id = domain.of_keystore()?;
    let folder = Keystore::open(keystore)?.create_enclave(name, domain_id, SystemTime::now(), &mut random)?;
    check_usable(&folder, domain_id)?;
    println!("created enclave {name} in {}", folder.display());
    Ok(())
}

pub(super) fn create_permissions(arguments: &EnclaveArguments, policy: &Path) -> anyhow::Result<()> {
    let EnclaveArguments { keystore, name, domain } = arguments;
    let domain_id = domain.of_keystore()?;
    let keystore = Keystore::open(keystore)?;
    keystore.create_permissions(name, &policy::read(policy)?, domain_id, SystemTime::now())?;
    let folder = keystore.folder(name)?;
    check_usable(&folder, domain_id)?;
    println!("signed the permissions of {name} by {}", policy.display());
    Ok(())
}

pub(super) fn list(path: &Path, as_json: bool) -> anyhow::Result<()> {
    let keystore = Keystore::open(path)?;
    let mut enclaves = Vec::new();
    for name in keystore.enclaves()? {
        let loaded = Enclave::load(&keystore.folder(&name)?, SystemTime::now());
        enclaves.push((name, loaded));
    }
    if as_json {
        let entry = |(name, loaded): &(String, Result<Enclave, _>)| match loaded {
            Ok(enclave) => json!({
                "name": name,
                "subject": enclave.certificate.subject(),
                "valid_until": Date(enclave.certificate.validity().1).to_string(),
                "warnings": enclave.warnings,
            }),
            Err(problem) => json!({ "name": name, "problem": format!("{problem}") }),
        };
        println!("{}", serde_json::to_string_pretty(&enclaves.iter().map(entry).collect::<Vec<_>>())?);
        return Ok(());
    }
    for (name, loaded) in &enclaves {
        match loaded {
            Ok(enclave) => {
                println!("{name:<40} valid until {}", Date(enclave.certificate.validity().1));
                enclave.warnings.iter().for_each(|warning| println!("    {warning}"));
            }
            Err(problem) => println!("{name:<40} cannot be used: {problem}"),
        }
    }
    Ok(())
}

/// Checks that a node can join the domain with what was written.
fn check_usable(folder: &Path, domain_id: u32) -> anyhow::Result<()> {
    let now = SystemTime::now();
    let enclave = Enclave::load(folder, now)?;
    enclave.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    Credentials::new(&enclave, domain_id, now)?;
    Ok(())
}

fn random(bytes: &mut [u8]) {
    // It fails only where the system has no source at all. Keys that can be guessed are worse than none.
    getrandom::fill(bytes).expect("random numbers of the system");
}
