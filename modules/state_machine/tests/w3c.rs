//! The cases of the W3C and of SCION for SCXML, from the npm package `@scion-scxml/test-framework`: each
//! passes, or is listed with the reason why it does not apply. Skipped where the package is not installed.
//!
//! The cases are written for ECMAScript. What rhai writes otherwise is translated here, and nothing else.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_state_machine::{Chart, Dynamic, Effect, Event, Interpreter, Map};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// The table of results: `case | result`, sorted.
const TABLE: &str = include_str!("w3c_cases.md");

/// Elements and attributes that the subset does not have, and what cases with them are about.
const OUTSIDE: &[(&str, &str)] = &[
    ("<invoke", "invoke: another chart is another module"),
    ("<finalize", "finalize, of invoke"),
    ("basichttp", "events over HTTP"),
    ("BasicHTTP", "events over HTTP"),
    ("BasicHttp", "events over HTTP"),
    ("_event.raw", "events over HTTP"),
    ("getElementsByTagName", "XML as data"),
    (" src=", "data or scripts of other files"),
    ("srcexpr", "data or scripts of other files"),
    ("function", "functions of ECMAScript"),
    ("JSON.stringify", "the library of ECMAScript"),
    ("checkErrorData", "the data of errors in SCION"),
    ("new testobject", "objects of ECMAScript"),
    ("no error in s0", "a manual test: a person judges the log"),
    ("var Var01", "declarations of ECMAScript"),
    ("++var1", "operators of ECMAScript"),
    ("$scion", "names that SCION makes up"),
];

/// Expressions that rhai writes otherwise, in order.
const TRANSLATIONS: &[(&str, &str)] = &[
    ("!==", "!="),
    ("===", "=="),
    ("Math.pow(i,3)", "i * i * i"),
    ("[].concat(Var1, [4])", "Var1 + [4]"),
    ("var2 instanceof Array", "type_of(var2) == 'array'"),
    ("var1 instanceof Array", "type_of(var1) == 'array'"),
    ("var1==undefined", "var1==()"),
    ("Var4==0 | Var3 != 2", "Var4==0 || Var3 != 2"),
    ("{p1: 'v1', p2: 'v2'}", "#{p1: 'v1', p2: 'v2'}"),
    ("cond=\"_event\"", "cond=\"_event != ()\""),
    ("cond=\"Var1\"", "cond=\"Var1 != ()\""),
    ("cond=\"Var2\"", "cond=\"Var2 != ()\""),
    ("cond=\"Var4\"", "cond=\"Var4 != ()\""),
    ("cond=\"Var5\"", "cond=\"Var5 != ()\""),
    ("cond=\"!Var2\"", "cond=\"Var2 == ()\""),
    ("cond=\"'foo'\"", "cond=\"'foo' != ''\""),
    ("_ioprocessors['scxml'].location\"", "_ioprocessors['scxml'].location != ''\""),
    // What cannot be evaluated; the recommendation lets it be refused at the start as well, which is what
    // rhai's parser does.
    ("var Var1 =", "let Var1 ="),
    ("item=\"'continue'\"", "item=\"_event\""),
    ("\"return\"", "\"1 / 0\""),
];

/// `typeof x === 'undefined'`, and `'name' in map`.
fn translated(text: &str) -> String {
    let mut text = text.to_owned();
    for (from, to) in TRANSLATIONS {
        text = text.replace(from, to);
    }
    for name in [
        "_event.data",
        "_event.sendid",
        "_event.origintype",
        "_event.origin",
        "_event.invokeid",
        "Var1",
        "Var2",
    ] {
        text = text.replace(&format!("typeof {name} == 'undefined'"), &format!("type_of({name}) == '()'"));
    }
    text
}

#[test]
fn every_case_passes_or_does_not_apply_as_the_table_says() {
    let Some(folder) = package() else {
        test_machine::missing(
            "the npm package @scion-scxml/test-framework",
            "`cargo xtask node` installs it",
        );
        return;
    };
    let mut results = BTreeMap::new();
    for group in std::fs::read_dir(&folder).unwrap() {
        for file in std::fs::read_dir(group.unwrap().path()).unwrap() {
            let path = file.unwrap().path();
            let script = path.with_extension("json");
            let is_case = path.extension().is_some_and(|end| end == "scxml");
            if is_case && script.exists() {
                let name = path.strip_prefix(&folder).unwrap().with_extension("").display().to_string();
                results.insert(name.replace(".txml", ""), result(&path, &script));
            }
        }
    }
    let mut table = "| case | result |\n| --- | --- |\n".to_owned();
    for (name, result) in &results {
        writeln!(table, "| {name} | {result} |").unwrap();
    }
    let actual = Path::new(env!("CARGO_TARGET_TMPDIR")).join("w3c_cases.md");
    std::fs::write(&actual, &table).unwrap();
    let differing: Vec<String> = table
        .lines()
        .filter(|line| !TABLE.lines().any(|listed| listed == *line))
        .map(str::to_owned)
        .collect();
    assert!(
        table == TABLE,
        "{} differs from tests/w3c_cases.md:\n{}",
        actual.display(),
        differing.join("\n")
    );
    let passed = results.values().filter(|result| *result == "passed").count();
    println!("{passed} of {} cases pass, the others do not apply", results.len());
}

fn package() -> Option<PathBuf> {
    let modules = std::env::var_os("DOWNBEAT_NODE_MODULES").map(PathBuf::from);
    let modules =
        modules.unwrap_or_else(|| Path::new(env!("CARGO_TARGET_TMPDIR")).join("../node/node_modules"));
    let folder = modules.join("@scion-scxml/test-framework/test");
    folder.is_dir().then_some(folder)
}

fn result(path: &Path, script: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    // Comments say what other cases are about.
    let without_comments = without_comments(&text);
    if let Some((_, reason)) = OUTSIDE.iter().find(|(mark, _)| without_comments.contains(mark)) {
        return format!("n/a: {reason}");
    }
    let chart = match Chart::parse(path, &translated(&text)) {
        Ok(chart) => chart,
        Err(error) => {
            let problem = &error.problems[0];
            return format!("n/a: refused, {}", problem.text.replace(['\n', '|'], " "));
        }
    };
    let script: Value = serde_json::from_str(&std::fs::read_to_string(script).unwrap()).unwrap();
    let is_of_w3c = path.parent().is_some_and(|folder| folder.ends_with("w3c-ecma"));
    // SCION lets a parallel state stay active where appendix D exits and enters it; the cases have both
    // expectations.
    let is_legacy =
        ["more-parallel/test10.scxml", "more-parallel/test10b.scxml"].iter().any(|case| path.ends_with(case));
    let result = match (is_of_w3c, is_legacy) {
        (true, _) => run_to_pass(chart),
        (_, true) => run(chart, &script["legacySemantics"]),
        _ => run(chart, &script),
    };
    result.map_or_else(|problem| format!("FAILED: {problem}"), |()| "passed".to_owned())
}

fn without_comments(text: &str) -> String {
    let mut rest = text;
    let mut kept = String::new();
    while let Some(start) = rest.find("<!--") {
        kept.push_str(&rest[..start]);
        rest = rest[start..].find("-->").map_or("", |end| &rest[start + end + 3..]);
    }
    kept + rest
}

/// The cases of the W3C pass if they reach the state `pass`.
fn run_to_pass(chart: Chart) -> Result<(), String> {
    let mut machine = Interpreter::new(Arc::new(chart), "session");
    let mut log = faults(machine.start(Duration::ZERO));
    wait(&mut machine, Duration::ZERO, Duration::from_secs(60), &mut log);
    expect(&machine, &serde_json::json!(["pass"]), "at last", &log)
}

fn run(chart: Chart, script: &Value) -> Result<(), String> {
    let mut machine = Interpreter::new(Arc::new(chart), "session");
    let mut now = Duration::ZERO;
    let mut log = faults(machine.start(now));
    expect(&machine, &script["initialConfiguration"], "at first", &log)?;
    for event in script["events"].as_array().into_iter().flatten() {
        if let Some(after) = event["after"].as_u64() {
            now = wait(&mut machine, now, Duration::from_millis(after), &mut log);
        }
        let name = event["event"]["name"].as_str().unwrap();
        machine.send(Event::new(name, dynamic(&event["event"]["data"])));
        log.extend(faults(machine.advance(now)));
        expect(&machine, &event["nextConfiguration"], name, &log)?;
    }
    Ok(())
}

/// Lets time pass, in the steps of the delayed events.
fn wait(machine: &mut Interpreter, now: Duration, time: Duration, log: &mut Vec<String>) -> Duration {
    let end = now + time;
    while let Some(due) = machine.next_due().filter(|due| *due <= end) {
        log.extend(faults(machine.advance(due)));
    }
    log.extend(faults(machine.advance(end)));
    end
}

fn faults(effects: Vec<Effect>) -> Vec<String> {
    let text = |effect| match effect {
        Effect::Fault(problem) => Some(problem.to_string()),
        _ => None,
    };
    effects.into_iter().filter_map(text).collect()
}

fn expect(machine: &Interpreter, wanted: &Value, when: &str, log: &[String]) -> Result<(), String> {
    let wanted: BTreeSet<&str> = wanted.as_array().unwrap().iter().filter_map(Value::as_str).collect();
    let found: BTreeSet<&str> = machine.active_leaves().collect();
    if wanted == found {
        Ok(())
    } else {
        Err(format!("{when}: {found:?} and not {wanted:?}; {log:?}").replace('|', "/"))
    }
}

fn dynamic(value: &Value) -> Dynamic {
    match value {
        Value::Null => Dynamic::UNIT,
        Value::Bool(value) => (*value).into(),
        Value::Number(value) => {
            value.as_i64().map_or_else(|| value.as_f64().unwrap_or(0.0).into(), Dynamic::from_int)
        }
        Value::String(text) => text.clone().into(),
        Value::Array(values) => values.iter().map(dynamic).collect::<Vec<_>>().into(),
        Value::Object(fields) => {
            fields.iter().map(|(name, value)| (name.as_str().into(), dynamic(value))).collect::<Map>().into()
        }
    }
}
