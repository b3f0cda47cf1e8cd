use std::time::{Duration, UNIX_EPOCH};

use super::*;
use crate::pki::openssl::{Folder, Subject};

const TEXT: &str = "<?xml version=\"1.0\"?>\n<dds>\n  <permissions/>\n</dds>\n";

/// A folder with an authority `ca` and the text in `text.xml`.
#[track_caller]
fn folder() -> Option<Folder> {
    let folder = Folder::new()?;
    folder.self_signed("ca", &Subject::AUTHORITY);
    folder.write("text.xml", TEXT.as_bytes());
    Some(folder)
}

fn certificate(folder: &Folder, holder: &str) -> Certificate {
    Certificate::from_pem(&folder.read(&format!("{holder}.pem"))).unwrap()
}

fn signed_by(folder: &Folder, holder: &str, options: &[&str]) -> Vec<u8> {
    let (certificate, key) = (format!("{holder}.pem"), format!("{holder}.key"));
    let arguments =
        ["smime", "-sign", "-in", "text.xml", "-out", "text.p7s", "-signer", &certificate, "-inkey", &key];
    folder.run(&[&arguments[..], options].concat());
    folder.read("text.p7s")
}

fn crlf(text: &str) -> Vec<u8> {
    text.replace('\n', "\r\n").into_bytes()
}

#[test]
fn documents_that_openssl_signs_are_verified() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    let ways: [&[&str]; 6] = [
        &["-text"],
        &[],
        &["-text", "-nocerts"],
        &["-text", "-noattr"],
        &["-text", "-noattr", "-nocerts"],
        &["-text", "-md", "sha256", "-nosmimecap", "-crlfeol"],
    ];
    for options in ways {
        let document = signed_by(&folder, "ca", options);
        assert_eq!(verify(&document, &ca), Ok(crlf(TEXT)), "{options:?}");
        let unix = String::from_utf8(document).unwrap().replace("\r\n", "\n");
        assert_eq!(verify(unix.as_bytes(), &ca), Ok(crlf(TEXT)), "{options:?}");
    }
}

#[test]
fn openssl_verifies_what_is_signed_here() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    let key = PrivateKey::from_pem(&folder.read("ca.key")).unwrap();
    for (text, year) in [(TEXT, 2026), (TEXT, 2060), ("<dds/>", 2026)] {
        let now = UNIX_EPOCH + Duration::from_secs((year - 1970) * 31_557_600);
        let document = sign(text.as_bytes(), &ca, &key, now);
        folder.write("ours.p7s", &document);
        let content = folder.run(&[
            "smime",
            "-verify",
            "-text",
            "-in",
            "ours.p7s",
            "-CAfile",
            "ca.pem",
            "-no_check_time",
        ]);
        assert_eq!(String::from_utf8(content).unwrap(), text.replace('\n', "\r\n"));
        assert_eq!(verify(&document, &ca), Ok(crlf(text)));
    }
}

#[test]
fn a_document_that_somebody_else_signed_is_refused_whatever_certificates_it_holds() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    let name = "CN=sros2CA".to_owned();
    // Of the same name and serial number as the authority, and one that the authority itself signed.
    folder.self_signed("impostor", &Subject::AUTHORITY);
    folder.signed("ca", "enclave", &Subject { serial: "7", ..Subject::default() });
    let impostor = signed_by(&folder, "impostor", &["-text", "-certfile", "ca.pem"]);
    assert_eq!(verify(&impostor, &ca), Err(SmimeError::Signature(name.clone())));
    let enclave = signed_by(&folder, "enclave", &["-text", "-certfile", "ca.pem"]);
    assert_eq!(verify(&enclave, &ca), Err(SmimeError::OtherSigner(name)));
    assert!(verify(&enclave, &certificate(&folder, "enclave")).is_ok());
}

#[test]
fn a_text_or_a_signature_that_was_changed_is_refused() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    let text = String::from_utf8(signed_by(&folder, "ca", &["-text"])).unwrap();
    let changed = text.replace("<permissions/>", "<Permissions/>");
    assert_eq!(verify(changed.as_bytes(), &ca), Err(SmimeError::Changed));
    let changed = text.replace("Content-Type: text/plain\r\n", "Content-Type: text/html\r\n");
    assert_eq!(verify(changed.as_bytes(), &ca), Err(SmimeError::Changed));
    let plain = String::from_utf8(signed_by(&folder, "ca", &["-text", "-noattr"])).unwrap();
    let changed = plain.replace("<permissions/>", "<Permissions/>");
    assert_eq!(verify(changed.as_bytes(), &ca), Err(SmimeError::Signature("CN=sros2CA".to_owned())));
}

#[test]
fn documents_of_other_forms_are_refused_by_name() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    assert_eq!(verify(TEXT.as_bytes(), &ca), Err(SmimeError::NotSigned));
    assert_eq!(verify(b"", &ca), Err(SmimeError::NotSigned));
    assert_eq!(verify(&signed_by(&folder, "ca", &["-text", "-nodetach"]), &ca), Err(SmimeError::Opaque));
    let sha512 = signed_by(&folder, "ca", &["-text", "-md", "sha512"]);
    assert_eq!(verify(&sha512, &ca), Err(SmimeError::Digest("2.16.840.1.101.3.4.2.3".to_owned())));
    folder.run(&[
        "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=a", "-keyout", "rsa.key", "-out",
        "rsa.pem",
    ]);
    let rsa = signed_by(&folder, "rsa", &["-text"]);
    assert!(matches!(verify(&rsa, &ca), Err(SmimeError::Algorithm(_))));
    let long = vec![b'a'; MAX_BYTES + 1];
    assert_eq!(verify(&long, &ca), Err(SmimeError::TooLong(MAX_BYTES + 1)));
}

#[test]
fn a_document_that_is_cut_off_anywhere_or_has_a_wrong_byte_is_refused() {
    let Some(folder) = folder() else { return };
    let ca = certificate(&folder, "ca");
    let document = signed_by(&folder, "ca", &["-text"]);
    let end = document.windows(4).rposition(|window| window == b"--\r\n" || window == b"--\n\n").unwrap();
    for length in 0..end {
        assert!(verify(document.get(..length).unwrap(), &ca).is_err(), "{length}");
    }
    let mut random = fuzzing::Random::new(1);
    for _ in 0..2000 {
        let mut changed = document.clone();
        let at = random.below(changed.len());
        changed[at] ^= 1 << random.below(8);
        // A byte outside of text and signature may be any.
        if let Ok(content) = verify(&changed, &ca) {
            assert_eq!(content, crlf(TEXT), "byte {at}");
        }
    }
}
