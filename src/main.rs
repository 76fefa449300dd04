//! The `esker` program: arguments to one command.

use std::process::ExitCode;

fn main() -> ExitCode {
    esker::commands::main()
}
