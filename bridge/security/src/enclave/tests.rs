use std::fs;
use std::time::UNIX_EPOCH;

use super::*;
use crate::access::{Action, ProtectionKind};
use crate::pki::openssl::{Folder, Subject};

const KEYSTORE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/keystores/talker_listener");

/// In the first year of the keystore.
fn now() -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_800_000_000)
}

/// A copy of the talker's files that a test may damage, and the authority's key.
struct Copy {
    folder: tempfile::TempDir,
    ca: Certificate,
    ca_key: PrivateKey,
}

impl Copy {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in FILES {
            let from = Path::new(KEYSTORE).join("enclaves/talker_listener/talker").join(name);
            fs::write(folder.path().join(name), fs::read(from).unwrap()).unwrap();
        }
        let copy = |name: &str| fs::read(Path::new(KEYSTORE).join(name)).unwrap();
        let ca = Certificate::from_pem(&copy("public/ca.cert.pem")).unwrap();
        let ca_key = PrivateKey::from_pem(&copy("private/ca.key.pem")).unwrap();
        let copy = Self { folder, ca, ca_key };
        copy.close_key();
        copy
    }

    #[cfg(unix)]
    fn close_key(&self) {
        use std::os::unix::fs::PermissionsExt;
        fs::set_permissions(self.path("key.pem"), fs::Permissions::from_mode(0o600)).unwrap();
    }

    #[cfg(not(unix))]
    fn close_key(&self) {}

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, content: &[u8]) {
        fs::write(self.path(name), content).unwrap();
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Signs the content of a file anew, after a change.
    fn sign(&self, name: &str, from: &str, to: &str) {
        let content = smime::verify(self.text(name).as_bytes(), &self.ca).unwrap();
        let content = String::from_utf8(content).unwrap();
        assert!(content.contains(from), "{content}");
        let signed = smime::sign(content.replace(from, to).as_bytes(), &self.ca, &self.ca_key, now());
        self.write(name, &signed);
    }

    fn load(&self) -> Result<Enclave, EnclaveError> {
        Enclave::load(self.folder.path(), now())
    }

    /// The refusal, with the name of the folder shortened to `.`.
    #[track_caller]
    fn refusal(&self) -> String {
        self.load().unwrap_err().to_string().replace(&self.folder.path().display().to_string(), ".")
    }
}

#[test]
fn enclaves_of_sros2_are_read_through_their_links() {
    for name in ["talker", "listener"] {
        let folder = Path::new(KEYSTORE).join("enclaves/talker_listener").join(name);
        assert!(folder.join("governance.p7s").is_symlink());
        let enclave = Enclave::load(&folder, now()).unwrap();
        assert_eq!(enclave.certificate.subject(), format!("CN=/talker_listener/{name}"));
        let rule = enclave.for_domain(0).unwrap();
        assert_eq!((rule.rtps, rule.discovery), (ProtectionKind::Sign, ProtectionKind::Encrypt));
        assert!(rule.topic("rt/chatter").unwrap().write);
        let grant = enclave.grant(now()).unwrap();
        let may = |topic| grant.decide(Action::Publish, 0, topic, &[]).is_allowed;
        assert!(may("ros_discovery_info") && may("rt/rosout"));
        // The listener has the default permissions, the talker those of a policy.
        assert_eq!(may("rt/cmd_vel"), name == "listener");
        assert_eq!(
            enclave.for_domain(1).unwrap_err().to_string().split(" has ").last(),
            Some("no rule for domain 1; set ROS_DOMAIN_ID to a domain that it names, or sign a new one")
        );
    }
}

#[test]
fn a_whole_enclave_has_no_warning() {
    let enclave = Copy::new().load().unwrap();
    assert_eq!(enclave.warnings, [""; 0]);
    assert!(!format!("{enclave:?}").contains("scalar"));
}

#[test]
#[cfg(unix)]
fn a_key_that_others_can_read_is_a_warning() {
    use std::os::unix::fs::PermissionsExt;
    let copy = Copy::new();
    fs::set_permissions(copy.path("key.pem"), fs::Permissions::from_mode(0o644)).unwrap();
    let warnings = copy.load().unwrap().warnings;
    let key = copy.path("key.pem").display().to_string();
    assert_eq!(warnings, [format!("{key} is open to other users (mode 644); `chmod 600 {key}`")]);
}

#[test]
fn an_end_within_thirty_days_is_a_warning_and_a_past_end_a_refusal() {
    let copy = Copy::new();
    let (from, end) = copy.load().unwrap().certificate.validity();
    let near = Enclave::load(copy.folder.path(), end - Duration::from_secs(24 * 3600)).unwrap();
    let expiring = |name: &str| {
        near.warnings.iter().any(|warning| warning.contains(&format!("{name} expires on 2036-11-25T")))
    };
    assert!(expiring("/cert.pem") && expiring("permissions.p7s") && expiring("identity_ca.cert.pem"));
    let late = Enclave::load(copy.folder.path(), end + Duration::from_secs(1)).unwrap_err();
    assert!(matches!(late, EnclaveError::Distrust { source: Distrust::Expired { .. }, .. }), "{late}");
    let early = Enclave::load(copy.folder.path(), from - Duration::from_secs(1)).unwrap_err();
    assert!(matches!(early, EnclaveError::Distrust { source: Distrust::NotYetValid { .. }, .. }), "{early}");
}

#[test]
fn a_missing_file_and_a_link_to_nowhere_are_named() {
    for name in FILES {
        let copy = Copy::new();
        fs::remove_file(copy.path(name)).unwrap();
        assert!(copy.refusal().starts_with(&format!("./{name} is missing; an enclave has the files ")));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("../gone", copy.path(name)).unwrap();
            assert!(
                copy.refusal().starts_with(&format!("./{name} is a link to ../gone, which does not exist"))
            );
        }
        let _ = fs::remove_file(copy.path(name));
        fs::create_dir(copy.path(name)).unwrap();
        assert_eq!(copy.refusal(), format!("./{name} is no regular file of at most 1048576 bytes"));
    }
    let nowhere = Enclave::load(Path::new("/nowhere"), now()).unwrap_err();
    assert!(matches!(nowhere, EnclaveError::NoFolder { .. }));
}

#[test]
fn certificates_and_keys_of_other_forms_are_refused_by_name() {
    let Some(tools) = Folder::new() else { return };
    let copy = Copy::new();
    let whole = |name: &str| fs::read(Copy::new().path(name)).unwrap();
    let refusal_with = |name: &str, content: &[u8]| {
        copy.write(name, content);
        let refusal = copy.refusal();
        copy.write(name, &whole(name));
        refusal
    };
    tools.write("key", &whole("key.pem"));
    tools.write("cert", &whole("cert.pem"));
    let der = tools.run(&["x509", "-in", "cert", "-outform", "der"]);
    assert!(refusal_with("cert.pem", &der).starts_with("./cert.pem is in DER form; convert it to PEM"));
    let der = tools.run(&["pkcs8", "-topk8", "-nocrypt", "-in", "key", "-outform", "der"]);
    assert!(refusal_with("key.pem", &der).starts_with("./key.pem is in DER form"));
    let locked = tools.run(&["pkcs8", "-topk8", "-in", "key", "-passout", "pass:secret"]);
    assert!(
        refusal_with("key.pem", &locked).starts_with("./key.pem: the private key is protected by a password")
    );
    let rsa = tools.run(&["genpkey", "-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:1024"]);
    assert!(refusal_with("key.pem", &rsa).starts_with("./key.pem: the key is of kind RSA, but only P-256"));
    assert!(
        refusal_with("key.pem", b"secret").starts_with("./key.pem: there is no PEM block \"PRIVATE KEY\"")
    );
    assert!(refusal_with("cert.pem", b"").starts_with("./cert.pem: there is no PEM block \"CERTIFICATE\""));
    assert!(copy.load().is_ok());
}

#[test]
fn files_of_another_enclave_or_authority_are_refused() {
    let Some(tools) = Folder::new() else { return };
    let of_listener =
        |name: &str| fs::read(Path::new(KEYSTORE).join("enclaves/talker_listener/listener").join(name));
    let copy = Copy::new();
    copy.write("key.pem", &of_listener("key.pem").unwrap());
    assert_eq!(copy.refusal(), "./key.pem is not the key of ./cert.pem; they must be made together");
    copy.write("cert.pem", &of_listener("cert.pem").unwrap());
    assert_eq!(
        copy.refusal(),
        "./permissions.p7s has no grant for \"CN=/talker_listener/listener\", the subject of the certificate, but \
         for \"CN=/talker_listener/talker\"; sign permissions for it"
    );
    copy.write("permissions.p7s", &of_listener("permissions.p7s").unwrap());
    assert!(copy.load().is_ok());

    let stranger = tools.self_signed("stranger", &Subject::AUTHORITY);
    copy.write("identity_ca.cert.pem", &stranger);
    assert!(matches!(copy.load(), Err(EnclaveError::Distrust { source: Distrust::Signature { .. }, .. })));
    copy.write("identity_ca.cert.pem", &fs::read(copy.path("cert.pem")).unwrap());
    assert!(matches!(copy.load(), Err(EnclaveError::Distrust { source: Distrust::NotAuthority { .. }, .. })));
    let copy = Copy::new();
    copy.write("permissions_ca.cert.pem", &stranger);
    assert!(copy.refusal().starts_with("./governance.p7s: the document is signed by somebody else than"));
}

#[test]
#[cfg(unix)]
fn a_revocation_list_that_cannot_be_reached_is_not_left_out() {
    let copy = Copy::new();
    std::os::unix::fs::symlink("nowhere.pem", copy.path("crl.pem")).unwrap();
    let error = Enclave::load(copy.folder.path(), now()).unwrap_err();
    assert!(matches!(error, EnclaveError::BrokenLink { .. }), "{error}");
}

#[test]
fn a_revocation_list_is_heeded_if_it_is_there() {
    let copy = Copy::new();
    copy.write("crl.pem", b"nothing");
    assert!(copy.refusal().starts_with("./crl.pem: there is no PEM block"));
}

#[test]
fn signed_documents_that_are_changed_or_by_a_stranger_are_refused() {
    let Some(tools) = Folder::new() else { return };
    let copy = Copy::new();
    let governance = copy.text("governance.p7s");
    copy.write("governance.p7s", governance.replace(">SIGN<", ">NONE<").as_bytes());
    assert_eq!(copy.refusal(), "./governance.p7s: the text was changed after it was signed; sign it again");
    tools.self_signed("stranger", &Subject::AUTHORITY);
    tools.write("text", b"<dds/>");
    let arguments =
        ["smime", "-sign", "-text", "-in", "text", "-signer", "stranger.pem", "-inkey", "stranger.key"];
    copy.write("governance.p7s", &tools.run(&arguments));
    assert!(copy.refusal().starts_with("./governance.p7s: the document is signed by somebody else"));
    copy.write("governance.p7s", b"<dds/>");
    assert!(copy.refusal().starts_with("./governance.p7s: this is no signed document"));
}

#[test]
fn signed_documents_that_say_nothing_of_use_are_refused() {
    let copy = Copy::new();
    copy.sign("governance.p7s", "rtps_protection_kind", "rtps_kind");
    let refusal = copy.refusal();
    assert!(
        refusal.starts_with("./governance.p7s, in the signed text: line 11: <rtps_kind> is unknown"),
        "{refusal}"
    );
    let copy = Copy::new();
    copy.sign("permissions.p7s", "<not_after>2036-11", "<not_after>2026-12");
    let refusal = copy.refusal();
    assert!(refusal.contains("in ./permissions.p7s is valid from 2026-11-"), "{refusal}");
    copy.sign("permissions.p7s", "CN=/talker", "\u{fffd}=/talker");
    assert!(copy.refusal().starts_with("./permissions.p7s has no grant for"));
    copy.write("permissions.p7s", &smime::sign(b"<dds>\xff</dds>", &copy.ca, &copy.ca_key, now()));
    assert_eq!(copy.refusal(), "the signed text of ./permissions.p7s is not UTF-8");
}
