//! An emulated GPIO chip: a folder with a file for each line.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::lines::{Line, Use};
use super::source::{Edge, Source};

/// An emulated chip. The value of an input is what its file in the folder says, 0 or 1, and false if there is
/// no such file; that of an output is written to its file: `echo 1 > pins/button`. Without a folder, an input
/// follows the output that has the same line, as if a wire joined them.
#[derive(Debug, Default)]
pub struct Pins {
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    folder: Option<PathBuf>,
    lines: Vec<Line>,
    values: Vec<bool>,
}

impl Source for Pins {
    fn open(&mut self, chip: &str, lines: &[Line]) -> Result<Vec<bool>, String> {
        let folder = (!chip.is_empty()).then(|| PathBuf::from(chip));
        if let Some(folder) = folder.as_deref().filter(|folder| !folder.is_dir()) {
            return Err(format!(
                "there is no folder {} with the lines of an emulated chip",
                folder.display()
            ));
        }
        let mut open = Open { folder, lines: lines.to_vec(), values: vec![false; lines.len()] };
        for (index, line) in lines.iter().enumerate() {
            if let Use::Output { safe, .. } = line.purpose {
                open.set(index, safe)?;
            }
        }
        for index in 0..lines.len() {
            open.values[index] = open.value(index)?;
        }
        let values = open.values.clone();
        self.open = Some(open);
        Ok(values)
    }

    fn edges(&mut self) -> Result<Vec<Edge>, String> {
        let open = self.open.as_mut().ok_or("the lines are not requested")?;
        let mut edges = Vec::new();
        for index in 0..open.lines.len() {
            let is_true = open.value(index)?;
            if std::mem::replace(&mut open.values[index], is_true) != is_true {
                let line = index.try_into().unwrap_or(u16::MAX);
                edges.push(Edge { age_ns: 0, line, is_true, lost: 0 });
            }
        }
        Ok(edges)
    }

    fn set(&mut self, line: usize, is_true: bool) -> Result<(), String> {
        self.open.as_mut().ok_or("the lines are not requested")?.set(line, is_true)
    }

    fn close(&mut self) {
        self.open = None;
    }
}

impl Open {
    fn set(&mut self, index: usize, is_true: bool) -> Result<(), String> {
        if let (Some(value), Some(line)) = (self.values.get_mut(index), self.lines.get(index)) {
            *value = is_true;
            if let Some(folder) = &self.folder {
                let path = folder.join(&line.name);
                let level = u8::from(is_true != line.is_active_low);
                fs::write(&path, format!("{level}\n"))
                    .map_err(|error| format!("writing {}: {error}", path.display()))?;
            }
        }
        Ok(())
    }

    /// The value of a line, an input as it is now.
    fn value(&self, index: usize) -> Result<bool, String> {
        let line = &self.lines[index];
        if matches!(line.purpose, Use::Output { .. }) {
            return Ok(self.values[index]);
        }
        let is_high = match &self.folder {
            Some(folder) => level_of(folder, &line.name)?,
            None => {
                let mut outputs = self.lines.iter().zip(&self.values);
                let wired = outputs.find(|(other, _)| {
                    other.line == line.line && matches!(other.purpose, Use::Output { .. })
                });
                wired.is_some_and(|(output, value)| *value != output.is_active_low)
            }
        };
        Ok(is_high != line.is_active_low)
    }
}

/// Whether the file of a line says 1.
fn level_of(folder: &Path, name: &str) -> Result<bool, String> {
    let path = folder.join(name);
    match fs::read_to_string(&path) {
        Ok(text) => match text.trim() {
            "1" => Ok(true),
            "0" | "" => Ok(false),
            other => Err(format!(
                "{} has \"{}\", expected 0 or 1",
                path.display(),
                other.chars().take(20).collect::<String>()
            )),
        },
        Err(error) if error.kind() == ErrorKind::NotFound && folder.is_dir() => Ok(false),
        Err(error) => Err(format!("reading {}: {error}", path.display())),
    }
}
