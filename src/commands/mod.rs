//! The commands of the `esker` program: arguments in, exit code out.
//!
//! Results go to standard output, messages to standard error. Exit codes: 0 done; 1 the input or a
//! store is bad or the run failed, with one line that says why; 2 wrong usage; 130 interrupted.

/// Like the standard one, but a closed pipe is no panic.
macro_rules! print {
    ($($text:tt)*) => {
        $crate::commands::output::write(format_args!($($text)*))
    };
}

/// Like the standard one, but a closed pipe is no panic.
macro_rules! println {
    () => {
        print!("\n")
    };
    ($($text:tt)*) => {
        print!("{}\n", format_args!($($text)*))
    };
}

mod bench;
mod check;
mod convert;
mod export;
mod generate;
mod info;
mod inputs;
mod models;
mod output;
mod picture_options;
mod progress;
mod quantities;
mod render;
mod show_culling;
mod view;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::build::BuildError;

/// Scans into a nested octree of point trees on disk, and pictures out of it.
#[derive(Debug, Parser)]
#[command(name = "esker", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure speed against error
    Bench(bench::BenchArgs),
    /// Convert scans into one store
    Convert(convert::ConvertArgs),
    /// Write a made-up scan of any size
    Generate(generate::GenerateArgs),
    /// Tell a scan's or a store's facts
    Info(info::InfoArgs),
    /// Read every byte of a store and verify it
    Check(check::CheckArgs),
    /// Draw stores and scans into a picture, without a window
    Render(render::RenderArgs),
    /// Look at stores and scans in a window
    View(view::ViewArgs),
    /// Write a store's points to a scan file
    Export(export::ExportArgs),
}

/// Runs the program on its command line.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let outcome = match cli.command {
        Command::Bench(args) => bench::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Generate(args) => generate::run(args),
        Command::Info(args) => info::run(args),
        Command::Check(args) => check::run(args),
        Command::Render(args) => render::run(args),
        Command::View(args) => view::run(args),
        Command::Export(args) => export::run(args),
    };
    match outcome {
        Ok(code) => code,
        Err(error) if is_interruption(&error) => {
            eprintln!("esker: interrupted");
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("esker: {}", one_line(&error));
            ExitCode::FAILURE
        }
    }
}

/// An error and its causes; a cause that its error quotes already is not told twice.
fn one_line(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |line, cause| {
        let cause = cause.to_string();
        match line.as_str() {
            "" => cause,
            _ if line.contains(&cause) => line,
            _ => format!("{line}: {cause}"),
        }
    })
}

fn is_interruption(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(BuildError::Interrupted))
}
