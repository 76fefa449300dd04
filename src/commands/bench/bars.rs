//! Stacked bars as SVG text: what a whole is made of, several wholes below one another.

use std::fmt::Write;

use crate::commands::bench::plot::head;

/// One bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Stands in front.
    pub name: String,
    /// Parts from the left: name and length.
    pub parts: Vec<(String, f64)>,
}

const WIDTH: f64 = 900.0;
const LEFT: f64 = 190.0;
const BAR_HEIGHT: f64 = 26.0;
const ROW_HEIGHT: f64 = 62.0;
/// The palette of Okabe and Ito, which colour-blind readers can tell apart, and greys.
const COLORS: [&str; 9] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#777777",
    "#bbbbbb",
];

/// The bars below one another, in the same scale.
pub fn svg(heading: &str, unit: &str, bars: &[Bar]) -> String {
    let whole = |bar: &Bar| bar.parts.iter().map(|(_, length)| length.max(0.0)).sum::<f64>();
    let longest = bars.iter().map(whole).fold(0.0, f64::max);
    let scale = if longest > 0.0 { (WIDTH - LEFT - 80.0) / longest } else { 0.0 };
    let height = 50.0 + ROW_HEIGHT * bars.len() as f64;
    let mut out = head(WIDTH, height, heading);
    for (row, bar) in bars.iter().enumerate() {
        let top = 44.0 + ROW_HEIGHT * row as f64;
        let middle = top + 0.5 * BAR_HEIGHT + 4.0;
        text(&mut out, (LEFT - 8.0, middle), "end", "", &bar.name);
        let mut at = LEFT;
        // Names that do not fit over their part stand in turns below it.
        for (i, (name, length)) in bar.parts.iter().enumerate() {
            let width = length.max(0.0) * scale;
            let color = COLORS[i % COLORS.len()];
            line(
                &mut out,
                format_args!(
                    "<rect x=\"{at:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" \
                     height=\"{BAR_HEIGHT}\" fill=\"{color}\"><title>{} {length:.1} {unit}</title>\
                     </rect>",
                    escaped(name)
                ),
            );
            if width > 24.0 {
                let label = format!("{name} {length:.1}");
                let below = top + BAR_HEIGHT + 13.0 + 12.0 * (i % 2) as f64;
                text(&mut out, (at, below), "start", "font-size=\"10\"", &label);
            }
            at += width;
        }
        let label = format!("{:.1} {unit}", whole(bar));
        text(&mut out, (at + 8.0, middle), "start", "font-weight=\"bold\"", &label);
    }
    out.push_str("</svg>\n");
    out
}

fn escaped(content: &str) -> String {
    content.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn text(out: &mut String, (x, y): (f64, f64), anchor: &str, attributes: &str, content: &str) {
    let content = escaped(content);
    line(
        out,
        format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {attributes}>{content}</text>"
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

    #[test]
    fn bars_share_a_scale_and_nothing_is_infinite() {
        let bar = |name: &str, lengths: &[f64]| Bar {
            name: name.into(),
            parts: lengths.iter().map(|&length| ("a < b".into(), length)).collect(),
        };
        let drawn = svg("h", "ns", &[bar("one", &[100.0, 200.0]), bar("two", &[300.0])]);
        assert_eq!(drawn.matches("width=\"630.0\"").count(), 1, "{drawn}");
        assert_eq!(drawn.matches("width=\"420.0\"").count(), 1, "{drawn}");
        assert!(drawn.contains("a &lt; b 200.0"));
        for empty in [svg("h", "ns", &[]), svg("h", "ns", &[bar("none", &[0.0])])] {
            assert!(!empty.contains("NaN") && !empty.contains("inf"), "{empty}");
        }
    }
}
