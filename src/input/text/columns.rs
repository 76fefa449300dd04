//! What the columns of a text mean: told by the user, by a header line, or guessed.

use std::str::FromStr;

use super::row::{MOST_COLUMNS, quote};
use super::stats::ColumnStats;
use crate::points::names;

/// The coordinates, in this order.
pub const AXES: [&str; 3] = ["x", "y", "z"];
/// Components of the colour.
pub const COLORS: [&str; 3] = ["red", "green", "blue"];
/// Components of the normal.
pub const NORMALS: [&str; 3] = ["normal_x", "normal_y", "normal_z"];
/// A column that is passed over unread.
pub const SKIP: &str = "skip";

/// Names of all columns of a text, in its order, as an option gives them.
///
/// Invariants: `x`, `y` and `z` occur once; other names at most once, but for `skip`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnList(Vec<String>);

impl ColumnList {
    /// The names, in the words of this module.
    pub fn names(&self) -> &[String] {
        &self.0
    }
}

impl FromStr for ColumnList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut list = Vec::new();
        let words: Vec<&str> = text.split(',').map(str::trim).collect();
        let names = words.iter().map(|word| match *word {
            "-" | "_" => SKIP.to_string(),
            _ => canonical(word),
        });
        for (name, word) in whole_colors(names.collect(), &words).into_iter().zip(words) {
            if name.is_empty() {
                return Err(format!("{word:?} is no column name"));
            }
            if name != SKIP && list.contains(&name) {
                return Err(format!("{name} occurs twice"));
            }
            list.push(name);
        }
        if let Some(axis) = AXES.iter().find(|axis| !list.iter().any(|name| name == *axis)) {
            return Err(format!("{axis} is missing"));
        }
        if list.len() > MOST_COLUMNS {
            return Err(format!("more than {MOST_COLUMNS} columns"));
        }
        Ok(ColumnList(list))
    }
}

/// Names of the columns that a header line gives; empty and repeated ones get a name of their own.
/// An error if the coordinates are not among them.
pub fn from_header(fields: &[&[u8]]) -> Result<Vec<String>, String> {
    let mut list: Vec<String> = Vec::with_capacity(fields.len());
    let words: Vec<_> = fields.iter().map(|field| String::from_utf8_lossy(field)).collect();
    let names = words.iter().map(|word| canonical(word)).collect();
    for (index, mut name) in whole_colors(names, &words).into_iter().enumerate() {
        if name.is_empty() || name == SKIP {
            name = unnamed(index);
        }
        let repeats = list.iter().filter(|other| **other == name).count();
        if repeats > 0 {
            let numbered = (2..).map(|count| format!("{name}_{count}"));
            name = numbered.into_iter().find(|name| !list.contains(name)).unwrap_or(name);
        }
        list.push(name);
    }
    if AXES.iter().all(|axis| list.iter().any(|name| name == axis)) {
        return Ok(list);
    }
    let found: Vec<String> = fields.iter().take(12).map(|field| quote(field)).collect();
    Err(format!("the header names no x, y and z but {}; --columns sets the names", found.join(" ")))
}

/// Names of columns of which nothing is known but the numbers in them. The first three are the
/// coordinates; a column gets a name of its own where the numbers allow only one meaning.
///
/// One column more is the intensity, three are the colour or the normal, four intensity and
/// colour; of more, colour and normal are found where exactly one run of three can be them.
pub fn guess(stats: &[ColumnStats]) -> Vec<String> {
    let mut list: Vec<String> = AXES.iter().map(|axis| (*axis).to_string()).collect();
    list.extend((3..stats.len()).map(unnamed));
    let mut free: Vec<usize> = (3..stats.len()).collect();
    let name_run = |list: &mut Vec<String>, free: &mut Vec<usize>, run: usize, words: [&str; 3]| {
        for (index, word) in (run..run + 3).zip(words) {
            list[index] = word.to_string();
        }
        free.retain(|index| !(run..run + 3).contains(index));
    };
    let runs = |free: &[usize]| -> Vec<usize> {
        let ends = free.windows(3).filter(|run| run[2] == run[0] + 2);
        ends.map(|run| run[0]).collect()
    };
    let is_normal = |run: &&usize| {
        let run = &stats[**run..**run + 3];
        let within = |s: &ColumnStats| s.is_fraction_within(-1, 1) || s.is_whole_within(-1, 1);
        run.iter().all(within)
            && run.iter().any(ColumnStats::has_negative)
            && run.iter().any(|s| s.is_fraction_within(-1, 1))
    };
    if let [run] = runs(&free).iter().filter(is_normal).collect::<Vec<_>>()[..] {
        name_run(&mut list, &mut free, *run, NORMALS);
    }
    let is_color = |high: i64| {
        move |run: &usize| stats[*run..*run + 3].iter().all(|s| s.is_whole_within(0, high))
    };
    let is_fraction = |run: &usize| {
        let run = &stats[*run..*run + 3];
        let within = |s: &ColumnStats| s.is_fraction_within(0, 1) || s.is_whole_within(0, 1);
        run.iter().all(within) && run.iter().any(|s| s.is_fraction_within(0, 1))
    };
    let candidates = |rule: &dyn Fn(&usize) -> bool| -> Vec<usize> {
        runs(&free).into_iter().filter(rule).collect()
    };
    let narrow = candidates(&is_color(255));
    let wide = candidates(&is_color(i64::from(u16::MAX)));
    let fractions = candidates(&is_fraction);
    let run = match (free.len(), &narrow[..], &wide[..], &fractions[..]) {
        // Intensity stands before the colour in PTS and its kin, so the later run wins.
        (3 | 4, [.., run], ..) | (3 | 4, [], [.., run], _) | (3 | 4, [], [], [.., run]) => {
            Some(*run)
        }
        (5.., [run], ..) => Some(*run),
        _ => None,
    };
    if let Some(run) = run {
        name_run(&mut list, &mut free, run, COLORS);
    }
    if let [single] = free[..] {
        list[single] = names::INTENSITY.to_string();
    }
    list
}

/// Takes `r`, `g` and `b` for colours only where all three are there.
fn whole_colors<T: AsRef<str>>(mut names: Vec<String>, words: &[T]) -> Vec<String> {
    if !COLORS.iter().all(|color| names.iter().any(|name| name == color)) {
        for (name, word) in names.iter_mut().zip(words) {
            if let [letter @ (b'r' | b'g' | b'b' | b'R' | b'G' | b'B')] = word.as_ref().as_bytes() {
                *name = char::from(letter.to_ascii_lowercase()).to_string();
            }
        }
    }
    names
}

/// The name of a column without one; `index` counts from 0, people from 1.
fn unnamed(index: usize) -> String {
    format!("column_{}", index + 1)
}

/// The one word for the many that programs write.
pub fn canonical(name: &str) -> String {
    // Units stand in brackets: "X[m]", "Intensity (dB)".
    let name = name.split(['[', '(']).next().unwrap_or_default();
    let mut word = String::new();
    for letter in name.trim_matches(|c: char| !c.is_alphanumeric()).chars() {
        if word.len() >= 48 {
            break;
        }
        match letter {
            letter if letter.is_alphanumeric() => word.extend(letter.to_lowercase()),
            _ if !word.ends_with('_') => word.push('_'),
            _ => {}
        }
    }
    let word = word.trim_end_matches('_');
    let known = match word {
        "x" | "easting" | "east" | "x_coordinate" | "coord_x" | "longitude" | "lon" => "x",
        "y" | "northing" | "north" | "y_coordinate" | "coord_y" | "latitude" | "lat" => "y",
        "z" | "elevation" | "height" | "altitude" | "z_coordinate" | "coord_z" => "z",
        "r" | "red" | "rf" => "red",
        "g" | "green" | "gf" => "green",
        "b" | "blue" | "bf" => "blue",
        "nx" | "normalx" | "normal_x" | "n_x" => "normal_x",
        "ny" | "normaly" | "normal_y" | "n_y" => "normal_y",
        "nz" | "normalz" | "normal_z" | "n_z" => "normal_z",
        "i" | "intensity" | "scalar_intensity" => names::INTENSITY,
        "class" | "classification" | "scalar_classification" => names::CLASSIFICATION,
        "gpstime" | "gps_time" | "scalar_gpstime" => names::GPS_TIME,
        "pointsourceid" | "point_source_id" => names::POINT_SOURCE_ID,
        "userdata" | "user_data" => names::USER_DATA,
        "scanangle" | "scan_angle" => names::SCAN_ANGLE,
        "nir" | "infrared" | "near_infrared" => names::NIR,
        "skip" | "ignore" => SKIP,
        // Attributes of records that a plain column of text cannot be.
        "rgb" | "normal" | "source" | "coordinate_residual" | "wave_packet" => {
            return format!("{word}_column");
        }
        other => other,
    };
    known.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::text::number::read_plain;

    fn guessed(rows: &[&str]) -> String {
        let mut stats = Vec::new();
        for row in rows {
            for (index, word) in row.split(' ').enumerate() {
                stats.resize(stats.len().max(index + 1), ColumnStats::EMPTY);
                stats[index].add(&read_plain(word.as_bytes(), 0).expect("a number").0);
            }
        }
        guess(&stats).join(" ")
    }

    #[test]
    fn columns_are_guessed_from_their_numbers() {
        assert_eq!(guessed(&["1 2 3"]), "x y z");
        assert_eq!(guessed(&["1 2 3 -400"]), "x y z intensity");
        assert_eq!(guessed(&["1 2 3 7 8"]), "x y z column_4 column_5");
        assert_eq!(guessed(&["1 2 3 7 8 255"]), "x y z red green blue");
        assert_eq!(guessed(&["1 2 3 700 8 65535"]), "x y z red green blue");
        assert_eq!(guessed(&["1 2 3 0.25 0.5 1"]), "x y z red green blue");
        assert_eq!(guessed(&["1 2 3 -0.6 0.8 0"]), "x y z normal_x normal_y normal_z");
        assert_eq!(guessed(&["1 2 3 7 8 9 10"]), "x y z intensity red green blue");
        assert_eq!(guessed(&["1 2 3 -7 8 9 10"]), "x y z intensity red green blue");
        assert_eq!(guessed(&["1 2 3 7 8 9 0.5"]), "x y z red green blue intensity");
        assert_eq!(guessed(&["1 2 3 7 8 9 1000"]), "x y z red green blue intensity");
        let both = "x y z red green blue normal_x normal_y normal_z";
        assert_eq!(guessed(&["1 2 3 7 8 9 -0.5 0.5 0.707"]), both);
        let all = "x y z intensity red green blue normal_x normal_y normal_z";
        assert_eq!(guessed(&["1 2 3 0.5 7 8 9 -0.5 0.5 0.707"]), all);
        let unknown = "x y z column_4 column_5 column_6 column_7 column_8";
        assert_eq!(guessed(&["1 2 3 4 5 6 7 8"]), unknown);
        assert_eq!(guessed(&["1 2 3 1.5 2.5 3.5"]), "x y z column_4 column_5 column_6");
    }

    #[test]
    fn names_of_many_programs_mean_the_same() {
        let header = b"\"X[m]\";Northing;Height (m);Intensity;R;G;B;Nx;Amplitude-Ratio;;R";
        let fields: Vec<&[u8]> = header.split(|byte| *byte == b';').collect();
        let expected = "x y z intensity red green blue normal_x amplitude_ratio column_10 red_2";
        assert_eq!(from_header(&fields).expect("it names x, y, z").join(" "), expected);
        let fields: Vec<&[u8]> = vec![b"a", b"b", b"c"];
        let reason = from_header(&fields).expect_err("it names no coordinates");
        assert!(reason.contains("\"a\" \"b\" \"c\"") && reason.contains("--columns"), "{reason}");
    }

    #[test]
    fn lists_of_the_user_are_checked() {
        let list: ColumnList = "x,y,z,i,r,g,b,skip,Label,-".parse().expect("it is right");
        let names = ["x", "y", "z", "intensity", "red", "green", "blue", "skip", "label", "skip"];
        assert_eq!(list.names(), names);
        for (text, reason) in [
            ("x,y", "z is missing"),
            ("x,y,z,x", "x occurs twice"),
            ("x,y,z,", "\"\" is no column name"),
        ] {
            assert_eq!(text.parse::<ColumnList>(), Err(reason.to_string()), "{text}");
        }
    }
}
