//! Which revision of a repository changed a run: `downbeat bag bisect`.

use super::*;

fn git(folder: &Path, arguments: &[&str]) -> String {
    let identity = ["-c", "user.name=A", "-c", "user.email=a@localhost", "-c", "init.defaultBranch=main"];
    let output = Command::new("git").args(identity).args(arguments).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn the_revision_that_changed_a_run_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let git = |arguments: &[&str]| git(folder.path(), arguments);
    git(&["init", "--quiet"]);
    let (robot, bag) = talker(folder.path());
    fs::write(folder.path().join(".gitignore"), "bag\n").unwrap();
    let mut revisions = Vec::new();
    for (number, (what, chart)) in [
        ("Talk", CHART.to_owned()),
        ("Break it", CHART.replace("</scxml>", "")),
        ("Explain", CHART.replace("<state id", "<!-- It talks. --><state id")),
        ("Say tock", CHART.replace("'tick '", "'tock '")),
        (
            "Say tock again",
            CHART.replace("'tick '", "'tock '").replace("<state id", "<!-- It talks. --><state id"),
        ),
    ]
    .into_iter()
    .enumerate()
    {
        fs::write(folder.path().join("mouth.scxml"), chart).unwrap();
        git(&["add", "."]);
        git(&["commit", "--quiet", "--allow-empty", "-m", &format!("{what} ({number})")]);
        revisions.push(git(&["rev-parse", "HEAD"]));
    }
    let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
    let printed = text_of(&["bag", "bisect", robot, bag, "--good", &revisions[0], "--bad", "HEAD"]);
    assert!(
        printed.contains("the first revision that differs:") && printed.contains("Say tock (3)"),
        "{printed}"
    );
    assert!(printed.contains("/said message 0") && printed.contains("tock 1"), "{printed}");
    assert!(git(&["worktree", "list"]).lines().count() == 1, "no folder is left");
    let refused = output_of(&["bag", "bisect", robot, bag, "--good", &revisions[4], "--bad", "HEAD"]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("differs from the bag too"));
    let refused = output_of(&["bag", "bisect", robot, bag, "--good", &revisions[0], "--bad", &revisions[2]]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("does not differ from the bag"));
}

/// Each revision is built by a script of its own, and replayed by a program that the build makes.
#[test]
fn revisions_are_built_and_replayed_with_the_options_that_are_given() {
    let folder = tempfile::tempdir().unwrap();
    let git = |arguments: &[&str]| git(folder.path(), arguments);
    git(&["init", "--quiet"]);
    let (robot, bag) = talker(folder.path());
    fs::write(folder.path().join(".gitignore"), "bag\n").unwrap();
    let tock = CHART.replace("'tick '", "'tock '");
    let build = "mkdir -p made; printf '#!/bin/sh\nexec \"$DOWNBEAT_TEST\" \"$@\"\n' > made/robot; chmod +x made/robot\n";
    for (number, (chart, build)) in
        [(CHART, build), (CHART, "echo no compiler here >&2; exit 1\n"), (&tock, build), (&tock, build)]
            .into_iter()
            .enumerate()
    {
        fs::write(folder.path().join("mouth.scxml"), chart).unwrap();
        fs::write(folder.path().join("build.sh"), build).unwrap();
        git(&["add", "."]);
        git(&["commit", "--quiet", "--allow-empty", "-m", &format!("Revision {number}")]);
        git(&["tag", &format!("v{number}")]);
    }
    let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
    let bisect = |more: &[&str]| {
        let mut command = downbeat(&[&["bag", "bisect", robot, bag], more].concat());
        let output = command.env("DOWNBEAT_TEST", env!("CARGO_BIN_EXE_downbeat")).output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        (output.status.success(), text)
    };
    let built = ["--build", "sh build.sh", "--program", "made/robot"];
    let (is_found, said) = bisect(&[&["--good", "v0"], &built[..]].concat());
    // Of v1 it is not known, so it may be either.
    assert!(!is_found && said.contains("skipped: ") && said.contains("no compiler here"), "{said}");
    assert!(said.contains("the first that differs is one of these"), "{said}");
    let (_, said) = bisect(&[&["--good", "v1"], &built[..]].concat());
    assert!(said.contains("v1 cannot be replayed: sh build.sh: no compiler here"), "{said}");
    // Without the build, this program replays all of them.
    let (is_found, said) = bisect(&["--good", "v0"]);
    assert!(is_found && said.contains("Revision 2"), "{said}");
    let (is_found, said) = bisect(&["--good", "v0", "--program", "made/robot"]);
    assert!(!is_found && said.contains("made/robot"), "{said}");

    // An option that takes several names does not take the bag.
    let (is_found, said) = bisect(&["--good", "v0", "--", "--except", "said", "mouth/dot"]);
    assert!(!is_found && said.contains("the replay of HEAD does not differ from the bag"), "{said}");
    let (_, said) = bisect(&["--good", "v0", "--", "--modules", "moth"]);
    assert!(said.contains("HEAD cannot be replayed: ") && said.contains("moth"), "{said}");
    let (_, said) = bisect(&["--good", "v9"]);
    assert!(said.contains("there is no revision v9"), "{said}");
    let (is_found, said) = bisect(&["--good", "v0", "--bad", "v2"]);
    assert!(is_found && said.contains("Revision 2"), "{said}");
    assert_eq!(git(&["worktree", "list"]).lines().count(), 1, "no folder is left");

    let elsewhere = tempfile::tempdir().unwrap();
    let robot = elsewhere.path().join("robot.toml");
    fs::copy(folder.path().join("talker.toml"), &robot).unwrap();
    let mut bisect = downbeat(&["bag", "bisect", robot.to_str().unwrap(), bag, "--good", "v0"]);
    // The temporary folder may be in a checkout.
    let refused = bisect.env("GIT_CEILING_DIRECTORIES", elsewhere.path().parent().unwrap()).output().unwrap();
    assert!(String::from_utf8_lossy(&refused.stderr).contains("is in no repository of git"));
    let refused = output_of(&["bag", "bisect", "darwin_op", bag, "--good", "v0"]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("a carried robot has no revisions"));
}
