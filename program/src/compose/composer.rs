//! An editor of robot files behind a page: a document, edits that keep comments and order, a check after each
//! edit, and the robot that runs what is edited.
//!
//! The page asks by name, with arguments as JSON:
//!
//! | ask | arguments | answer |
//! | --- | --- | --- |
//! | `profile` | | `{schema, kinds: [KindProfile], missing: [{kind, reason}], launchers, templates: [{name, title, about}], interfaces: [message type]}` |
//! | `document` | `refresh`? | the document, see below; `refresh` also looks again at the files of modules |
//! | `edit` | `edits: [Edit]` | the document after all of them; after an error nothing is changed |
//! | `undo`, `redo` | | the document |
//! | `save` | `overwrite`? | the document; if the file was changed by somebody else, `{conflict: {text}}` with its text, and nothing is saved |
//! | `reload` | | the document as the file is now; what was edited can be brought back by `undo` |
//! | `layout` | `modules: {name: {x, y}}` | null; written beside the robot file when it is saved |
//! | `run` | `record`? | starts the robot that is in the file, `{url}` once its page is there; `record` also records a bag |
//! | `stop` | | `output` after it has stopped |
//! | `output` | `after`? | `{is_running, lines, next, url?, bag?, exit_code?}`, the lines from number `after` on |
//!
//! A document has `revision`, `path`, `name`, `is_new`, `is_dirty`, `is_changed_on_disk`, `can_undo`,
//! `can_redo`, `text`, `sections`, `picture` and `layout`: `sections` are the tables `robot`, `launcher`,
//! `expose`, `record`, `replay` and `view` as JSON, `picture` has modules, topics, wires and problems.
//!
//! Edits are objects with `op`:
//!
//! | `op` | keys |
//! | --- | --- |
//! | `add_module` | `kind`, `name`?, `keys`? (those that only the kind has) |
//! | `remove_module` | `module` |
//! | `rename_module` | `module`, `name` |
//! | `move_module` | `module`, `to` (place in the order, from 0) |
//! | `set_setting` | `module`, `setting`, `value` (null: the default) |
//! | `set_key` | `module`, `key`, `value` (null: removed) |
//! | `set_topic` | `module`, `port`, `topic` (null: the port's own name) |
//! | `set` | `path` (such as `["launcher", "threads"]`), `value` |
//! | `connect` | `from`, `to`: `{module, port}`; `rename`: `"to"` (default) or `"from"`, the port that takes the name of the other |
//! | `disconnect` | `to` |
//! | `expose` | `list` (a key of `[expose]`), `name`, `on`, `type`? |
//! | `record` | `topic`, `on` |
//! | `text` | `text` |
//! | `template` | `name` |

use parking_lot::Mutex;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::child::{RobotProcess, Runner};
use super::disk::{Place, Saved};
use super::document::{Document, Edit, canonical};
use super::picture::{self, Drawing, Picture, PortName, Severity};
use super::templates;
use downbeat_robot::features::{built_without, missing_kinds};
use downbeat_robot::{Catalog, ModuleSource, PROFILE_SCHEMA};

/// How many changes can be undone.
const MOST_STEPS: usize = 500;

/// The longest text of a document.
pub(super) const LONGEST_TEXT: usize = 4 << 20;

/// How long a robot may take to open its page.
const START: Duration = Duration::from_secs(30);

const LOOK: Duration = Duration::from_millis(20);

/// Tables of the file that are shown as JSON.
const SECTIONS: [&str; 6] = ["robot", "launcher", "expose", "record", "replay", "view"];

/// A robot file that is edited.
pub struct Composer {
    runner: Runner,
    place: Place,
    state: Mutex<State>,
    robot: Mutex<Option<RobotProcess>>,
}

struct State {
    document: Document,
    /// Counts the changes, so that a page knows whether another one has edited.
    revision: u64,
    undo: Vec<Document>,
    redo: Vec<Document>,
    /// The file as it was read or written last.
    saved: Saved,
    layout: Map<String, Value>,
    is_layout_dirty: bool,
    drawing: Drawing,
    /// The text that was drawn last, and its picture.
    drawn: Option<(String, Picture)>,
}

/// An edit that depends on the ports of modules, or one of the text alone.
#[derive(Deserialize)]
#[serde(untagged)]
enum Change {
    Wire(WireEdit),
    Text(Edit),
}

#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
enum WireEdit {
    Connect {
        from: PortName,
        to: PortName,
        #[serde(default)]
        rename: End,
    },
    Disconnect {
        to: PortName,
    },
}

#[derive(Clone, Copy, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
enum End {
    From,
    #[default]
    To,
}

pub(super) type Answer = Result<Value, String>;

impl Composer {
    /// Opens a robot file, which may not exist yet.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn open(path: &Path, catalog: Catalog, runner: Runner) -> io::Result<Self> {
        let place = Place::new(path)?;
        let saved = place.read()?;
        let layout = place.read_layout();
        let text = saved.text().unwrap_or_default().to_owned();
        let state = State {
            document: Document::new(text),
            revision: 0,
            undo: Vec::new(),
            redo: Vec::new(),
            saved,
            layout,
            is_layout_dirty: false,
            drawing: Drawing::new(catalog),
            drawn: None,
        };
        Ok(Self { runner, place, state: Mutex::new(state), robot: Mutex::new(None) })
    }

    /// The path of the robot file.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.place.path()
    }

    /// Answers an ask of the page.
    ///
    /// # Errors
    /// In words for the user.
    pub fn ask(&self, ask: &str, arguments: &Value) -> Answer {
        match ask {
            "profile" => Ok(profile(self.state.lock().drawing.catalog())),
            "document" => {
                let mut state = self.state.lock();
                if is_set(arguments, "refresh") {
                    state.forget();
                }
                Ok(self.show(&mut state))
            }
            "edit" => self.edit(arguments),
            "undo" | "redo" => self.step(ask == "undo"),
            "save" => self.save(is_set(arguments, "overwrite")),
            "reload" => self.reload(),
            "layout" => self.arrange(arguments),
            "run" => self.run(is_set(arguments, "record")),
            "stop" => self.stop(),
            "output" => Ok(self.output(arguments.get("after").and_then(Value::as_u64).unwrap_or(0))),
            other => Err(format!("the editor does not know the question \"{other}\"")),
        }
    }

    fn show(&self, state: &mut State) -> Value {
        let picture = state.picture(self.place.path());
        let State { document, revision, undo, redo, saved, layout, is_layout_dirty, .. } = state;
        let sections: Map<_, _> =
            SECTIONS.iter().map(|&name| (name.to_owned(), document.table(name))).collect();
        let is_changed = self.place.read().is_ok_and(|now| now != *saved);
        json!({
            "revision": revision,
            "path": self.place.path(),
            "name": self.place.path().file_name().map(|name| name.to_string_lossy()),
            "is_new": saved.text().is_none(),
            "is_dirty": saved.text().unwrap_or_default() != document.text() || *is_layout_dirty,
            "is_changed_on_disk": is_changed,
            "can_undo": !undo.is_empty(),
            "can_redo": !redo.is_empty(),
            "text": document.text(),
            "sections": sections,
            "picture": picture,
            "layout": layout,
        })
    }

    fn edit(&self, arguments: &Value) -> Answer {
        let edits = arguments.get("edits").and_then(Value::as_array).ok_or("`edits` is a list of changes")?;
        let mut state = self.state.lock();
        let mut document = state.document.clone();
        for edit in edits {
            let change = change(edit)?;
            document = match change {
                Change::Text(edit) => {
                    let edited = document.edited(&edit)?;
                    if let Edit::Template { name } = &edit {
                        self.place.add_files(templates::find(name)?.files)?;
                    }
                    edited
                }
                Change::Wire(edit) => {
                    let picture = state.drawing.draw(&document, self.place.path());
                    rewired(&document, &picture, &edit)?
                }
            };
            if document.text().len() > LONGEST_TEXT {
                return Err(format!("a robot file has at most {LONGEST_TEXT} bytes"));
            }
        }
        if document.text() != state.document.text() {
            let renamed = edits.iter().filter(|edit| edit["op"] == "rename_module");
            for (from, to) in
                renamed.filter_map(|edit| Some((edit["module"].as_str()?, edit["name"].as_str()?)))
            {
                if let Some(place) = state.layout.remove(from) {
                    state.layout.insert(to.to_owned(), place);
                    state.is_layout_dirty = true;
                }
            }
            let before = std::mem::replace(&mut state.document, document);
            if state.undo.len() == MOST_STEPS {
                state.undo.remove(0);
            }
            state.undo.push(before);
            state.redo.clear();
            state.revision += 1;
        }
        Ok(self.show(&mut state))
    }

    fn step(&self, is_back: bool) -> Answer {
        let mut state = self.state.lock();
        let State { document, undo, redo, revision, .. } = &mut *state;
        let (from, to) = if is_back { (undo, redo) } else { (redo, undo) };
        let word = if is_back { "undo" } else { "redo" };
        let next = from.pop().ok_or_else(|| format!("there is nothing to {word}"))?;
        to.push(std::mem::replace(document, next));
        *revision += 1;
        Ok(self.show(&mut state))
    }

    fn save(&self, overwrite: bool) -> Answer {
        let mut state = self.state.lock();
        let now = self.place.read().map_err(|error| self.place.failed("read", &error))?;
        if now != state.saved && !overwrite {
            return Ok(json!({ "conflict": { "text": now.text() } }));
        }
        let names: Vec<String> = state.document.sections().into_iter().map(|section| section.name).collect();
        state.layout.retain(|name, _| names.contains(name));
        state.saved =
            self.place.write(state.document.text()).map_err(|error| self.place.failed("write", &error))?;
        self.place
            .write_layout(&state.layout)
            .map_err(|error| self.place.failed("write the places of modules beside", &error))?;
        state.is_layout_dirty = false;
        Ok(self.show(&mut state))
    }

    fn reload(&self) -> Answer {
        let mut state = self.state.lock();
        state.saved = self.place.read().map_err(|error| self.place.failed("read", &error))?;
        state.forget();
        let document = Document::new(state.saved.text().unwrap_or_default().to_owned());
        if document.text() != state.document.text() {
            let before = std::mem::replace(&mut state.document, document);
            state.undo.push(before);
            state.redo.clear();
            state.revision += 1;
        }
        Ok(self.show(&mut state))
    }

    fn arrange(&self, arguments: &Value) -> Answer {
        let modules =
            arguments.get("modules").and_then(Value::as_object).ok_or("`modules` has places by name")?;
        let mut state = self.state.lock();
        let names: Vec<String> = state.document.sections().into_iter().map(|section| section.name).collect();
        let mut layout = Map::new();
        for (name, place) in modules.iter().filter(|(name, _)| names.contains(name)) {
            let number = |key: &str| place.get(key).and_then(Value::as_f64).filter(|value| value.abs() < 1e6);
            let (Some(x), Some(y)) = (number("x"), number("y")) else {
                return Err(format!("the place of \"{name}\" is not x and y"));
            };
            layout.insert(name.clone(), json!({ "x": x.round(), "y": y.round() }));
        }
        if state.layout != layout {
            state.layout = layout;
            state.is_layout_dirty = true;
        }
        Ok(Value::Null)
    }

    fn run(&self, record: bool) -> Answer {
        {
            let mut state = self.state.lock();
            let is_saved = self.place.read().is_ok_and(|now| now.text() == Some(state.document.text()));
            if !is_saved {
                return Err("save the robot file first: the robot runs what is in the file".to_owned());
            }
            state.forget();
            let picture = state.picture(self.place.path());
            if let Some(problem) = picture.problems.iter().find(|problem| problem.severity == Severity::Error)
            {
                return Err(format!("the robot does not start: line {}: {}", problem.line, problem.problem));
            }
        }
        let mut robot = self.robot.lock();
        if robot.as_mut().is_some_and(RobotProcess::is_running) {
            return Err("the robot runs already; stop it first".to_owned());
        }
        let bag = record.then(|| self.place.new_bag(&clock()));
        *robot = Some(RobotProcess::start(&self.runner, self.place.path(), bag)?);
        drop(robot);
        let deadline = Instant::now() + START;
        loop {
            // Not locked while it waits, so that `output` and `stop` are answered.
            if let Some(robot) = self.robot.lock().as_mut() {
                if let Some(url) = robot.url() {
                    return Ok(json!({ "url": url }));
                }
                if !robot.is_running() {
                    return Err("the robot ended at its start; its output says why".to_owned());
                }
            }
            if Instant::now() > deadline {
                return Err("the robot runs, but its page is not there yet; see its output".to_owned());
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Stops the robot that was started here, if it runs.
    pub fn stop_robot(&self) {
        drop(self.robot.lock().take());
    }

    fn stop(&self) -> Answer {
        let running = self.robot.lock().take();
        let Some(mut robot) = running else { return Err("no robot was started here".to_owned()) };
        robot.stop();
        let report = robot.report(0);
        *self.robot.lock() = Some(robot);
        Ok(report)
    }

    fn output(&self, after: u64) -> Value {
        match self.robot.lock().as_mut() {
            Some(robot) => robot.report(after),
            None => json!({ "is_running": false, "lines": [], "next": 0 }),
        }
    }
}

impl State {
    /// Draws the document, unless it is as it was.
    fn picture(&mut self, path: &Path) -> Picture {
        let Self { document, drawing, drawn, .. } = self;
        if let Some((_, picture)) = drawn.as_ref().filter(|(text, _)| text == document.text()) {
            return picture.clone();
        }
        let picture = drawing.draw(document, path);
        *drawn = Some((document.text().to_owned(), picture.clone()));
        picture
    }

    /// Looks at everything again: files that the robot names may have changed.
    fn forget(&mut self) {
        self.drawing.forget();
        self.drawn = None;
    }
}

fn is_set(arguments: &Value, name: &str) -> bool {
    arguments.get(name).and_then(Value::as_bool).unwrap_or(false)
}

/// Reads a change. Errors of an untagged enum would not say what is wrong.
fn change(edit: &Value) -> Result<Change, String> {
    let read = |error: serde_json::Error| format!("an edit is not understood: {error}");
    Ok(match edit["op"].as_str() {
        Some("connect" | "disconnect") => Change::Wire(WireEdit::deserialize(edit).map_err(read)?),
        _ => Change::Text(Edit::deserialize(edit).map_err(read)?),
    })
}

/// The document after a wire was drawn or cut.
fn rewired(document: &Document, picture: &Picture, edit: &WireEdit) -> Result<Document, String> {
    let port = |name: &PortName| {
        let module = picture.modules.iter().find(|module| module.name == name.module);
        let module = module.ok_or_else(|| format!("there is no module \"{}\"", name.module))?;
        let port = module.ports.iter().find(|port| port.profile.name == name.port);
        port.ok_or_else(|| format!("\"{}\" has no port \"{}\"", name.module, name.port))
    };
    let rename = |name: &PortName, topic: &str| {
        let topic = Some(topic.to_owned());
        document.edited(&Edit::SetTopic { module: name.module.clone(), port: name.port.clone(), topic })
    };
    match edit {
        WireEdit::Connect { from, to, rename: end } => {
            let (source, sink) = (port(from)?, port(to)?);
            picture::refusal(source, sink).map_or(Ok(()), Err)?;
            match end {
                End::To => rename(to, &source.topic),
                End::From => rename(from, &sink.topic),
            }
        }
        WireEdit::Disconnect { to } => {
            let sink = port(to)?;
            let taken = |name: &str| {
                let of_kind = picture.topics.iter().filter(|topic| topic.what == sink.profile.what);
                of_kind.into_iter().any(|topic| topic.name == name && topic.has_source)
            };
            // Its own name again, or one that nothing publishes or serves.
            let own = canonical(&to.port).to_owned();
            let others = (1..).map(|number| match number {
                1 => format!("{}/{own}", to.module),
                number => format!("{}/{own}_{number}", to.module),
            });
            let mut names = std::iter::once(own.clone()).chain(others);
            let free = names.find(|name| *name != sink.topic && !taken(name)).unwrap_or_default();
            rename(to, &free)
        }
    }
}

/// What the editor offers.
fn profile(catalog: &Catalog) -> Value {
    let kinds: Vec<_> = catalog
        .kinds()
        .filter_map(|kind| catalog.profile(kind.name(), &BTreeMap::new(), &ModuleSource::default()))
        .collect();
    let missing: Vec<_> = missing_kinds(catalog)
        .into_iter()
        .map(|(kind, feature)| json!({ "kind": kind, "reason": built_without(feature) }))
        .collect();
    let templates: Vec<_> = templates::usable(catalog).collect();
    let messages: Vec<&str> = catalog.interfaces.messages().map(|message| message.name()).collect();
    json!({
        "schema": PROFILE_SCHEMA,
        "kinds": kinds,
        "missing": missing,
        "launchers": catalog.launchers().collect::<Vec<_>>(),
        "templates": templates,
        "interfaces": messages,
    })
}

/// Seconds since 1970, for names of bags.
fn clock() -> String {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs().to_string()
}
