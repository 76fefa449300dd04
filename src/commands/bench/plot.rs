//! Line plots as SVG text: panels with axes, ticks, a legend and one line per series.
//!
//! Just what the benchmark suites need. Lengths are SVG user units (pixels at scale 1).

use std::fmt::Write;

/// How values become places on an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// In proportion, from zero.
    Linear,
    /// In proportion to the logarithm; values of zero stand on the axis with an open mark.
    Log,
}

/// One line of a plot.
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Places (x, y), joined in this order. Places that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

/// One pair of axes.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Stands above.
    pub title: String,
    /// What runs to the right, with its unit.
    pub x_label: String,
    /// What runs upwards, with its unit.
    pub y_label: String,
    /// Scale of x.
    pub x_scale: Scale,
    /// Scale of y.
    pub y_scale: Scale,
    /// The lines, at most as many as there are styles (6).
    pub series: Vec<Series>,
}

const PANEL: (f64, f64) = (460.0, 370.0);
/// Left, top, right, bottom of the plot area within a panel.
const MARGIN: (f64, f64, f64, f64) = (70.0, 64.0, 18.0, 50.0);
/// The palette of Okabe and Ito, which colour-blind readers can tell apart.
const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// The panels row by row, `columns` side by side, under one heading.
pub fn svg(heading: &str, panels: &[Panel], columns: usize) -> String {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let (width, height) = (columns as f64 * PANEL.0, rows as f64 * PANEL.1 + 36.0);
    let mut out = head(width, height, heading);
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = ((i % columns) as f64 * PANEL.0, (i / columns) as f64 * PANEL.1 + 36.0);
        line(&mut out, format_args!("<g transform=\"translate({x} {y})\">"));
        draw_panel(&mut out, panel);
        line(&mut out, format_args!("</g>"));
    }
    out.push_str("</svg>\n");
    out
}

/// The start of a picture: its size, a white ground, the heading.
pub(super) fn head(width: f64, height: f64, heading: &str) -> String {
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    text(&mut out, (14.0, 24.0), "start", "font-size=\"16\" font-weight=\"bold\"", heading);
    out
}

fn draw_panel(out: &mut String, panel: &Panel) {
    let (left, top) = (MARGIN.0, MARGIN.1);
    let (right, bottom) = (PANEL.0 - MARGIN.2, PANEL.1 - MARGIN.3);
    let values = |pick: fn(&(f64, f64)) -> f64| {
        panel.series.iter().flat_map(move |series| series.points.iter().map(pick))
    };
    let x_axis = Axis::new(panel.x_scale, values(|p| p.0), (left, right));
    let y_axis = Axis::new(panel.y_scale, values(|p| p.1), (bottom, top));

    text(out, (left, 18.0), "start", "font-weight=\"bold\"", &panel.title);
    for tick in x_axis.ticks() {
        let x = x_axis.place(tick);
        stroke(out, (x, top), (x, bottom), "#dddddd", 1.0);
        text(out, (x, bottom + 16.0), "middle", "fill=\"#333333\"", &short(tick));
    }
    for tick in y_axis.ticks() {
        let y = y_axis.place(tick);
        stroke(out, (left, y), (right, y), "#dddddd", 1.0);
        text(out, (left - 6.0, y + 4.0), "end", "fill=\"#333333\"", &short(tick));
    }
    stroke(out, (left, bottom), (right, bottom), "black", 1.0);
    stroke(out, (left, top), (left, bottom), "black", 1.0);
    text(out, (0.5 * (left + right), PANEL.1 - 14.0), "middle", "", &panel.x_label);
    let turned = format!("transform=\"translate(16 {}) rotate(-90)\"", 0.5 * (top + bottom));
    text(out, (0.0, 0.0), "middle", &turned, &panel.y_label);

    for (i, series) in panel.series.iter().enumerate() {
        draw_series(out, series, COLORS[i % COLORS.len()], i, &x_axis, &y_axis);
        let (x, y) = (left + (i % 2) as f64 * 190.0, 34.0 + (i / 2) as f64 * 15.0);
        stroke(out, (x, y - 4.0), (x + 22.0, y - 4.0), COLORS[i % COLORS.len()], 2.0);
        mark(out, (x + 11.0, y - 4.0), COLORS[i % COLORS.len()], i, true);
        text(out, (x + 28.0, y), "start", "", &series.name);
    }
}

fn draw_series(out: &mut String, series: &Series, color: &str, style: usize, x: &Axis, y: &Axis) {
    let finite = series.points.iter().filter(|(a, b)| a.is_finite() && b.is_finite());
    let places: Vec<((f64, f64), bool)> =
        finite.map(|&(a, b)| ((x.place(a), y.place(b)), x.shows(a) && y.shows(b))).collect();
    let joined: Vec<String> = places.iter().map(|((a, b), _)| format!("{a:.1},{b:.1}")).collect();
    line(
        out,
        format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\"/>",
            joined.join(" ")
        ),
    );
    places.iter().for_each(|&(place, shown)| mark(out, place, color, style, shown));
}

/// A mark of its own shape per series; open where the value cannot stand on the scale.
fn mark(out: &mut String, (x, y): (f64, f64), color: &str, style: usize, filled: bool) {
    let fill = if filled { color } else { "white" };
    let shape: &[(f64, f64)] = match style % 4 {
        0 => {
            let circle = format_args!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\" fill=\"{fill}\" stroke=\"{color}\"/>"
            );
            return line(out, circle);
        }
        1 => &[(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)],
        2 => &[(0.0, -4.0), (3.8, 3.0), (-3.8, 3.0)],
        _ => &[(0.0, -4.2), (4.2, 0.0), (0.0, 4.2), (-4.2, 0.0)],
    };
    let corners: Vec<String> =
        shape.iter().map(|(dx, dy)| format!("{:.1},{:.1}", x + dx, y + dy)).collect();
    line(
        out,
        format_args!(
            "<polygon points=\"{}\" fill=\"{fill}\" stroke=\"{color}\"/>",
            corners.join(" ")
        ),
    );
}

/// Values to places along one direction.
struct Axis {
    scale: Scale,
    /// Value (or its logarithm) at the start and at the end.
    range: (f64, f64),
    places: (f64, f64),
}

impl Axis {
    fn new(scale: Scale, values: impl Iterator<Item = f64>, places: (f64, f64)) -> Self {
        let (low, high) = values
            .filter(|v| v.is_finite() && (scale == Scale::Linear || *v > 0.0))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let range = match scale {
            _ if low > high => (0.0, 1.0),
            Scale::Linear => (low.min(0.0), if high > low.min(0.0) { high } else { 1.0 }),
            Scale::Log => {
                // A little room below, where the values of zero stand.
                let (low, high) = (low.log10() - 0.15, high.log10());
                (low, high.max(low + 0.5))
            }
        };
        Axis { scale, range, places }
    }

    /// Whether a value has a place of its own.
    fn shows(&self, value: f64) -> bool {
        self.scale == Scale::Linear || value > 0.0
    }

    fn place(&self, value: f64) -> f64 {
        let at = match self.scale {
            Scale::Linear => value,
            Scale::Log if value > 0.0 => value.log10(),
            Scale::Log => self.range.0,
        };
        let share = ((at - self.range.0) / (self.range.1 - self.range.0)).clamp(0.0, 1.0);
        self.places.0 + share * (self.places.1 - self.places.0)
    }

    /// Round values within the range, about four to nine of them.
    fn ticks(&self) -> Vec<f64> {
        let (low, high) = self.range;
        match self.scale {
            Scale::Linear => {
                let step = round_step((high - low) / 5.0);
                let first = (low / step).ceil() as i64;
                (first..).map(|i| i as f64 * step).take_while(|&v| v <= high * 1.0001).collect()
            }
            Scale::Log => {
                let mantissas: &[f64] = match high - low {
                    decades if decades > 3.0 => &[1.0],
                    decades if decades > 1.2 => &[1.0, 2.0, 5.0],
                    _ => &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0],
                };
                (low.floor() as i32..=high.ceil() as i32)
                    .flat_map(|decade| mantissas.iter().map(move |m| m * 10f64.powi(decade)))
                    .filter(|v| (low..=high + 1e-9).contains(&v.log10()))
                    .collect()
            }
        }
    }
}

/// The largest of 1, 2, 5 times a power of ten that is at most twice `wanted`.
fn round_step(wanted: f64) -> f64 {
    let power = 10f64.powf(wanted.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|&s| s <= 1.5 * wanted).unwrap_or(power)
}

/// A number as a tick says it.
fn short(value: f64) -> String {
    let (scaled, suffix) = match value.abs() {
        v if v >= 1e9 => (value / 1e9, "G"),
        v if v >= 1e6 => (value / 1e6, "M"),
        v if v >= 1e3 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let text = format!("{scaled:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    format!("{text}{suffix}")
}

fn text(out: &mut String, (x, y): (f64, f64), anchor: &str, attributes: &str, content: &str) {
    let content = content.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    line(
        out,
        format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {attributes}>{content}</text>"
        ),
    );
}

fn stroke(out: &mut String, from: (f64, f64), to: (f64, f64), color: &str, width: f64) {
    line(
        out,
        format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{color}\" \
             stroke-width=\"{width}\"/>",
            from.0, from.1, to.0, to.1
        ),
    );
}

fn line(out: &mut String, content: std::fmt::Arguments) {
    out.write_fmt(content).expect("a string takes all text");
    out.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(y_scale: Scale, points: Vec<(f64, f64)>) -> Panel {
        Panel {
            title: "a < b".into(),
            x_label: "points".into(),
            y_label: "holes, %".into(),
            x_scale: Scale::Log,
            y_scale,
            series: vec![Series { name: "s".into(), points }],
        }
    }

    #[test]
    fn text_is_escaped_and_elements_are_closed() {
        let text = svg("h", &[panel(Scale::Linear, vec![(10.0, 1.0), (1000.0, 0.5)])], 2);
        assert!(text.contains("a &lt; b") && text.ends_with("</svg>\n"));
        assert_eq!(text.matches("<g ").count(), text.matches("</g>").count());
        assert_eq!(text.matches("<text").count(), text.matches("</text>").count());
    }

    #[test]
    fn no_values_and_equal_values_still_give_axes() {
        for points in [vec![], vec![(5.0, 0.0)], vec![(f64::NAN, 1.0)], vec![(7.0, 7.0); 3]] {
            for scale in [Scale::Linear, Scale::Log] {
                let text = svg("h", &[panel(scale, points.clone())], 1);
                assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
            }
        }
    }

    #[test]
    fn zero_on_a_log_scale_is_an_open_mark_on_the_axis() {
        let text = svg("h", &[panel(Scale::Log, vec![(10.0, 0.0), (100.0, 2.0)])], 1);
        assert_eq!(text.matches("r=\"3.2\" fill=\"white\"").count(), 1);
    }

    #[test]
    fn ticks_are_round() {
        let axis = Axis::new(Scale::Linear, [0.0, 0.93].into_iter(), (0.0, 100.0));
        let labels: Vec<String> = axis.ticks().into_iter().map(short).collect();
        assert_eq!(labels, ["0", "0.2", "0.4", "0.6", "0.8"]);
        let axis = Axis::new(Scale::Log, [25_000.0, 2_000_000.0].into_iter(), (0.0, 100.0));
        let labels: Vec<String> = axis.ticks().into_iter().map(short).collect();
        assert_eq!(labels, ["20k", "50k", "100k", "200k", "500k", "1M", "2M"]);
    }
}
