//! Standard output and standard error, whose other end may be closed at any time: `downbeat check robot.toml | head -3`.
//!
//! The macros take the place of those of the standard library in the whole program, which panic then.

use std::fmt;
use std::io::{self, ErrorKind, Write};

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

/// Writes to standard output. Where nobody reads it any more, the process ends quietly, as it has nothing else to do;
/// where it cannot be written for another reason, the process ends with an error.
pub(crate) fn print(text: fmt::Arguments<'_>) {
    match io::stdout().lock().write_fmt(text) {
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => {
            print_error(format_args!("downbeat: cannot write to standard output: {error}\n"));
            std::process::exit(1);
        }
    }
}

/// Writes to standard error, if anybody reads it.
pub(crate) fn print_error(text: fmt::Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}
