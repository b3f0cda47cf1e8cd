//! The text of a robot file, and edits of it that keep comments and order.

use downbeat_bridge::expose::TopicPattern;
use serde::Deserialize;
use serde_json::{Map, Value as Json};
use std::ops::Range;
use toml_edit::{
    Array, ArrayOfTables, Document as Parsed, DocumentMut, InlineTable, Item, Table, TableLike, Value,
};

use super::templates;

/// A robot file that is edited: its text, always valid TOML after an edit.
#[derive(Clone, Debug)]
pub(crate) struct Document {
    text: String,
}

/// A change of the document.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Edit {
    /// Adds a module of a kind, with the keys of `[[module]]` that the kind has; named like the kind if no
    /// name is given, with a number if that name is in use.
    AddModule {
        kind: String,
        name: Option<String>,
        #[serde(default)]
        keys: Map<String, Json>,
    },
    /// Removes a module, with the comment above it.
    RemoveModule { module: String },
    /// Renames a module, also where the file names it.
    RenameModule { module: String, name: String },
    /// Moves a module to a place in the order of the file, from 0.
    MoveModule { module: String, to: usize },
    /// Gives a setting a value; without one, removes it. With `is_double`, whole numbers are written with a
    /// decimal point.
    SetSetting {
        module: String,
        setting: String,
        #[serde(default)]
        value: Json,
        #[serde(default)]
        is_double: bool,
    },
    /// Sets a key of `[[module]]`; without a value, removes it.
    SetKey {
        module: String,
        key: String,
        #[serde(default)]
        value: Json,
    },
    /// Gives a port the name of a topic, service or action; without one, its own name.
    SetTopic { module: String, port: String, topic: Option<String> },
    /// Sets a value by the keys that lead to it, such as `["launcher", "threads"]`; without a value, removes
    /// it.
    Set {
        path: Vec<String>,
        #[serde(default)]
        value: Json,
    },
    /// Exposes a name to ROS 2, or no longer. `list` is a key of `[expose]`: `out`, `in`, `services`, …
    Expose {
        list: String,
        name: String,
        on: bool,
        #[serde(rename = "type")]
        type_name: Option<String>,
    },
    /// Records a topic, or leaves it out.
    Record { topic: String, on: bool },
    /// Replaces the whole text.
    Text { text: String },
    /// Replaces the whole text by a template.
    Template { name: String },
}

/// Why a text is no TOML.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SyntaxError {
    /// From 1.
    pub(crate) line: usize,
    pub(crate) problem: String,
}

/// A module in the text.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Section {
    pub(crate) name: String,
    pub(crate) kind: String,
    /// What the file says, as JSON.
    pub(crate) given: Json,
    /// From its header to the next one that is not its own.
    pub(crate) range: Range<usize>,
}

type Result<T> = std::result::Result<T, String>;

/// Tables whose keys [`Edit::Set`] changes.
const TABLES: [&str; 6] = ["robot", "launcher", "expose", "record", "replay", "view"];

impl Document {
    pub(crate) fn new(text: String) -> Self {
        Self { text }
    }

    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// The error of a text that is no TOML.
    pub(crate) fn syntax_error(&self) -> Option<SyntaxError> {
        let error = self.text.parse::<DocumentMut>().err()?;
        let start = error.span().map_or(0, |span| span.start.min(self.text.len()));
        Some(SyntaxError { line: self.line_of(start), problem: error.message().to_owned() })
    }

    /// The line of a byte, from 1.
    pub(crate) fn line_of(&self, start: usize) -> usize {
        downbeat_files::lines::line_of(&self.text, start)
    }

    /// The text of a line, from 1.
    pub(crate) fn line(&self, number: usize) -> &str {
        self.text.lines().nth(number.saturating_sub(1)).unwrap_or_default()
    }

    /// The modules in the order of the file; none if the text is no TOML.
    pub(crate) fn sections(&self) -> Vec<Section> {
        let Ok(parsed) = Parsed::parse(self.text.as_str()) else { return Vec::new() };
        let Some(modules) = parsed.as_table().get("module").and_then(Item::as_array_of_tables) else {
            return Vec::new();
        };
        let is_own = |name: &str| name == "module";
        let mut starts: Vec<usize> = modules.iter().filter_map(|table| Some(table.span()?.start)).collect();
        for (_, item) in parsed.as_table().iter().filter(|(name, _)| !is_own(name)) {
            starts.extend(headers(item));
        }
        let section = |table: &Table| {
            let span = table.span()?;
            let next = starts.iter().copied().filter(|&start| start > span.start).min();
            let kind = table.get("kind").and_then(Item::as_str).unwrap_or_default().to_owned();
            let name = table.get("name").and_then(Item::as_str).unwrap_or(&kind).to_owned();
            let given = json_of_table(table);
            Some(Section { name, kind, given, range: span.start..next.unwrap_or(self.text.len()) })
        };
        modules.iter().filter_map(section).collect()
    }

    /// A table of the file as JSON; null if it is missing.
    pub(crate) fn table(&self, name: &str) -> Json {
        let parsed = Parsed::parse(self.text.as_str());
        parsed.ok().and_then(|parsed| parsed.as_table().get(name).map(json_of)).unwrap_or_default()
    }

    /// Returns the document after a change.
    ///
    /// # Errors
    /// In words for the user, if the change is not possible.
    pub(crate) fn edited(&self, edit: &Edit) -> Result<Self> {
        let text = match edit {
            Edit::Text { text } => text.clone(),
            Edit::Template { name } => templates::find(name)?.text.to_owned(),
            Edit::MoveModule { module, to } => self.moved(module, *to)?,
            _ => {
                let mut document = self.parsed()?;
                change(&mut document, edit)?;
                document.to_string()
            }
        };
        let document = Self { text };
        match document.syntax_error() {
            None => Ok(document),
            Some(SyntaxError { line, problem }) => Err(format!("line {line}: {problem}")),
        }
    }

    fn parsed(&self) -> Result<DocumentMut> {
        self.text.parse().map_err(|error: toml_edit::TomlError| {
            let line = self.line_of(error.span().map_or(0, |span| span.start));
            format!("line {line} is no TOML: {}; correct the text first", error.message())
        })
    }

    /// The text with a module at another place, with the comment above it.
    fn moved(&self, module: &str, to: usize) -> Result<String> {
        self.parsed()?;
        let sections = self.sections();
        let from = sections.iter().position(|section| section.name == module);
        let from = from.ok_or_else(|| no_module(module))?;
        let to = to.min(sections.len() - 1);
        let pieces: Vec<Range<usize>> = sections
            .iter()
            .map(|section| self.above(section.range.start)..self.above(section.range.end))
            .collect();
        if pieces.windows(2).any(|pair| pair[0].end != pair[1].start) {
            return Err("other tables stand between the modules of this file: move it in the text".to_owned());
        }
        let whole = pieces[0].start..pieces[pieces.len() - 1].end;
        let mut texts: Vec<String> = pieces.iter().map(|piece| self.text[piece.clone()].to_owned()).collect();
        let leading = self.text[..whole.start].is_empty();
        let piece = texts.remove(from);
        texts.insert(to, piece);
        // Each piece but the first of a file begins with an empty line, the last may lack its line break.
        for (position, text) in texts.iter_mut().enumerate() {
            if !text.ends_with('\n') {
                text.push('\n');
            }
            let is_first = leading && position == 0;
            if !is_first && !text.starts_with('\n') {
                text.insert(0, '\n');
            }
        }
        let moved = texts.concat();
        Ok(format!("{}{moved}{}", &self.text[..whole.start], &self.text[whole.end..]))
    }

    /// The start of the comments and empty lines right above a header.
    fn above(&self, header: usize) -> usize {
        let mut start = header;
        if header == self.text.len() {
            return header;
        }
        for line in self.text[..header].split_inclusive('\n').rev() {
            let content = line.trim();
            if !content.is_empty() && !content.starts_with('#') {
                break;
            }
            start -= line.len();
        }
        start
    }
}

/// Where the headers of tables begin.
fn headers(item: &Item) -> Vec<usize> {
    match item {
        Item::Table(table) => {
            let own = table.span().filter(|_| !table.is_implicit() && !table.is_dotted());
            let inner = table.iter().flat_map(|(_, item)| headers(item));
            own.map(|span| span.start).into_iter().chain(inner).collect()
        }
        Item::ArrayOfTables(tables) => tables.iter().filter_map(|table| Some(table.span()?.start)).collect(),
        Item::Value(_) | Item::None => Vec::new(),
    }
}

fn no_module(name: &str) -> String {
    format!("there is no module \"{name}\"")
}

fn change(document: &mut DocumentMut, edit: &Edit) -> Result<()> {
    match edit {
        Edit::AddModule { kind, name, keys } => add_module(document, kind, name.as_deref(), keys),
        Edit::RemoveModule { module } => {
            let index = position(document, module)?;
            modules(document)?.remove(index);
            Ok(())
        }
        Edit::RenameModule { module, name } => rename_module(document, module, name),
        Edit::SetSetting { module, setting, value, is_double } => {
            let value = value_of(value, *is_double)?;
            set_in(module_mut(document, module)?, "settings", setting, value)
        }
        Edit::SetKey { module, key, value } => {
            if ["kind", "name", "settings", "remap"].contains(&key.as_str()) {
                return Err(format!("\"{key}\" of a module has an edit of its own"));
            }
            set(module_mut(document, module)?, key, value_of(value, false)?);
            Ok(())
        }
        Edit::SetTopic { module, port, topic } => {
            let value = topic.as_deref().filter(|topic| topic != port).map(Value::from);
            set_in(module_mut(document, module)?, "remap", port, value)
        }
        Edit::Set { path, value } => set_path(document, path, value_of(value, false)?),
        Edit::Expose { list, name, on, type_name } => expose(document, list, name, *on, type_name.as_deref()),
        Edit::Record { topic, on } => record(document, topic, *on),
        Edit::MoveModule { .. } | Edit::Text { .. } | Edit::Template { .. } => Ok(()),
    }
}

fn modules(document: &mut DocumentMut) -> Result<&mut ArrayOfTables> {
    let item = document.entry("module").or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    item.as_array_of_tables_mut().ok_or_else(|| {
        "the modules of this file are one list; write each as [[module]] to edit them here".to_owned()
    })
}

fn name_of(table: &Table) -> &str {
    let text = |key| table.get(key).and_then(Item::as_str);
    text("name").or_else(|| text("kind")).unwrap_or_default()
}

fn position(document: &mut DocumentMut, name: &str) -> Result<usize> {
    modules(document)?.iter().position(|table| name_of(table) == name).ok_or_else(|| no_module(name))
}

fn module_mut<'a>(document: &'a mut DocumentMut, name: &str) -> Result<&'a mut Table> {
    let index = position(document, name)?;
    modules(document)?.get_mut(index).ok_or_else(|| no_module(name))
}

fn add_module(
    document: &mut DocumentMut,
    kind: &str,
    name: Option<&str>,
    keys: &Map<String, Json>,
) -> Result<()> {
    if document.get("robot").is_none() {
        let mut robot = Table::new();
        robot.insert("name", Value::from("robot").into());
        document.insert("robot", Item::Table(robot));
    }
    let modules = modules(document)?;
    let taken: Vec<String> = modules.iter().map(|table| name_of(table).to_owned()).collect();
    if let Some(name) = name.filter(|name| taken.iter().any(|taken| taken == name)) {
        return Err(format!("there is a module \"{name}\" already"));
    }
    let mut names = std::iter::once(kind.to_owned()).chain((2..).map(|number| format!("{kind}_{number}")));
    let free = names.find(|name| !taken.contains(name));
    let mut table = Table::new();
    table.decor_mut().set_prefix("\n");
    let name = name.map(str::to_owned).or(free).unwrap_or_default();
    table.insert("name", Value::from(name).into());
    table.insert("kind", Value::from(kind).into());
    for (key, value) in keys {
        if let Some(value) = value_of(value, false)? {
            table.insert(key, value.into());
        }
    }
    modules.push(table);
    Ok(())
}

fn rename_module(document: &mut DocumentMut, module: &str, name: &str) -> Result<()> {
    if module == name {
        return Ok(());
    }
    if position(document, name).is_ok() {
        return Err(format!("there is a module \"{name}\" already"));
    }
    set(module_mut(document, module)?, "name", Some(name.into()));
    let of_settings = format!("{module}.");
    let renamed = |text: &str| match text.strip_prefix(&of_settings) {
        _ if text == module => Some(name.to_owned()),
        Some(setting) => Some(format!("{name}.{setting}")),
        None => None,
    };
    for (table, list) in
        [("expose", "parameters"), ("expose", "lifecycle"), ("record", "modules"), ("replay", "modules")]
    {
        let table = document.get_mut(table).and_then(Item::as_table_like_mut);
        let Some(list) = table.and_then(|table| table.get_mut(list)?.as_array_mut()) else { continue };
        for value in list.iter_mut() {
            let place = match value {
                Value::InlineTable(entry) => entry.get_mut("module"),
                value => Some(value),
            };
            if let Some(place) = place
                && let Some(new) = place.as_str().and_then(renamed)
            {
                replace(place, new.into());
            }
        }
    }
    Ok(())
}

/// Puts a value in the place of another, with the comments around it.
fn replace(place: &mut Value, value: Value) {
    let decor = place.decor().clone();
    *place = value;
    *place.decor_mut() = decor;
}

fn set(table: &mut dyn TableLike, key: &str, value: Option<Value>) {
    match (value, table.get_mut(key)) {
        (None, _) => {
            table.remove(key);
        }
        (Some(value), Some(Item::Value(place))) => replace(place, value),
        (Some(value), _) => {
            table.insert(key, Item::Value(value));
        }
    }
}

/// Sets a key of a table in a table, which is created inline if it is missing, and removed when it is empty.
fn set_in(table: &mut Table, name: &str, key: &str, value: Option<Value>) -> Result<()> {
    if value.is_none() && table.get(name).is_none() {
        return Ok(());
    }
    let item = table.entry(name).or_insert(Item::Value(InlineTable::new().into()));
    let inner =
        item.as_table_like_mut().ok_or_else(|| format!("\"{name}\" is no table; correct it in the text"))?;
    let has_key = inner.contains_key(key);
    let is_changed = has_key != value.is_some();
    set(inner, key, value);
    let is_empty = inner.is_empty();
    if let Some(inline) = item.as_inline_table_mut()
        && is_changed
        && !inline.to_string().contains('\n')
    {
        inline.fmt();
    }
    if is_empty {
        table.remove(name);
    }
    Ok(())
}

fn set_path(document: &mut DocumentMut, path: &[String], value: Option<Value>) -> Result<()> {
    let Some((key, tables)) = path.split_last() else { return Err("the path is empty".to_owned()) };
    let Some((first, inner)) = tables.split_first() else {
        return Err(format!("\"{key}\" is no key of a table"));
    };
    if !TABLES.contains(&first.as_str()) {
        return Err(format!("\"{first}\" is none of {}", TABLES.join(", ")));
    }
    if value.is_none() && document.get(first).is_none() {
        return Ok(());
    }
    let place = table_mut(document, first)?;
    match inner {
        [] => set(place, key, value),
        [name] => {
            let table = place.entry(name).or_insert(Item::Value(InlineTable::new().into()));
            let table = table.as_table_like_mut().ok_or_else(|| format!("\"{name}\" is no table"))?;
            set(table, key, value);
        }
        _ => return Err("the path has too many parts".to_owned()),
    }
    // `[launcher]` without keys is not valid, `[record]` without keys says nothing.
    if document.get(first).and_then(Item::as_table).is_some_and(Table::is_empty) && first != "robot" {
        document.remove(first);
    }
    Ok(())
}

/// A table of the file, which is created if it is missing.
fn table_mut<'a>(document: &'a mut DocumentMut, name: &str) -> Result<&'a mut dyn TableLike> {
    let is_first = document.is_empty();
    let item = document.entry(name).or_insert_with(|| {
        let mut table = Table::new();
        if !is_first {
            table.decor_mut().set_prefix("\n");
        }
        Item::Table(table)
    });
    item.as_table_like_mut().ok_or_else(|| format!("\"{name}\" is no table; correct it in the text"))
}

/// The list under a key, which is created if it is missing.
fn list_mut<'a>(table: &'a mut dyn TableLike, key: &str) -> Result<&'a mut Array> {
    let item = table.entry(key).or_insert(Item::Value(Array::new().into()));
    item.as_array_mut().ok_or_else(|| format!("\"{key}\" is no list; correct it in the text"))
}

fn expose(
    document: &mut DocumentMut,
    list: &str,
    name: &str,
    on: bool,
    type_name: Option<&str>,
) -> Result<()> {
    let key = match list {
        "out" | "in" => "topic",
        "services" | "calls" => "service",
        "actions" | "action_calls" => "action",
        "lifecycle" => "module",
        _ => return Err(format!("\"{list}\" is no list of [expose]")),
    };
    if !on && document.get("expose").and_then(|table| table.get(list)).is_none() {
        return Ok(());
    }
    let entries = list_mut(table_mut(document, "expose")?, list)?;
    let name_in = |entry: &Value| match entry {
        Value::InlineTable(table) => table.get(key).and_then(Value::as_str).map(str::to_owned),
        entry => entry.as_str().map(str::to_owned),
    };
    let is_it = |entry: &Value| name_in(entry).is_some_and(|text| canonical(&text) == canonical(name));
    if !on {
        take_out_all(entries, is_it);
        for entry in entries.iter_mut() {
            let Some(pattern) = name_in(entry).filter(|text| matches(text, name)) else { continue };
            match entry {
                Value::InlineTable(table) => {
                    append(list_mut(table, "except")?, name.into());
                    table.fmt();
                }
                entry => {
                    let mut table = InlineTable::new();
                    table.insert(key, pattern.into());
                    table.insert("except", Value::Array([name].into_iter().collect()));
                    replace(entry, table.into());
                }
            }
        }
        return Ok(());
    }
    if entries.iter().any(is_it) {
        return Ok(());
    }
    for entry in entries.iter_mut() {
        let covers = name_in(entry).is_some_and(|text| matches(&text, name));
        if let Some(table) = entry.as_inline_table_mut().filter(|_| covers)
            && let Some(except) = table.get_mut("except").and_then(Value::as_array_mut)
        {
            let was = except.len();
            except.retain(|value| value.as_str().map(canonical) != Some(canonical(name)));
            if except.len() < was {
                if except.is_empty() {
                    table.remove("except");
                }
                table.fmt();
                return Ok(());
            }
        }
    }
    let entry = match type_name {
        None => name.into(),
        Some(type_name) => {
            let mut table = InlineTable::new();
            table.insert(key, name.into());
            table.insert("type", type_name.into());
            table.into()
        }
    };
    append(entries, entry);
    Ok(())
}

fn record(document: &mut DocumentMut, topic: &str, on: bool) -> Result<()> {
    let table = table_mut(document, "record")?;
    let is_it = |value: &Value| value.as_str().map(canonical) == Some(canonical(topic));
    if on {
        if let Some(except) = table.get_mut("except").and_then(Item::as_array_mut) {
            take_out_all(except, is_it);
            if except.is_empty() {
                table.remove("except");
            }
        }
        if let Some(topics) = table.get_mut("topics").and_then(Item::as_array_mut) {
            let is_chosen =
                |value: &Value| is_it(value) || value.as_str().is_some_and(|text| matches(text, topic));
            if !topics.iter().any(is_chosen) {
                append(topics, topic.into());
            }
        }
    } else {
        let mut is_left_out = false;
        if let Some(topics) = table.get_mut("topics").and_then(Item::as_array_mut) {
            take_out_all(topics, is_it);
            let mut patterns = topics.iter().filter_map(Value::as_str);
            is_left_out = !patterns.any(|pattern| matches(pattern, topic));
        }
        if !is_left_out {
            let except = list_mut(table, "except")?;
            if !except.iter().any(is_it) {
                append(except, topic.into());
            }
        }
    }
    if document.get("record").and_then(Item::as_table).is_some_and(Table::is_empty) {
        document.remove("record");
    }
    Ok(())
}

/// The name without the slash that it may begin with.
pub(crate) fn canonical(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

/// True if the text is a pattern that matches the name.
pub(crate) fn matches(pattern: &str, name: &str) -> bool {
    let pattern = canonical(pattern);
    TopicPattern::is_pattern(pattern)
        && TopicPattern::new(pattern).is_ok_and(|pattern| pattern.matches(canonical(name)))
}

/// Appends to a list, on a line of its own if the others are.
fn append(list: &mut Array, value: Value) {
    let of =
        |raw: Option<&toml_edit::RawString>| raw.and_then(|raw| raw.as_str()).unwrap_or_default().to_owned();
    let last = list.len().checked_sub(1);
    let prefix = last.and_then(|last| list.get(last)).map(|value| of(value.decor().prefix()));
    let (Some(last), Some((_, indent))) =
        (last, prefix.as_deref().and_then(|prefix| prefix.rsplit_once('\n')))
    else {
        list.push(value);
        return;
    };
    // What stands between the last value and the bracket: comments of the last value.
    let mut between = of(Some(list.trailing()));
    if !list.trailing_comma()
        && let Some(last) = list.get_mut(last)
    {
        between = of(last.decor().suffix()) + between.as_str();
        last.decor_mut().set_suffix("");
    }
    let (comments, end) = between.rsplit_once('\n').unwrap_or(("", ""));
    let (before, after) = (format!("{comments}\n{indent}"), format!("\n{end}"));
    list.push_formatted(value.decorated(before, ""));
    list.set_trailing(after);
    list.set_trailing_comma(true);
}

fn take_out_all(list: &mut Array, is_meant: impl Fn(&Value) -> bool) {
    let is_meant = |index: &usize| list.get(*index).is_some_and(&is_meant);
    let meant: Vec<usize> = (0..list.len()).filter(is_meant).collect();
    meant.into_iter().rev().for_each(|index| take_out(list, index));
}

/// Removes from a list, with the comment of the value and not with that of the value before.
fn take_out(list: &mut Array, index: usize) {
    let of =
        |raw: Option<&toml_edit::RawString>| raw.and_then(|raw| raw.as_str()).unwrap_or_default().to_owned();
    let removed = list.remove(index);
    let before = of(removed.decor().prefix());
    let (head, tail) = before.split_once('\n').map_or(("", None), |(head, tail)| (head, Some(tail)));
    if let Some(next) = list.get_mut(index) {
        let own = of(next.decor().prefix());
        let joined = match (own.split_once('\n'), tail) {
            (Some((_, own)), Some(_)) => format!("{head}\n{own}"),
            _ => before,
        };
        next.decor_mut().set_prefix(joined);
    } else if tail.is_some() {
        let own = of(Some(list.trailing()));
        let end = own.rsplit_once('\n').map_or("", |(_, end)| end).to_owned();
        list.set_trailing(format!("{head}\n{end}"));
    }
}

/// A value of the file from JSON; `None` for null.
fn value_of(json: &Json, is_double: bool) -> Result<Option<Value>> {
    Ok(Some(match json {
        Json::Null => return Ok(None),
        Json::Bool(value) => (*value).into(),
        Json::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(integer), Some(double)) if is_double && integer.unsigned_abs() < 1 << 53 => double.into(),
            (Some(integer), _) => integer.into(),
            (None, Some(double)) => double.into(),
            (None, None) => return Err(format!("{number} is too large")),
        },
        Json::String(text) => text.as_str().into(),
        Json::Array(values) => {
            let values = values.iter().map(|value| {
                value_of(value, is_double)?.ok_or_else(|| "a list has no empty values".to_owned())
            });
            Value::Array(values.collect::<Result<_>>()?)
        }
        Json::Object(keys) => {
            let mut table = InlineTable::new();
            for (key, value) in keys {
                if let Some(value) = value_of(value, is_double)? {
                    table.insert(key, value);
                }
            }
            table.into()
        }
    }))
}

fn json_of(item: &Item) -> Json {
    match item {
        Item::None => Json::Null,
        Item::Value(value) => json_of_value(value),
        Item::Table(table) => json_of_table(table),
        Item::ArrayOfTables(tables) => tables.iter().map(json_of_table).collect(),
    }
}

fn json_of_table(table: &Table) -> Json {
    Json::Object(table.iter().map(|(key, item)| (key.to_owned(), json_of(item))).collect())
}

fn json_of_value(value: &Value) -> Json {
    match value {
        Value::String(text) => text.value().as_str().into(),
        Value::Integer(number) => (*number.value()).into(),
        Value::Float(number) => (*number.value()).into(),
        Value::Boolean(value) => (*value.value()).into(),
        Value::Datetime(time) => time.value().to_string().into(),
        Value::Array(values) => values.iter().map(json_of_value).collect(),
        Value::InlineTable(table) => {
            Json::Object(table.iter().map(|(key, value)| (key.to_owned(), json_of_value(value))).collect())
        }
    }
}
