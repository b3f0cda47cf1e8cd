//! Standard output and standard error, which may be closed at any time: `downbeat check robot.toml | head
//! -3`.
//!
//! The macros replace those of the standard library, which panic in that case, in the whole program.

use std::fmt;
use std::io::{self, ErrorKind, Write};

use crate::msgs::write_printable_lines;

macro_rules! print {
    ($($text:tt)*) => { $crate::program::output::print(format_args!($($text)*)) };
}

macro_rules! println {
    () => { $crate::program::output::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::program::output::print(format_args!("{}\n", format_args!($($text)*))) };
}

macro_rules! eprintln {
    ($($text:tt)*) => { $crate::program::output::print_error(format_args!("{}\n", format_args!($($text)*))) };
}

/// Writes to standard output. If it is closed, the process exits quietly, since it has nothing else to do; on
/// other errors the process exits with an error.
///
/// Control characters are escaped, since names may come from untrusted sources.
pub(crate) fn print(text: fmt::Arguments<'_>) {
    match write_printable(io::stdout().lock(), text) {
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => {
            print_error(format_args!("downbeat: cannot write to standard output: {error}\n"));
            std::process::exit(1);
        }
    }
}

/// Writes to standard error, unless it is closed.
pub(crate) fn print_error(text: fmt::Arguments<'_>) {
    let _ = write_printable(io::stderr().lock(), text);
}

fn write_printable(to: impl Write, text: fmt::Arguments<'_>) -> io::Result<()> {
    let mut printable = Printable { to, error: None };
    match fmt::Write::write_fmt(&mut printable, text) {
        Ok(()) => Ok(()),
        Err(fmt::Error) => Err(printable.error.unwrap_or_else(|| io::Error::other("it has no text"))),
    }
}

/// Escapes written text.
struct Printable<W> {
    to: W,
    error: Option<io::Error>,
}

impl<W: Write> fmt::Write for Printable<W> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let mut plain = Plain(self);
        write_printable_lines(&mut plain, text)
    }
}

struct Plain<'a, W>(&'a mut Printable<W>);

impl<W: Write> fmt::Write for Plain<'_, W> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.to.write_all(text.as_bytes()).map_err(|error| {
            self.0.error = Some(error);
            fmt::Error
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn control_characters_of_names_do_not_reach_the_terminal() {
        let mut written = Vec::new();
        write_printable(&mut written, format_args!("{}\t{}\n", "/cam\u{1b}[2J", "ü")).unwrap();
        assert_eq!(String::from_utf8(written).unwrap(), "/cam\\u001b[2J\tü\n");
    }
}
