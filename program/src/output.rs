//! Standard output and standard error, which may be closed at any time: `downbeat check robot.toml | head
//! -3`.
//!
//! The macros replace those of the standard library, which panic in that case, in the whole program.

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::logging::Stream;
use super::screen::Screen;
use super::stop::requested::{self, OutputEnd};
use downbeat_msgs::write_printable_lines;

macro_rules! print {
    ($($text:tt)*) => { $crate::output::print(format_args!($($text)*)) };
}

macro_rules! println {
    () => { $crate::output::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::output::print(format_args!("{}\n", format_args!($($text)*))) };
}

macro_rules! eprintln {
    ($($text:tt)*) => { $crate::output::print_error(format_args!("{}\n", format_args!($($text)*))) };
}

/// Writes to standard output. If it is closed, commands that wait for a stop are asked to stop, and others
/// exit quietly, since they have nothing else to do; on other errors the process ends with an error.
///
/// Control characters are escaped, since names may come from untrusted sources.
pub(crate) fn print(text: fmt::Arguments<'_>) {
    // What was logged before stands before.
    Screen::of_process().flush();
    WRITES.fetch_add(1, Ordering::Relaxed);
    let written = write_printable(io::stdout().lock(), text);
    WRITES.fetch_add(1, Ordering::Relaxed);
    if let Err(error) = written {
        output_failed(&error);
    }
}

/// How often writing to standard output began and ended. Other threads than the one that runs the command do
/// not write.
static WRITES: AtomicU64 = AtomicU64::new(0);

/// Which write to standard output is in progress, if any.
pub(super) fn write_in_progress() -> Option<u64> {
    let writes = WRITES.load(Ordering::Relaxed);
    (writes % 2 == 1).then_some(writes)
}

/// Whether an error of standard output was reported. The process then exits with code 1.
static HAS_FAILED: AtomicBool = AtomicBool::new(false);

pub(crate) fn has_failed() -> bool {
    HAS_FAILED.load(Ordering::Relaxed)
}

fn output_failed(error: &io::Error) {
    let is_unread = error.kind() == ErrorKind::BrokenPipe;
    let is_reported = !is_unread && !is_of_closed_terminal(error);
    if is_reported && !HAS_FAILED.swap(true, Ordering::Relaxed) {
        print_error(format_args!("downbeat: cannot write to standard output: {error}\n"));
    }
    match requested::output_failed(is_unread) {
        OutputEnd::Continue => {}
        OutputEnd::Exit => {
            Screen::of_process().flush();
            std::process::exit(is_reported.into())
        }
    }
}

/// Whether a stream ended because its terminal was closed.
pub(crate) fn is_of_closed_terminal(error: &io::Error) -> bool {
    const EIO: i32 = 5; // the same on every Unix
    cfg!(unix) && error.raw_os_error() == Some(EIO)
}

/// Writes to standard error, unless it is closed, and waits until it is written.
pub(crate) fn print_error(text: fmt::Arguments<'_>) {
    let screen = Screen::of_process();
    // Makes place.
    screen.flush();
    screen.log(Stream::Error, escaped(text));
    screen.flush();
}

/// The text with control characters escaped.
pub(crate) fn escaped(text: fmt::Arguments<'_>) -> String {
    let mut written = String::new();
    // Writing to a `String` does not fail.
    let _ = write_printable_lines(&mut written, &text.to_string());
    written
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
