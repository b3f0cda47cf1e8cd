//! Governance, permissions and policies, and the signatures around them.

use downbeat_security::access::{Action, Governance, Permissions, smime};
use downbeat_security::keystore::Keystore;
use downbeat_security::policy::Policy;

use super::pki::{AUTHORITY, keystore, time};

const GOVERNANCE: &[u8] = keystore!("enclaves/governance.p7s");
const PERMISSIONS: &[u8] = keystore!("enclaves/talker/permissions.p7s");

/// A signed document.
pub fn smime(document: &[u8]) -> bool {
    let Ok(content) = smime::verify(document, AUTHORITY.certificate()) else { return false };
    let genuine = [GOVERNANCE, PERMISSIONS].map(|document| smime::verify(document, AUTHORITY.certificate()));
    assert!(genuine.contains(&Ok(content)), "a changed text passes for signed");
    true
}

pub fn signed() -> Vec<Vec<u8>> {
    [GOVERNANCE, PERMISSIONS].map(<[u8]>::to_vec).into()
}

const ENCODING: &str = "Content-Transfer-Encoding: base64";

/// The document up to its signature, the signature in base64, and the rest.
fn parts() -> Option<(&'static str, &'static str, &'static str)> {
    let text = std::str::from_utf8(PERMISSIONS).ok()?;
    let header = text.find(ENCODING)?;
    let start = header + text.get(header..)?.find("\r\n\r\n").map(|at| at + 4)?;
    let end = start + text.get(start..)?.find("\r\n\r\n--")?;
    Some((text.get(..start)?, text.get(start..end)?, text.get(end..)?))
}

/// A signature in DER, of the permissions of the talker.
pub fn signature(der: &[u8]) -> bool {
    let Some((before, _, after)) = parts() else { return false };
    let pem = der::pem::encode_string("X", der::pem::LineEnding::LF, der).unwrap_or_default();
    let base64: String =
        pem.lines().filter(|line| !line.starts_with('-')).flat_map(|line| [line, "\r\n"]).collect();
    smime([before, &base64, after].concat().as_bytes())
}

pub fn signatures() -> Vec<Vec<u8>> {
    let (_, base64, _) = parts().expect("the parts of the document");
    let pem = format!("-----BEGIN X-----\n{}\n-----END X-----\n", base64.replace('\r', ""));
    vec![der::Document::from_pem(&pem).expect("DER").1.as_bytes().to_vec()]
}

pub fn governance(text: &[u8]) -> bool {
    let text = String::from_utf8_lossy(text);
    let Ok(governance) = Governance::parse(&text) else { return false };
    let _ = governance.domain(0).map(|rule| rule.topic("rt/chatter").is_some());
    true
}

pub fn governances() -> Vec<Vec<u8>> {
    [include_bytes!("../../tests/data/governance.xml").as_slice(), keystore!("enclaves/governance.xml")]
        .map(<[u8]>::to_vec)
        .into()
}

pub fn permissions(text: &[u8]) -> bool {
    let text = String::from_utf8_lossy(text);
    let Ok(permissions) = Permissions::parse(&text) else { return false };
    let subjects: Vec<String> = permissions.subjects().map(str::to_owned).collect();
    for subject in subjects {
        if let Some(grant) = permissions.valid_grant(&subject, time()) {
            let _ = grant.may_join(0);
            for action in [Action::Publish, Action::Subscribe] {
                let _ = grant.decide(action, 0, "rt/a/b/chatter", &["partition".to_owned()]);
            }
        }
    }
    true
}

pub fn all_permissions() -> Vec<Vec<u8>> {
    [
        include_bytes!("../../tests/data/permissions.xml").as_slice(),
        include_bytes!("../../tests/data/permissions_of_walker.xml"),
        keystore!("enclaves/talker/permissions.xml"),
    ]
    .map(<[u8]>::to_vec)
    .into()
}

pub fn policy(text: &[u8]) -> bool {
    let text = String::from_utf8_lossy(text);
    let Ok(policy) = Policy::parse(&text) else { return false };
    let enclaves: Vec<String> = policy.enclaves().map(str::to_owned).collect();
    for enclave in enclaves {
        let validity = (time(), time());
        let permissions = policy.permissions(&enclave, 7, validity).expect("permissions of an enclave");
        // Other names make no subject of a certificate.
        if Keystore::check_name(&enclave).is_ok() {
            assert!(Permissions::parse(&permissions).is_ok(), "{permissions}");
        }
    }
    true
}

pub fn policies() -> Vec<Vec<u8>> {
    [
        include_bytes!("../../tests/data/policy.xml").as_slice(),
        include_bytes!("../../tests/data/policy_generated.xml"),
    ]
    .map(<[u8]>::to_vec)
    .into()
}
