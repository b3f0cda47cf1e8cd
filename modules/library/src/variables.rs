//! What a module of a library reports of itself to a debugger.

use std::cell::RefCell;
use std::fmt::{self, Write};

/// The longest text of a variable and the longest name, in bytes.
pub(crate) const LONGEST_VALUE: usize = 2000;
pub(crate) const LONGEST_NAME: usize = 200;
/// How many variables are shown, and how many bytes of all of them: as much as a debugger takes of a module.
const MOST: usize = 500;
pub(crate) const LARGEST: usize = 64 * 1024;

/// The variables that a module has reported in one call.
#[derive(Default)]
pub(crate) struct Variables {
    /// How the module describes itself as a whole.
    whole: String,
    named: Vec<(String, String)>,
    /// Of all texts, in bytes.
    size: usize,
    left_out: usize,
}

impl Variables {
    /// Whether one more is taken. If not, it is counted as left out.
    pub(crate) fn has_room(&mut self) -> bool {
        let has_room = self.named.len() < MOST && self.size < LARGEST;
        self.left_out += usize::from(!has_room);
        has_room
    }

    pub(crate) fn report(&mut self, name: String, value: String) {
        self.size += name.len() + value.len();
        self.named.push((name, value));
    }

    /// Takes a text about the module as a whole.
    pub(crate) fn describe(&mut self, text: &str, left_out: usize) {
        self.size += text.len() + 1;
        if !self.whole.is_empty() {
            self.whole.push('\n');
        }
        self.whole.push_str(text);
        if left_out > 0 {
            let _ = write!(self.whole, "\n... and {left_out} more bytes");
        }
    }

    /// All of them as a text, under the name of the sort of module; `None` if there is nothing to say.
    pub(crate) fn text(&self, sort: &str, failure: Option<String>) -> Option<String> {
        let mut parts = Vec::new();
        if !self.whole.is_empty() {
            parts.push(self.whole.clone());
        }
        if !self.named.is_empty() {
            parts.push(format!("{:#?}", Named { sort, named: &self.named }));
        }
        if self.left_out > 0 {
            parts.push(format!("... and {} more", self.left_out));
        }
        if let Some(reason) = failure {
            let what = if parts.is_empty() { "its variables" } else { "further variables" };
            parts.push(format!("{what} cannot be shown: {reason}"));
        }
        (!parts.is_empty()).then(|| parts.join("\n"))
    }
}

struct Named<'a> {
    sort: &'a str,
    named: &'a [(String, String)],
}

impl fmt::Debug for Named<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = f.debug_struct(self.sort);
        for (name, value) in self.named {
            shown.field(name, &format_args!("{value}"));
        }
        shown.finish()
    }
}

/// The text that a module showed last. A debugger asks a module through a shared reference, and reads the
/// text before it asks again.
#[derive(Default)]
pub(crate) struct Shown(RefCell<String>);

impl Shown {
    pub(crate) fn keep(&self, text: Option<String>) -> Option<&dyn fmt::Debug> {
        self.0.replace(text?);
        Some(self)
    }
}

impl fmt::Debug for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.borrow())
    }
}
