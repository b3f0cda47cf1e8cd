//! The Python process with the reference implementations.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

/// Runs a command of `witness.py` with `input` in a file; returns its output, or `None` without an
/// interpreter.
pub fn ask(command: &str, input: &str) -> Option<String> {
    let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else {
        // Bypasses the capture of test output, which hides the output of passing tests.
        let line = "skipped: DOWNBEAT_PYTHON is not set (cargo xtask test sets it)\n";
        let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
        return None;
    };
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("serialisations_{command}.txt"));
    std::fs::write(&file, input).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/serialisations/witness.py");
    let output = Command::new(&python).arg(script).arg(command).arg(&file).output().unwrap();
    assert!(output.status.success(), "witness.py {command}: {}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8(output.stdout).unwrap())
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

pub fn unhex(text: &str) -> Vec<u8> {
    let digits = text.as_bytes().as_chunks::<2>().0.iter();
    digits.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
