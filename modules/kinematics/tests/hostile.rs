//! URDF that nobody wrote in good faith: every text is read or refused, in bounded memory and time.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::Robot;
use fuzzing::{Random, most_in, rounds};
use std::fmt::Write as _;

const ARM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/darwin_op.urdf");

/// Reads a text, and everything that follows from a robot. Returns the memory that it takes at most, and the
/// error.
fn read(text: &str) -> (usize, Option<String>) {
    let (most, result) = most_in(|| {
        let robot = Robot::from_urdf(text, "x.urdf")?;
        let _ = robot.bodies();
        let _ = downbeat_kinematics::to_mjcf(&robot, downbeat_kinematics::Root::Free);
        Ok::<(), downbeat_kinematics::DescriptionError>(())
    });
    (most, result.err().map(|error| error.to_string()))
}

#[test]
fn random_changes_of_a_robot_are_read_or_refused_with_a_line() {
    let numbers = [
        "NaN",
        "inf",
        "-1",
        "1e308",
        "1e-320",
        "99999999999999999999",
        "0",
        "",
        "1 2",
        "<",
        "\"",
        "&a;",
        "]]>",
    ];
    let arm = std::fs::read(ARM).unwrap();
    for round in rounds(400) {
        let mut random = Random::new(round);
        let mut bytes = arm.clone();
        for _ in 0..=random.below(6) {
            let at = random.below(bytes.len());
            let end = (at + random.below(200)).min(bytes.len());
            match random.below(6) {
                0 => bytes[at] ^= 1 << random.below(8),
                1 => drop(bytes.drain(at..end)),
                2 => {
                    let piece = bytes[at..end].to_vec();
                    let to = random.below(bytes.len());
                    bytes.splice(to..to, piece);
                }
                3 => bytes.truncate(at),
                _ => {
                    // The value of an attribute.
                    let Some(begin) = bytes[at..].iter().position(|byte| *byte == b'"').map(|p| at + p + 1)
                    else {
                        continue;
                    };
                    let Some(end) = bytes[begin..].iter().position(|byte| *byte == b'"').map(|p| begin + p)
                    else {
                        continue;
                    };
                    bytes.splice(begin..end, random.choose(&numbers).bytes());
                }
            }
            if bytes.is_empty() {
                break;
            }
        }
        let text = String::from_utf8_lossy(&bytes);
        let (most, error) = read(&text);
        assert!(most < 50 * arm.len() + (4 << 20), "round {round}: {most} bytes");
        assert!(error.is_none_or(|error| error.starts_with("x.urdf")), "round {round}");
    }
}

#[test]
fn texts_that_expand_nest_or_repeat_without_end_are_refused() {
    let many = |count: usize, part: &dyn Fn(usize) -> String| {
        let parts = (0..count).fold(String::new(), |mut all, index| {
            let _ = write!(all, "{}", part(index));
            all
        });
        format!("<robot name=\"x\">{parts}</robot>")
    };
    let long = "a".repeat(1 << 20);
    let chain = |index: usize| {
        format!(
            "<link name=\"l{index}\"/><joint name=\"j{index}\" type=\"continuous\"><parent link=\"l{index}\"/><child link=\"l{}\"/>{}</joint>\n",
            index + 1,
            if index > 0 {
                format!("<mimic joint=\"j{}\" multiplier=\"2\"/>", index - 1)
            } else {
                String::new()
            }
        )
    };
    let entities = "<!DOCTYPE r [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\">]><robot name=\"&b;\"><link name=\"l\"/></robot>";
    let texture = format!("<material name=\"m\"><texture filename=\"{long}\"/></material>");
    for (text, expected) in [
        (entities.to_owned(), "not valid XML"),
        (format!("<robot name=\"x\">{}", "<link>".repeat(200_000)), "not valid XML"),
        (many(1, &|_| format!("<link name=\"{long}\"/>")), "a value of more than 1024 bytes"),
        (many(1, &|_| format!("{texture}<link name=\"l\"/>")), "a value of more than 1024 bytes"),
        (
            many(20_001, &|index| format!("<link name=\"l{index}\"/>\n")),
            "20001 links; at most 10000 are possible",
        ),
        (many(9_000, &|index| format!("<link name=\"l{index}\"/>\n")), "and 8990 others"),
        (many(9_000, &chain), "there is no link \"l9000\""),
        (
            many(1, &|_| format!("<link name=\"l\"><inertial><mass value=\"{long}\"/></inertial></link>")),
            "a value of more than 1024 bytes",
        ),
        (
            format!("<robot {}/>", (0..300_000).map(|index| format!("a{index}=\"\" ")).collect::<String>()),
            "more than 100 attributes",
        ),
        ("<robot name=\"x\">".to_owned() + &" ".repeat(17 << 20), "at most 16777216 are possible"),
    ] {
        let (most, error) = read(&text);
        let error = error.unwrap();
        assert!(
            error.contains(expected) && error.len() < 4_000,
            "{expected}: {}",
            &error[..error.len().min(300)]
        );
        assert!(most < 40 * text.len() + (1 << 20), "{expected}: {most} bytes for {}", text.len());
    }
    // As deep as it may be.
    let deep = many(9_000, &chain).replace("</robot>", "<link name=\"l9000\"/></robot>");
    assert_eq!(read(&deep).1.filter(|error| !error.contains("inertial")), None);
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_refused_before_it_is_opened() {
    let error = Robot::read("/dev/zero").unwrap_err().to_string();
    assert!(error.contains("only regular files are read"), "{error}");
    assert!(Robot::read("/").unwrap_err().to_string().contains("only regular files are read"));
}
