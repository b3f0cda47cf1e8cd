//! The C and C++ structs of messages, by compilers: they read and write the same bytes as the Rust types.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{c, cpp, has_compiler};
use downbeat_library_host::messages::{Language, generate};
use downbeat_msgs::definitions::{Catalog, Kind, MessageDefinition, TypeName};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

/// Everything that a definition can have.
const EVERYTHING: &str = "\
uint8 SMALL=255
int64 LEAST=-9223372036854775808
uint64 MOST=18446744073709551615
float32 THIRD=0.333
float64 NOTHING=nan
string TEXT=\"a \\\"quoted\\\" text?\"
bool YES=true
bool flag true
byte raw 7
char letter 65
int8 small -3
uint16 middle 65535
int32 whole -2147483648
int64 large -9223372036854775808
uint64 largest 18446744073709551615
float32 single 0.1
float64 double 1e300
float64 class
string text \"grün\"
string<=5 short \"abcde\"
wstring wide \"😀 ü\"
int16[3] three [1, -2, 3]
float64[] many [0.5, 1.5]
bool[] flags [true, false, true]
bool[2] two [true, true]
uint8[<=4] bounded [1, 2]
string[] texts [\"one\", \"\"]
string<=3[<=2] bounded_texts [\"abc\"]
wstring[2] wides [\"a\", \"ö\"]
test_messages/Inner inner
test_messages/Inner[2] pair
test_messages/Inner[] list
test_messages/Nothing nothing
";
const INNER: &str = "int8 first 5\nfloat64 second 2.5\nstring name \"inner\"\n";

fn everything() -> Catalog {
    let mut catalog = Catalog::new();
    for (name, text) in [("Everything", EVERYTHING), ("Inner", INNER), ("Nothing", "")] {
        let name = TypeName::new("test_messages", Kind::Message, name);
        let origin = name.to_string();
        catalog.add_message(name, text, &origin).unwrap();
    }
    catalog.check().unwrap();
    catalog
}

/// All messages that have structs.
fn all(catalog: &Catalog) -> impl Iterator<Item = &MessageDefinition> {
    catalog.messages().filter(|message| !message.name.name.ends_with("_Event"))
}

/// A program that reads pairs of a number of a message and its bytes, and answers with the bytes that it
/// writes for it.
fn echo(folder: &Path, catalog: &Catalog, messages: &[&MessageDefinition], language: Language) -> Command {
    let names: Vec<_> = all(catalog).map(|message| message.name.clone()).collect();
    let mut source = String::new();
    for header in generate(catalog, &names, language).unwrap() {
        let path = folder.join(&header.path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, header.text).unwrap();
        let _ = writeln!(source, "#include \"{}\"", header.path);
    }
    source.push_str("#include <stdio.h>\n#define MOST (1 << 20)\nstatic uint8_t bytes[MOST];\n");
    source.push_str(
        "static void reply(const uint8_t *data, size_t size) {\n    uint32_t count = (uint32_t)size;\n",
    );
    source.push_str(
        "    fwrite(&count, 4, 1, stdout);\n    fwrite(data, 1, size, stdout);\n    fflush(stdout);\n}\n",
    );
    if language == Language::Cpp {
        source.push_str(
            "template <class T> static void echo(size_t size) {\n    try {\n        const auto answer = \
             downbeat::cdr::encode(size ? downbeat::cdr::decode<T>(bytes, size) : T());\n        reply(answer.data(), \
             answer.size());\n    } catch (const downbeat::Error &error) {\n        reply((const uint8_t *)error.what(), \
             strlen(error.what()));\n    }\n}\n",
        );
    }
    source.push_str("int main(void) {\n    uint32_t head[2];\n    while (fread(head, 4, 2, stdin) == 2) {\n");
    source.push_str(
        "        if (fread(bytes, 1, head[1], stdin) != head[1]) return 1;\n        switch (head[0]) {\n",
    );
    for (number, message) in messages.iter().enumerate() {
        let TypeName { package, kind, name } = &message.name;
        let kind = kind.as_str();
        let _ = match language {
            Language::Cpp => {
                writeln!(source, "        case {number}: echo<{package}::{kind}::{name}>(head[1]); break;")
            }
            Language::C => {
                let name = format!("{package}__{kind}__{name}");
                writeln!(
                    source,
                    "        case {number}: {{ {name} m; downbeat_writer w = {{0}}; const char *e = NULL; if \
                     ({name}__init(&m)) return 1; if (head[1]) e = {name}__decode(&m, bytes, head[1]); if (!e && \
                     {name}__encode(&m, &w)) e = w.error; if (e) reply((const uint8_t *)e, strlen(e)); else \
                     reply(w.data, w.size); {name}__fini(&m); downbeat_writer_fini(&w); break; }}"
                )
            }
        };
    }
    source.push_str("        default: return 2;\n        }\n    }\n    return 0;\n}\n");
    let (mut compiler, name) = match language {
        Language::C => (c(), "echo.c"),
        Language::Cpp => (cpp(), "echo.cpp"),
    };
    std::fs::write(folder.join(name), source).unwrap();
    let program = folder.join(format!("{name}.out"));
    compiler
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=address,undefined", "-I"])
        .arg(folder);
    let output = compiler.arg(folder.join(name)).arg("-o").arg(&program).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut program = Command::new(program);
    // A sanitizer refuses to be loaded after other libraries.
    program.env_remove("LD_PRELOAD").stdin(Stdio::piped()).stdout(Stdio::piped());
    program
}

/// The answers of a program to these messages.
fn answers(program: &mut Command, messages: &[(u32, Vec<u8>)]) -> Vec<Vec<u8>> {
    let mut child = program.spawn().unwrap();
    let (mut input, mut output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
    let mut answers = Vec::new();
    for (number, bytes) in messages {
        let head = [*number, bytes.len() as u32].map(u32::to_ne_bytes).concat();
        input.write_all(&[&head, bytes.as_slice()].concat()).unwrap();
        answers.push(read_answer(&mut output));
    }
    drop(input);
    assert!(child.wait().unwrap().success());
    answers
}

fn read_answer(output: &mut std::process::ChildStdout) -> Vec<u8> {
    let mut size = [0; 4];
    output.read_exact(&mut size).unwrap();
    let mut answer = vec![0; u32::from_ne_bytes(size) as usize];
    output.read_exact(&mut answer).unwrap();
    answer
}

#[test]
fn structs_write_what_they_read_of_every_interface() {
    if !has_compiler() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let catalog = downbeat_msgs::carried();
    let messages: Vec<_> = all(catalog).collect();
    assert!(messages.len() > 100, "{}", messages.len());
    let defaults: Vec<(u32, Vec<u8>)> = (0..)
        .zip(&messages)
        .map(|(number, message)| {
            let of = DynamicType::new(catalog, &message.name).unwrap();
            (number, DynamicMessage::new(&of).to_cdr())
        })
        .collect();
    for language in [Language::C, Language::Cpp] {
        // All headers are compiled. The code of all C++ structs would take a minute.
        let step = if language == Language::C { 1 } else { 5 };
        let messages: Vec<_> = messages.iter().copied().step_by(step).collect();
        let defaults: Vec<_> = (0..)
            .zip(defaults.iter().step_by(step))
            .map(|(number, (_, bytes))| (number, bytes.clone()))
            .collect();
        let mut program = echo(folder.path(), catalog, &messages, language);
        let of_defaults = answers(&mut program, &defaults);
        let own: Vec<_> = (0..messages.len() as u32).map(|number| (number, Vec::new())).collect();
        let of_nothing = answers(&mut program, &own);
        for ((message, (_, default)), (echoed, own)) in
            messages.iter().zip(&defaults).zip(of_defaults.iter().zip(&of_nothing))
        {
            assert_eq!(echoed, default, "{language:?}: {} read and written", message.name);
            assert_eq!(own, default, "{language:?}: {} with its defaults", message.name);
        }
    }
}

#[test]
fn structs_have_defaults_constants_and_bounds() {
    if !has_compiler() {
        return;
    }
    let catalog = everything();
    let folder = tempfile::tempdir().unwrap();
    let name: TypeName = "test_messages/msg/Everything".parse().unwrap();
    let of = DynamicType::new(&catalog, &name).unwrap();
    let default = DynamicMessage::new(&of);
    let mut full = default.clone();
    full.resize("list", 3).unwrap();
    full.set("list[1].name", "second").unwrap();
    full.set("text", "a text with\ta tab").unwrap();
    full.resize("many", 1000).unwrap();
    full.resize("texts", 7).unwrap();
    full.set("wides[0]", "größer").unwrap();
    let mut big_endian = full.to_cdr();
    let little_endian = big_endian.clone();
    for language in [Language::C, Language::Cpp] {
        let mut program = echo(folder.path(), &catalog, &[catalog.message(&name).unwrap()], language);
        let good = answers(&mut program, &[(0, Vec::new()), (0, little_endian.clone())]);
        assert_eq!(good, [default.to_cdr(), little_endian.clone()], "{language:?}");
        // Every beginning of the bytes is an error, and of none of them memory is read beyond the end.
        let halves: Vec<_> =
            (1..little_endian.len()).step_by(97).map(|end| (0, little_endian[..end].to_vec())).collect();
        for answer in answers(&mut program, &halves) {
            let answer = String::from_utf8(answer).unwrap();
            assert!(["message", "header"].iter().any(|word| answer.contains(word)), "{language:?}: {answer}");
        }
        big_endian[1] = 7;
        let refused = answers(&mut program, &[(0, big_endian.clone())]);
        assert!(String::from_utf8_lossy(&refused[0]).contains("encapsulation header"));
    }
}
