//! `downbeat interface show`
//!
//! # References
//! `ros2interface/ros2interface/verb/show.py` of ros2/ros2cli, branch jazzy: the file line by line; each
//! field of a message type is followed by the file of that type, indented by one more tab. When hiding
//! comments, the real command leaves the `#` after a field, contrary to its own tests, and keeps indented
//! comments; here they are removed completely.

use crate::msgs::definitions::TypeName;
use anyhow::bail;

use super::Registered;
use super::arguments::ShowArguments;
use super::interfaces::Interfaces;
use super::{source_text, structure};

pub(super) fn show(arguments: &ShowArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.types.source, registered)?;
    let names = interfaces.chosen(&arguments.types)?;
    if arguments.json {
        return structure::show(&interfaces, &names);
    }
    let comments = match arguments {
        ShowArguments { all_comments: true, .. } => Comments::All,
        ShowArguments { no_comments: true, .. } => Comments::None,
        _ => Comments::OfTheTypeItself,
    };
    for name in &names {
        if arguments.types.all {
            println!("{}\n{name}", "=".repeat(80));
        }
        Text { interfaces: &interfaces, comments, path: Vec::new(), lines: 0 }.print(name)?;
    }
    Ok(())
}

#[derive(Clone, Copy)]
enum Comments {
    All,
    OfTheTypeItself,
    None,
}

/// The state of printing a definition.
struct Text<'a> {
    interfaces: &'a Interfaces,
    comments: Comments,
    /// From the requested type to the one being printed.
    path: Vec<TypeName>,
    /// The number of lines so far, including hidden ones.
    lines: usize,
}

/// Limits output: types with two fields of each next type double with each level.
const MOST_LINES: usize = 100_000;
const DEEPEST: usize = 100;

impl Text<'_> {
    fn print(&mut self, name: &TypeName) -> anyhow::Result<()> {
        // This bounds the depth by the number of types.
        if self.path.contains(name) {
            let path = self.path.iter().map(TypeName::to_string).collect::<Vec<_>>().join(" -> ");
            bail!("{name} contains itself: {path} -> {name}");
        }
        if self.path.len() == DEEPEST {
            bail!("{} is nested deeper than {DEEPEST} types; --json shows each type once", self.path[0]);
        }
        self.path.push(name.clone());
        let definition = self.interfaces.find(name)?;
        for line in source_text::lines(definition) {
            self.lines += 1;
            if self.lines > MOST_LINES {
                bail!("{} has more than {MOST_LINES} lines; --json shows each type once", self.path[0]);
            }
            self.print_line(&line.text);
            if let Some(message) = line.message {
                self.print(&message)?;
            }
        }
        self.path.pop();
        Ok(())
    }

    fn print_line(&self, line: &str) {
        let has_comments = match self.comments {
            Comments::All => true,
            Comments::OfTheTypeItself => self.path.len() == 1,
            Comments::None => false,
        };
        let shown = match line.split_once('#') {
            Some((code, _)) if !has_comments => code.trim(),
            _ => line.trim_end(),
        };
        if !shown.is_empty() {
            println!("{}{shown}", "\t".repeat(self.path.len() - 1));
        } else if has_comments {
            println!();
        }
    }
}
