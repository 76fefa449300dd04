//! Progress on standard error: a bar, plain lines, JSON lines, or nothing.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};

use crate::build::{Progress, Stage};

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProgressKind {
    /// A bar that moves; nothing where standard error is not a terminal.
    Bar,
    /// A line per stage, and one every few seconds within.
    Plain,
    /// One JSON object per line.
    Json,
    /// Nothing.
    None,
}

/// The listener for a kind.
pub fn listener(kind: ProgressKind) -> Box<dyn Progress> {
    match kind {
        ProgressKind::Bar if std::io::stderr().is_terminal() => Box::new(Bar::new()),
        ProgressKind::Plain => Box::new(Lines::new(false)),
        ProgressKind::Json => Box::new(Lines::new(true)),
        ProgressKind::Bar | ProgressKind::None => Box::new(crate::build::Silent),
    }
}

struct Bar(ProgressBar);

impl Bar {
    fn new() -> Self {
        let bar = ProgressBar::new(0);
        let style = ProgressStyle::with_template(
            "{msg:>9} [{bar:40}] {human_pos}/{human_len} points, {per_sec}, {eta} left",
        );
        if let Ok(style) = style {
            bar.set_style(style);
        }
        Bar(bar)
    }
}

impl Progress for Bar {
    fn begin(&self, stage: Stage, total: u64) {
        self.0.reset();
        self.0.set_length(total);
        self.0.set_message(stage.name());
    }
    fn advance(&self, points: u64) {
        self.0.inc(points);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

struct LineState {
    stage: Option<Stage>,
    began: Instant,
    told: Instant,
    done: u64,
    total: u64,
}

struct Lines {
    json: bool,
    state: Mutex<LineState>,
}

impl Lines {
    fn new(json: bool) -> Self {
        let now = Instant::now();
        let state = LineState { stage: None, began: now, told: now, done: 0, total: 0 };
        Lines { json, state: Mutex::new(state) }
    }

    fn tell(&self, state: &LineState) {
        let Some(stage) = state.stage else { return };
        if state.done == 0 && !self.json {
            eprintln!("{}: {} points", stage.name(), state.total);
            return;
        }
        let seconds = state.began.elapsed().as_secs_f64();
        let rate = state.done as f64 / seconds.max(1e-6);
        let seconds_left = state.total.saturating_sub(state.done) as f64 / rate.max(1.0);
        if self.json {
            let line = serde_json::json!({
                "stage": stage.name(), "points": state.done, "points_total": state.total,
                "seconds": seconds, "points_per_second": rate, "seconds_left": seconds_left,
            });
            eprintln!("{line}");
        } else {
            eprintln!(
                "{}: {} of {} points, {:.2} M points/s, {seconds_left:.0} s left",
                stage.name(),
                state.done,
                state.total,
                rate / 1e6
            );
        }
    }
}

/// Time between two lines of the same stage.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

impl Progress for Lines {
    fn begin(&self, stage: Stage, total: u64) {
        let mut state = self.state.lock().expect("no holder of the lock panics");
        let now = Instant::now();
        *state = LineState { stage: Some(stage), began: now, told: now, done: 0, total };
        self.tell(&state);
    }
    fn advance(&self, points: u64) {
        let mut state = self.state.lock().expect("no holder of the lock panics");
        state.done += points;
        if state.told.elapsed() >= LINE_INTERVAL {
            state.told = Instant::now();
            self.tell(&state);
        }
    }
}
