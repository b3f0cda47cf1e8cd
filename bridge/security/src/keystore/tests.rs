use std::fs;
use std::time::{Duration, UNIX_EPOCH};

use super::*;
use crate::enclave::Enclave;
use crate::pki::openssl::Folder;

const OF_SROS2: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/keystores/talker_listener");

/// Within the validity of the keystore of sros2.
fn now() -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_800_000_000)
}

/// Numbers that repeat with the seed, and are no keys for use.
fn random(seed: u64) -> impl FnMut(&mut [u8]) {
    let mut random = fuzzing::Random::new(seed);
    move |bytes| bytes.fill_with(|| random.bits() as u8)
}

fn create(path: &Path, domain_id: u32) -> Keystore {
    let mut random = random(1);
    let keystore = Keystore::create(path, domain_id, now(), &mut random).unwrap();
    for name in ["/talker_listener/talker", "/talker_listener/listener"] {
        keystore.create_enclave(name, domain_id, now(), &mut random).unwrap();
    }
    keystore
}

/// All files and links of a keystore with what they are, without the content of keys and certificates.
fn listing(folder: &Path, name: &str) -> Vec<String> {
    let mut lines = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("{name}/{}", path.file_name().unwrap().to_string_lossy());
        if let Ok(target) = path.read_link() {
            lines.push(format!("{name} -> {}", target.display()));
        } else if path.is_dir() {
            lines.extend(listing(&path, &name));
        } else {
            lines.push(name);
        }
    }
    lines.sort();
    lines
}

#[test]
fn a_keystore_has_the_files_and_links_of_that_which_sros2_makes() {
    let folder = tempfile::tempdir().unwrap();
    create(folder.path(), 0);
    assert_eq!(listing(folder.path(), ""), listing(Path::new(OF_SROS2), ""));
    let governance = |root: &Path| fs::read_to_string(root.join("enclaves/governance.xml")).unwrap();
    assert_eq!(governance(folder.path()), governance(Path::new(OF_SROS2)));
}

#[test]
fn certificates_are_those_that_sros2_makes_but_for_keys_and_numbers() {
    let Some(tools) = Folder::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    create(folder.path(), 0);
    let shown = |path: PathBuf| {
        let arguments = ["x509", "-in", path.to_str().unwrap(), "-noout", "-text"];
        let text = String::from_utf8(tools.run(&arguments)).unwrap();
        let digits = |line: &&str| {
            !line.trim().is_empty()
                && !line.trim_start().trim_end_matches(':').split(':').all(|pair| pair.len() == 2)
        };
        let text: Vec<String> = text.lines().filter(digits).map(|line| line.trim().to_owned()).collect();
        text.into_iter().filter(|line| !line.starts_with("Not ")).collect::<Vec<_>>()
    };
    for name in ["public/ca.cert.pem", "enclaves/talker_listener/talker/cert.pem"] {
        let (ours, theirs) = (shown(folder.path().join(name)), shown(Path::new(OF_SROS2).join(name)));
        assert!(ours.len() > 10 && ours == theirs, "{ours:#?} {theirs:#?}");
        let certificate = files::read_certificate(&folder.path().join(name)).unwrap();
        let (from, to) = certificate.validity();
        assert_eq!(now().duration_since(from).unwrap(), Duration::from_secs(24 * 3600));
        assert_eq!(to.duration_since(now()).unwrap(), Duration::from_secs(3650 * 24 * 3600));
        assert_eq!(certificate.serial().len(), 20);
    }
}

#[test]
fn openssl_verifies_certificates_and_signatures() {
    let Some(tools) = Folder::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    create(folder.path(), 0);
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (ca, talker) = (path("public/ca.cert.pem"), path("enclaves/talker_listener/talker"));
    let at = ["-attime", "1800000000", "-CAfile", &ca];
    tools.run(&[&["verify", "-check_ss_sig"], &at[..], &[&ca, &format!("{talker}/cert.pem")]].concat());
    for (signed, text) in [("governance", "governance"), ("permissions", "permissions")] {
        let signed = format!("{talker}/{signed}.p7s");
        let content = tools.run(&[&["smime", "-verify", "-text", "-in", &signed], &at[..]].concat());
        let content = String::from_utf8(content).unwrap().replace("\r\n", "\n");
        let folder = if text == "governance" { path("enclaves") } else { talker.clone() };
        assert_eq!(content, fs::read_to_string(format!("{folder}/{text}.xml")).unwrap());
    }
}

#[test]
fn enclaves_are_listed_and_can_be_used() {
    let folder = tempfile::tempdir().unwrap();
    let keystore = create(folder.path(), 7);
    let mut random = random(2);
    for name in ["/", "/talker_listener"] {
        keystore.create_enclave(name, 7, now(), &mut random).unwrap();
    }
    let names = keystore.enclaves().unwrap();
    assert_eq!(names, ["/", "/talker_listener", "/talker_listener/listener", "/talker_listener/talker"]);
    for name in names {
        let enclave = Enclave::load(&keystore.folder(&name).unwrap(), now()).unwrap();
        assert_eq!(enclave.certificate.subject(), format!("CN={name}"));
        assert!(enclave.for_domain(7).is_ok() && enclave.for_domain(0).is_err());
        assert!(enclave.grant(now()).unwrap().may_join(7));
        assert_eq!(enclave.warnings, [""; 0], "{name}");
    }
    assert_eq!(Keystore::open(Path::new(OF_SROS2)).unwrap().enclaves().unwrap().len(), 2);
}

#[test]
fn an_enclave_in_a_keystore_of_sros2_is_trusted_by_its_others() {
    let folder = tempfile::tempdir().unwrap();
    let keys = ["public", "private"].map(|part| folder.path().join(part));
    keys.iter().for_each(|part| fs::create_dir(part).unwrap());
    fs::create_dir(folder.path().join("enclaves")).unwrap();
    let copied = REQUIRED.into_iter().chain(["private/ca.key.pem", "public/ca.cert.pem"]);
    for name in copied {
        fs::copy(Path::new(OF_SROS2).join(name), folder.path().join(name)).unwrap();
    }
    let keystore = Keystore::open(folder.path()).unwrap();
    let path = keystore.create_enclave("/new", 0, now(), &mut random(2)).unwrap();
    let new = Enclave::load(&path, now()).unwrap();
    let talker = Path::new(OF_SROS2).join("enclaves/talker_listener/talker");
    let talker = Enclave::load(&talker, now()).unwrap();
    assert_eq!(talker.authority.check(&new.certificate, now()), Ok(()));
    assert!(smime::verify(&new.permissions_document, &talker.permissions_ca).is_ok());
}

#[test]
fn permissions_come_from_a_policy_and_stay() {
    let folder = tempfile::tempdir().unwrap();
    let keystore = create(folder.path(), 0);
    let name = "/robot/walker";
    let policy = Policy::parse(include_str!("../../tests/data/policy.xml")).unwrap();
    let early = keystore.create_permissions(name, &policy, 0, now()).unwrap_err();
    assert!(matches!(early, KeystoreError::NoEnclave { .. }), "{early}");
    let path = keystore.create_enclave(name, 0, now(), &mut random(2)).unwrap();
    keystore.create_permissions(name, &policy, 0, now()).unwrap();
    let written = |name: &str| fs::read(path.join(name)).unwrap();
    let before = ["key.pem", "cert.pem", "permissions.p7s", "permissions.xml"].map(written);
    assert!(String::from_utf8_lossy(&before[3]).contains("<topic>rt/robot/walker/gait</topic>"));
    keystore.create_enclave(name, 0, now(), &mut random(3)).unwrap();
    assert_eq!(["key.pem", "cert.pem", "permissions.p7s", "permissions.xml"].map(written), before);
    assert!(Enclave::load(&path, now()).is_ok());
    let other = keystore.create_permissions("/talker_listener/talker", &policy, 0, now()).unwrap_err();
    assert_eq!(
        other.to_string(),
        "the policy has no enclave /talker_listener/talker, but /robot/walker, /robot/idle"
    );
}

#[test]
#[cfg(unix)]
fn only_the_owner_can_read_keys() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    create(folder.path(), 0);
    for name in ["private/ca.key.pem", "enclaves/talker_listener/talker/key.pem"] {
        let mode = folder.path().join(name).metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{name}");
    }
}

#[test]
fn what_is_there_is_not_overwritten_and_what_is_none_not_opened() {
    let folder = tempfile::tempdir().unwrap();
    let missing = Keystore::open(folder.path()).unwrap_err().to_string();
    assert!(missing.ends_with("is no keystore: it has no public/permissions_ca.cert.pem"), "{missing}");
    let keystore = create(folder.path(), 0);
    let twice = Keystore::create(folder.path(), 0, now(), &mut random(2)).unwrap_err();
    assert!(matches!(twice, KeystoreError::Exists { .. }), "{twice}");
    let key = fs::read(folder.path().join("private/ca.key.pem")).unwrap();
    fs::remove_file(folder.path().join("public/identity_ca.cert.pem")).unwrap();
    let damaged = Keystore::create(folder.path(), 0, now(), &mut random(2)).unwrap_err();
    assert!(matches!(damaged, KeystoreError::File { attempt: "write", .. }), "{damaged}");
    assert_eq!(fs::read(folder.path().join("private/ca.key.pem")).unwrap(), key);
    let name = keystore.create_enclave("../escape", 0, now(), &mut random(2)).unwrap_err();
    assert!(matches!(name, KeystoreError::Name { .. }), "{name}");
}

#[test]
fn an_authority_and_a_governance_that_are_there_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let keystore = create(folder.path(), 3);
    let talker = keystore.folder("/talker_listener/talker").unwrap();
    fs::remove_file(folder.path().join(SIGNED_GOVERNANCE)).unwrap();
    let create = |domain_id| Keystore::create(folder.path(), domain_id, now(), &mut random(2));
    let other = create(0).unwrap_err();
    assert!(matches!(other, KeystoreError::Enclave(EnclaveError::NoRule { domain_id: 0, .. })), "{other}");
    let text = folder.path().join("enclaves/governance.xml");
    let governance = fs::read_to_string(&text).unwrap();
    fs::write(&text, governance.replace("<id>", "<ident>")).unwrap();
    let unreadable = create(3).unwrap_err();
    assert!(matches!(unreadable, KeystoreError::Governance { .. }), "{unreadable}");
    fs::write(&text, governance).unwrap();
    create(3).unwrap();
    assert!(Enclave::load(&talker, now()).unwrap().for_domain(3).is_ok());
}

#[test]
fn a_key_that_is_not_the_authority_s_signs_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let keystore = create(folder.path(), 0);
    let talker = fs::read(folder.path().join("enclaves/talker_listener/talker/key.pem")).unwrap();
    fs::write(folder.path().join("private/ca.key.pem"), talker).unwrap();
    let refused = keystore.create_enclave("/new", 0, now(), &mut random(2)).unwrap_err();
    assert!(matches!(refused, KeystoreError::OtherKey { .. }), "{refused}");
}
