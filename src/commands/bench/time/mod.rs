//! The suite `time`: what estimators of rendering time predict against what frames take.
//!
//! *Objects*: three made-up scenes of triangles on a simulated pipeline; the formulas H1 to H5, the
//! per-object tables and the view cells. Repeats on any machine. *Counted*: frames of points whose
//! work is counted instead of timed; repeats too. *Timed*: the same frames on the adapter that is
//! there, by its clock. *Kept*: a flight with a target time. Prices are always fitted to one path
//! and judged on another.

mod frames;
mod kept;
mod objects;
mod score;

use std::fmt::Write;

use clap::ValueEnum;

use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::time::score::Score;
use crate::commands::bench::{BenchArgs, machine, write_file};

/// The parts of the suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Study {
    /// Triangles on a simulated pipeline
    Objects,
    /// Frames of points whose work is counted
    Counted,
    /// Frames of points by the clock, and a flight that keeps to a time
    Timed,
}

impl BenchArgs {
    fn wants_time(&self, study: Study) -> bool {
        self.time_study.is_empty() || self.time_study.contains(&study)
    }
}

/// Runs the suite.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    println!("drawn by {}\n", machine());
    let mut scores = Vec::new();
    if args.wants_time(Study::Objects) {
        scores = objects::run(args.quick);
        print!("{}", table("Objects, simulated pipeline (times repeat)", &scores));
    }
    let outcome = frames::run(args)?;
    print!("{}", table("Frames of points", &outcome.scores));
    print!("{}", outcome.text);
    scores.extend(outcome.scores);
    let mut csv = format!("{}\n", Score::CSV_HEADER);
    scores.iter().for_each(|score| score.write_csv(&mut csv));
    write_file(&args.output.join("time.csv"), &csv)?;
    write_file(&args.output.join("time-frames.csv"), &outcome.csv)?;
    let mut panels = vec![error_against_time(&scores)];
    panels.extend(outcome.panels);
    let heading = "Rendering time: prediction against measurement";
    write_file(&args.output.join("time.svg"), &svg(heading, &panels, 3))?;
    println!("rows and plots are in {}", args.output.display());
    Ok(())
}

fn table(title: &str, scores: &[Score]) -> String {
    let mut text = format!("{title}\n{}\n", Score::HEADER);
    for score in scores {
        writeln!(text, "{}", score.line()).expect("a string takes all text");
    }
    text.push('\n');
    text
}

/// Error of each estimator over the time that it takes itself, one line per estimator.
fn error_against_time(scores: &[Score]) -> Panel {
    let mut names: Vec<&str> = Vec::new();
    for score in scores {
        let is_new = !names.contains(&score.estimator.as_str());
        if is_new && names.len() < 6 && score.study == "objects" {
            names.push(&score.estimator);
        }
    }
    let series = names.iter().map(|&name| {
        let of_name = scores.iter().filter(|s| s.estimator == name && s.study == "objects");
        let mut points: Vec<(f64, f64)> =
            of_name.map(|s| (s.estimate_us, 100.0 * s.relative_rms)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series { name: name.to_owned(), points }
    });
    Panel {
        title: "objects: error over the estimator's own time".into(),
        x_label: "time to predict a frame, us".into(),
        y_label: "relative RMS error, %".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series: series.collect(),
    }
}
