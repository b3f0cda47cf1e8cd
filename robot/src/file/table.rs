//! Reading of TOML tables with errors that contain the line.

use std::ops::RangeInclusive;
use std::path::Path;
use std::time::Duration;

use downbeat_files::toml::{DeString, DeTable, DeValue, Spanned};

use super::source::{RobotFileError, Source};
use downbeat_executor::SettingValue;
use downbeat_msgs::definitions::suggestion;

type Result<T> = std::result::Result<T, RobotFileError>;

/// A table whose keys are taken out one by one. Keys that are left at the end are errors.
pub(crate) struct Table<'a> {
    source: &'a Source,
    name: String,
    line: usize,
    rest: Vec<(&'a Spanned<DeString<'a>>, Value<'a>)>,
    asked: Vec<&'static str>,
}

/// A value with its position in the file.
#[derive(Clone, Copy)]
pub(crate) struct Value<'a> {
    source: &'a Source,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Table<'a> {
    pub(crate) fn new(source: &'a Source, name: &str, line: usize, table: &'a DeTable<'a>) -> Self {
        let rest = table.iter().map(|(key, value)| (key, Value { source, value })).collect();
        Self { source, name: name.into(), line, rest, asked: Vec::new() }
    }

    /// The line on which the table begins.
    pub(crate) fn line(&self) -> usize {
        self.line
    }

    /// An error on a line of the file.
    pub(crate) fn error(&self, line: usize, problem: impl Into<String>) -> RobotFileError {
        self.source.error(line, problem)
    }

    pub(crate) fn take(&mut self, key: &'static str) -> Option<Value<'a>> {
        self.asked.push(key);
        let position = self.rest.iter().position(|(known, _)| known.get_ref() == key)?;
        Some(self.rest.remove(position).1)
    }

    /// Returns a value that has not been taken, without taking it.
    pub(crate) fn peek(&self, key: &str) -> Option<Value<'a>> {
        self.rest.iter().find(|(known, _)| known.get_ref() == key).map(|&(_, value)| value)
    }

    pub(crate) fn require(&mut self, key: &'static str) -> Result<Value<'a>> {
        let missing = || self.source.error(self.line, format!("{} needs \"{key}\"", self.name));
        let error = missing();
        self.take(key).ok_or(error)
    }

    /// Takes all remaining keys, in the order of the file.
    pub(crate) fn take_rest(&mut self) -> Vec<(String, Value<'a>)> {
        let mut rest = std::mem::take(&mut self.rest);
        rest.sort_by_key(|(key, _)| key.span().start);
        rest.into_iter().map(|(key, value)| (key.get_ref().to_string(), value)).collect()
    }

    /// Checks that no key is left.
    pub(crate) fn finish(self) -> Result<()> {
        let Some((key, _)) = self.rest.first() else { return Ok(()) };
        let (name, key_name) = (&self.name, key.get_ref());
        let hint = suggestion(key_name, self.asked.iter().copied());
        Err(self
            .source
            .error(self.source.line_of(&key.span()), format!("{name} has no \"{key_name}\"{hint}")))
    }
}

impl<'a> Value<'a> {
    /// The path of the file.
    pub(crate) fn path(&self) -> &'a Path {
        self.source.path()
    }

    pub(crate) fn line(&self) -> usize {
        self.source.line_of(&self.value.span())
    }

    pub(crate) fn error(&self, problem: impl Into<String>) -> RobotFileError {
        self.source.error(self.line(), problem)
    }

    pub(crate) fn text(&self) -> Result<&'a str> {
        match self.value.get_ref() {
            DeValue::String(text) => Ok(text),
            _ => Err(self.expected("text in quotes")),
        }
    }

    pub(crate) fn flag(&self) -> Result<bool> {
        match self.value.get_ref() {
            DeValue::Boolean(flag) => Ok(*flag),
            _ => Err(self.expected("true or false")),
        }
    }

    /// Reads a number, integer or not.
    pub(crate) fn number(&self) -> Result<f64> {
        match self.setting()? {
            SettingValue::Integer(number) => Ok(number as f64),
            SettingValue::Double(number) => Ok(number),
            _ => Err(self.expected("a number")),
        }
    }

    pub(crate) fn count(&self) -> Result<u32> {
        match self.setting()? {
            SettingValue::Integer(count) if count > 0 => {
                u32::try_from(count).map_err(|_| self.error(format!("{count} is too many")))
            }
            _ => Err(self.expected("a whole number greater than 0")),
        }
    }

    /// Reads an integer in a range; `what` describes the expected number in errors.
    pub(crate) fn number_in<N: TryFrom<i64>>(&self, range: RangeInclusive<i64>, what: &str) -> Result<N> {
        let number = self.integer().ok().filter(|number| range.contains(number));
        number.and_then(|number| N::try_from(number).ok()).ok_or_else(|| self.expected(what))
    }

    /// Reads a duration above 0.
    pub(crate) fn duration(&self) -> Result<Duration> {
        let text = self.text().map_err(|_| self.expected("a time with its unit, such as \"20ms\""))?;
        match downbeat_files::duration::parse(text) {
            Ok(Duration::ZERO) => {
                Err(self.error(format!("\"{text}\" is not a valid time: it must be above 0")))
            }
            Ok(duration) => Ok(duration),
            Err(problem) => Err(self.error(problem)),
        }
    }

    pub(crate) fn list(&self) -> Result<Vec<Value<'a>>> {
        match self.value.get_ref() {
            DeValue::Array(values) => {
                Ok(values.iter().map(|value| Value { source: self.source, value }).collect())
            }
            _ => Err(self.expected("a list")),
        }
    }

    pub(crate) fn table(&self, name: &str) -> Result<Table<'a>> {
        self.as_table(name).ok_or_else(|| self.expected("a table"))
    }

    /// Returns the value as a table, or `None` if it is not a table.
    pub(crate) fn as_table(&self, name: &str) -> Option<Table<'a>> {
        let table = self.value.get_ref().as_table()?;
        Some(Table::new(self.source, name, self.line(), table))
    }

    pub(crate) fn setting(&self) -> Result<SettingValue> {
        match self.value.get_ref() {
            DeValue::Boolean(value) => Ok(SettingValue::Bool(*value)),
            DeValue::String(text) => Ok(SettingValue::Text(text.to_string())),
            DeValue::Integer(_) => Ok(SettingValue::Integer(self.integer()?)),
            DeValue::Float(number) => {
                let number = number.as_str().parse().map_err(|_| self.expected("a number"))?;
                Ok(SettingValue::Double(number))
            }
            DeValue::Array(_) => self.setting_list(),
            DeValue::Table(_) | DeValue::Datetime(_) => {
                Err(self.expected("true, false, a number, text, or a list of one of these"))
            }
        }
    }

    fn integer(&self) -> Result<i64> {
        match self.value.get_ref() {
            DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
                .map_err(|_| self.expected("a whole number of 64 bits")),
            _ => Err(self.expected("a whole number")),
        }
    }

    fn setting_list(&self) -> Result<SettingValue> {
        let values = self.list()?.iter().map(Value::setting).collect::<Result<Vec<_>>>()?;
        list_of(values)
            .ok_or_else(|| self.expected("a list of numbers only, of texts only, or of booleans only"))
    }

    fn expected(&self, what: &str) -> RobotFileError {
        let text = &self.source.text()[self.value.span()];
        let found: String = text.lines().next().unwrap_or_default().chars().take(40).collect();
        self.error(format!("expected {what}, found {found}"))
    }
}

/// Joins the values into one list; `None` if they are not all numbers, all texts or all booleans.
pub(crate) fn list_of(values: Vec<SettingValue>) -> Option<SettingValue> {
    let all = |matches: fn(&SettingValue) -> bool| values.iter().all(matches);
    if all(|value| matches!(value, SettingValue::Integer(_))) {
        let integer = |value| if let SettingValue::Integer(integer) = value { Some(integer) } else { None };
        return values.into_iter().map(integer).collect::<Option<_>>().map(SettingValue::Integers);
    }
    if all(|value| matches!(value, SettingValue::Text(_))) {
        let text = |value| if let SettingValue::Text(text) = value { Some(text) } else { None };
        return values.into_iter().map(text).collect::<Option<_>>().map(SettingValue::Texts);
    }
    if all(|value| matches!(value, SettingValue::Bool(_))) {
        let flag = |value| if let SettingValue::Bool(flag) = value { Some(flag) } else { None };
        return values.into_iter().map(flag).collect::<Option<_>>().map(SettingValue::Bools);
    }
    let number = |value| match value {
        SettingValue::Integer(number) => Some(number as f64),
        SettingValue::Double(number) => Some(number),
        _ => None,
    };
    values.into_iter().map(number).collect::<Option<_>>().map(SettingValue::Doubles)
}
