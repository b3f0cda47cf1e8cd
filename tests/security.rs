//! `downbeat security` and `docs/security.md` as a user sees them: keystores, policies, a robot in a
//! protected network.
#![cfg(feature = "security")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Running, downbeat, output_of, own_domain, robot_file, text_of};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use test_machine::{free_domain, has_program, missing};

const PAGE: &str = include_str!("../docs/security.md");

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The standard error of a command that must fail.
fn refusal(arguments: &[&str]) -> String {
    let output = output_of(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// A keystore with an enclave for a robot, in the domain of this process.
struct Site {
    folder: tempfile::TempDir,
    robot: PathBuf,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let robot = robot_file(folder.path(), |text| text);
        let site = Self { folder, robot };
        text_of(&["security", "create-keystore", text(&site.path("keys"))]);
        text_of(&["security", "generate-policy", text(&site.robot), "-o", text(&site.path("policy.xml"))]);
        text_of(&["security", "create-enclave", text(&site.path("keys")), "/darwin_op"]);
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn enclave(&self, name: &str) -> PathBuf {
        self.path("keys/enclaves/darwin_op").join(name)
    }

    /// Signs the policy, changed by `edit`.
    fn sign(&self, edit: impl Fn(&str) -> String) {
        let policy = fs::read_to_string(self.path("policy.xml")).unwrap();
        let changed = self.path("changed.xml");
        fs::write(&changed, edit(&policy)).unwrap();
        text_of(&["security", "create-permissions", text(&self.path("keys")), "/darwin_op", text(&changed)]);
    }

    fn check(&self, more: &[&str]) -> Vec<String> {
        let (robot, keys) = (text(&self.robot).to_owned(), text(&self.path("keys")).to_owned());
        let line = ["security", "check", &robot, "--keystore", &keys, "--enclave", "/darwin_op"];
        line.iter().chain(more).map(|&word| word.to_owned()).collect()
    }

    fn report(&self) -> Value {
        let arguments = self.check(&["--json"]);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        serde_json::from_slice(&output_of(&arguments).stdout).unwrap()
    }

    fn refused_check(&self, more: &[&str]) -> String {
        let arguments = self.check(more);
        refusal(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// A command in the protected network.
    fn command(&self, arguments: &[&str], enclave: &str) -> Command {
        let mut command = downbeat(arguments);
        command
            .env("ROS_SECURITY_ENABLE", "true")
            .env("ROS_SECURITY_STRATEGY", "Enforce")
            .env("ROS_SECURITY_KEYSTORE", self.path("keys"))
            .env("ROS_SECURITY_ENCLAVE_OVERRIDE", enclave);
        command
    }
}

#[test]
fn the_policy_of_a_robot_permits_what_it_exposes_and_nothing_else() {
    let site = Site::new();
    site.sign(str::to_owned);
    let report = site.report();
    let network = &report["networks"][0];
    assert_eq!(network["domain"], own_domain());
    let endpoints = network["endpoints"].as_array().unwrap();
    let denied: Vec<_> = endpoints.iter().filter(|endpoint| endpoint["is_allowed"] != true).collect();
    assert!(denied.is_empty(), "{denied:?}");
    let found: BTreeSet<_> = endpoints
        .iter()
        .map(|endpoint| (endpoint["action"].as_str().unwrap(), endpoint["topic"].as_str().unwrap()))
        .collect();
    for expected in [
        ("publish", "rt/joint_states"),
        ("publish", "rt/rosout"),
        ("publish", "rt/diagnostics"),
        ("publish", "rt/parameter_events"),
        ("publish", "ros_discovery_info"),
        ("subscribe", "ros_discovery_info"),
        ("subscribe", "rq/darwin_op/set_parametersRequest"),
        ("publish", "rr/darwin_op/get_type_descriptionReply"),
    ] {
        assert!(found.contains(&expected), "{expected:?} is in {found:#?}");
    }
    let permissions = fs::read_to_string(site.enclave("permissions.xml")).unwrap();
    let granted = permissions.matches("<topic>").count();
    assert_eq!(granted, found.len(), "no more than what there is: {permissions}");
    let shown = text_of(&site.check(&[]).iter().map(String::as_str).collect::<Vec<_>>());
    for expected in [
        "participants without a certificate are refused",
        "whole messages are signed",
        "topics \"*\": publishing and subscribing need permission",
        "0 denied",
        "grant \"/darwin_op\", rule 1 (allow): publish \"rt/joint_states\"",
    ] {
        assert!(shown.contains(expected), "{expected:?} is in {shown}");
    }
}

#[test]
fn what_a_policy_lacks_is_named_by_every_command() {
    let site = Site::new();
    site.sign(|policy| {
        let without = policy.lines().filter(|line| line.trim() != "<topic>joint_states</topic>");
        without.collect::<Vec<_>>().join("\n")
    });
    let expected = "to publish rt/joint_states (grant \"/darwin_op\", default DENY: no rule applies)";
    let refused = site.refused_check(&[]);
    assert!(refused.contains(expected) && refused.contains("create-permissions"), "{refused}");
    let denied = site.report();
    let endpoints = denied["networks"][0]["endpoints"].as_array().unwrap();
    let denied = endpoints.iter().filter(|endpoint| endpoint["is_allowed"] == false);
    assert_eq!(
        denied.map(|endpoint| endpoint["topic"].as_str().unwrap()).collect::<Vec<_>>(),
        ["rt/joint_states"]
    );
    for command in ["check", "run"] {
        let output = site.command(&[command, text(&site.robot)], "/darwin_op").output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{command}: {message}");
        assert!(message.contains(expected), "{command}: {message}");
    }
}

#[test]
fn a_policy_is_extended_by_what_is_exposed_since() {
    let site = Site::new();
    let before = fs::read_to_string(site.path("policy.xml")).unwrap();
    assert!(!before.contains("rosbag2_recorder"), "{before}");
    let policy = site.path("policy.xml");
    let arguments = ["security", "generate-policy", text(&site.robot), "--record", "-o", text(&policy)];
    text_of(&arguments);
    let after = fs::read_to_string(&policy).unwrap();
    assert!(after.contains("node=\"rosbag2_recorder\""), "{after}");
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<BTreeSet<_>>();
    assert!(lines(&before).is_subset(&lines(&after)));
}

#[test]
fn the_parts_of_an_action_are_one_name_of_a_policy() {
    let folder = tempfile::tempdir().unwrap();
    let (keys, policy) = (folder.path().join("keys"), folder.path().join("arm.xml"));
    let (keys, policy, robot) = (text(&keys), text(&policy), "program/src/new/templates/arm/robot.toml");
    text_of(&["security", "create-keystore", keys]);
    text_of(&["security", "create-enclave", keys, "/arm"]);
    text_of(&["security", "generate-policy", robot, "--enclave", "/arm", "-o", policy]);
    let written = fs::read_to_string(policy).unwrap();
    let action = "<actions execute=\"ALLOW\">\n            <action>/arm/follow_joint_trajectory</action>";
    assert!(written.contains(action) && !written.contains("_action"), "{written}");
    text_of(&["security", "create-permissions", keys, "/arm", policy]);
    let shown = text_of(&["security", "check", robot, "--keystore", keys, "--enclave", "/arm"]);
    let part = "rq/arm/follow_joint_trajectory/_action/send_goalRequest";
    assert!(shown.contains("0 denied") && shown.contains(part), "{shown}");
}

#[test]
fn keys_are_for_their_owner_and_never_printed() {
    let site = Site::new();
    for name in ["keys/private/ca.key.pem", "keys/enclaves/darwin_op/key.pem"] {
        let mode = fs::metadata(site.path(name)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{name}");
    }
    let key = fs::read_to_string(site.enclave("key.pem")).unwrap();
    let secret = key.lines().nth(1).unwrap();
    let keys = site.path("keys");
    let listed = text_of(&["security", "list", text(&keys)]);
    assert!(listed.starts_with("/darwin_op ") && listed.contains("valid until 20"), "{listed}");
    let json = text_of(&["security", "list-enclaves", text(&keys), "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&json).unwrap()[0]["subject"], "CN=/darwin_op");
    let again = text_of(&["security", "create-enclave", text(&keys), "/darwin_op"]);
    for printed in [listed, json, again, site.report().to_string()] {
        assert!(!printed.contains(secret) && !printed.contains("PRIVATE"), "{printed}");
    }
    assert_eq!(fs::read_to_string(site.enclave("key.pem")).unwrap(), key, "an enclave keeps its key");
}

#[test]
fn wrong_files_and_names_are_refused_with_what_to_do() {
    let site = Site::new();
    let keys = site.path("keys");
    let (keys, policy) = (text(&keys), site.path("policy.xml"));
    text_of(&["security", "create-enclave", keys, "/other"]);
    fs::write(
        site.path("wrong.xml"),
        fs::read_to_string(&policy).unwrap().replace("<topics ", "<topics qos=\"1\" "),
    )
    .unwrap();
    let wrong = site.path("wrong.xml");
    let cases: [(&[&str], &[&str]); 9] = [
        (&["create-keystore", keys], &["is a keystore already"]),
        (&["create-enclave", "/nowhere", "/a"], &["/nowhere is no keystore: it has no public/"]),
        (&["create-enclave", keys, "darwin_op"], &["no name of an enclave", "it must begin with a slash"]),
        (&["create-enclave", keys, "/b", "--domain", "5"], &["governance.p7s has no rule for domain 5"]),
        (&["create-enclave", keys, "/b", "--domain", "231"], &["domain 231 cannot be protected", "--domain"]),
        (&["create-enclave", keys, "/b", "--domain", "300"], &["domains are 0 to 232"]),
        (
            &["create-permissions", keys, "/other", text(&policy)],
            &["the policy has no enclave /other, but /darwin_op"],
        ),
        (
            &["create-permissions", keys, "/darwin_op", text(&wrong)],
            &["wrong.xml: line ", "attribute \"qos\" is unknown in <topics>"],
        ),
        (&["create-permissions", keys, "/darwin_op", "none.xml"], &["cannot read policy none.xml"]),
    ];
    for (arguments, expected) in cases {
        let message = refusal(&[&["security"], arguments].concat());
        for part in expected {
            assert!(message.contains(part), "{arguments:?}: {message}");
        }
    }
    assert!(!site.path("keys/enclaves/b").exists(), "nothing is left behind");
    let message = refusal(&["security", "check", text(&site.robot)]);
    assert!(message.contains("--keystore") && message.contains("ROS_SECURITY_KEYSTORE"), "{message}");
    let message = refusal(&["security", "generate-policy", text(&site.robot), "--enclave", "robot"]);
    assert!(message.contains("it must begin with a slash"), "{message}");
}

#[test]
fn a_wrong_file_in_an_enclave_is_named() {
    let site = Site::new();
    let keys = site.path("keys");
    text_of(&["security", "create-enclave", text(&keys), "/other"]);
    let key = fs::read(site.enclave("key.pem")).unwrap();
    let permissions = fs::read(site.enclave("permissions.p7s")).unwrap();
    let other = |name: &str| fs::read(keys.join("enclaves/other").join(name)).unwrap();
    let cases: [(&str, Option<Vec<u8>>, &str); 5] = [
        ("key.pem", None, "key.pem is missing"),
        ("key.pem", Some(vec![0x30, 0x82, 0, 4]), "key.pem is in DER form"),
        ("key.pem", Some(other("key.pem")), "key.pem is not the key of"),
        (
            "permissions.p7s",
            Some(other("permissions.p7s")),
            "permissions.p7s has no grant for \"CN=/darwin_op\"",
        ),
        ("permissions.p7s", Some(b"<dds/>".to_vec()), "permissions.p7s: "),
    ];
    for (name, content, expected) in cases {
        match content {
            None => fs::remove_file(site.enclave(name)).unwrap(),
            Some(content) => fs::write(site.enclave(name), content).unwrap(),
        }
        let refused = site.refused_check(&[]);
        assert!(refused.contains(expected), "{refused}");
        fs::write(site.enclave("key.pem"), &key).unwrap();
        fs::write(site.enclave("permissions.p7s"), &permissions).unwrap();
    }
    fs::set_permissions(site.enclave("key.pem"), fs::Permissions::from_mode(0o644)).unwrap();
    let warned = site.report()["warnings"][0].as_str().unwrap().to_owned();
    assert!(warned.contains("open to other users (mode 644)") && warned.contains("chmod 600"), "{warned}");
    let listed = text_of(&["security", "list", text(&keys)]);
    assert!(listed.contains("chmod 600"), "{listed}");
}

#[test]
fn an_expired_enclave_is_refused() {
    if !has_program("openssl") {
        return missing("openssl", "Debian: the package openssl");
    }
    let site = Site::new();
    let (ca, ca_key) = (site.path("keys/public/ca.cert.pem"), site.path("keys/private/ca.key.pem"));
    let request = site.path("request.pem");
    let run = |arguments: &[&str]| {
        let output = Command::new("openssl").args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let key = site.enclave("key.pem");
    run(&["req", "-new", "-key", text(&key), "-subj", "/CN=\\/darwin_op", "-nodes", "-out", text(&request)]);
    let line =
        ["x509", "-req", "-in", text(&request), "-CA", text(&ca), "-CAkey", text(&ca_key), "-days", "-1"];
    let certificate = site.enclave("cert.pem");
    run(&[&line[..], &["-set_serial", "7", "-out", text(&certificate)]].concat());
    let refused = site.refused_check(&[]);
    assert!(refused.contains("cert.pem") && refused.contains("expired"), "{refused}");
}

/// The lines of a block of the page, which is found by its first words.
fn lines_of_the_page(first: &str) -> &'static str {
    let block = PAGE.split("```sh\n").find(|block| block.starts_with(first)).unwrap();
    block.split("```").next().unwrap()
}

/// Runs lines as a reader types them.
fn typed(folder: &Path, domain: u16, lines: &str) -> String {
    let script = format!("set -e\ndownbeat() {{ {} \"$@\"; }}\n{lines}", env!("CARGO_BIN_EXE_downbeat"));
    let mut command = Command::new("sh");
    command.args(["-c", &script]).current_dir(folder);
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    let output = command.output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    assert!(output.status.success(), "{lines}{text}");
    text
}

/// A folder with the keystore and the policy of the page.
fn keystore_of_the_page(domain: u16) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    symlink(Path::new(env!("CARGO_MANIFEST_DIR")).join("robots"), folder.path().join("robots")).unwrap();
    let created = typed(folder.path(), domain, lines_of_the_page("downbeat security create-keystore"));
    assert!(created.contains("created enclave /laptop"), "{created}");
    let signed = typed(folder.path(), domain, lines_of_the_page("downbeat security generate-policy"));
    assert!(signed.contains("0 denied"), "{signed}");
    folder
}

#[test]
fn a_laptop_is_revoked_and_a_key_renewed_as_on_the_page() {
    if !has_program("openssl") {
        return missing("openssl", "Debian: the package openssl");
    }
    let domain = free_domain();
    let folder = keystore_of_the_page(domain);
    let type_lines = |lines: &str| typed(folder.path(), domain, lines);
    type_lines(lines_of_the_page("printf"));
    // The robot refuses the laptop by the same list.
    let listed = type_lines("cp crl.pem keys/enclaves/laptop/\ndownbeat security list keys");
    let lines: Vec<&str> = listed.lines().collect();
    assert!(lines[0].starts_with("/darwin_op ") && lines[0].contains("valid until"), "{listed}");
    assert!(lines[1].starts_with("/laptop ") && lines[1].contains("revoked"), "{listed}");
    let key = || fs::read(folder.path().join("keys/enclaves/darwin_op/key.pem")).unwrap();
    let before = key();
    type_lines(lines_of_the_page("rm keys"));
    assert_ne!(key(), before);
    let check = "downbeat security check robots/darwin_op.toml --keystore keys --enclave /darwin_op";
    assert!(type_lines(check).contains("0 denied"));
}

#[test]
fn the_robot_of_the_page_is_seen_by_the_laptop_alone() {
    let domain = free_domain();
    let folder = keystore_of_the_page(domain);
    typed(folder.path(), domain, lines_of_the_page("mkdir"));
    let protected = |arguments: &[&str], keystore: &str| {
        let mut command = downbeat(arguments);
        command
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_SECURITY_ENABLE", "true")
            .env("ROS_SECURITY_STRATEGY", "Enforce")
            .env("ROS_SECURITY_KEYSTORE", folder.path().join(keystore));
        command
    };
    let lines = lines_of_the_page("export ROS_SECURITY_ENABLE");
    let run = lines.lines().find(|line| line.starts_with("downbeat run")).unwrap();
    let run: Vec<&str> = run.split_whitespace().skip(1).collect();
    let robot = Running::start_by(&mut protected(&run, "robot_keys"));
    robot.wait_for_output("exposed from ROS 2: /joint_commands");
    let echo = ["topic", "echo", "/joint_states", "--once"];
    let mut laptop = protected(&echo, "keys");
    let heard = laptop.env("ROS_SECURITY_ENCLAVE_OVERRIDE", "/laptop").output().unwrap();
    let heard = String::from_utf8(heard.stdout).unwrap();
    assert!(heard.contains("position:"), "{heard}");
    let stranger = downbeat(&["topic", "list", "--spin-time", "3"])
        .env("ROS_DOMAIN_ID", domain.to_string())
        .output()
        .unwrap();
    let seen = String::from_utf8(stranger.stdout).unwrap();
    assert!(!seen.contains("joint_states"), "{seen}");
}
