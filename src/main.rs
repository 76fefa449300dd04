//! The `esker` program: arguments to one command.

fn main() {}
