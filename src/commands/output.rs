//! Results on standard output.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// Writes text. A reader that has seen enough (`| head`) ends the program quietly; what cannot be
/// written for another reason ends it with an error.
pub fn write(text: Arguments) {
    let Err(error) = std::io::stdout().lock().write_fmt(text) else { return };
    if error.kind() == ErrorKind::BrokenPipe {
        std::process::exit(0);
    }
    eprintln!("esker: standard output: {error}");
    std::process::exit(1);
}
