//! Texts that are damaged, strange or no points at all: each is read or refused with a line that
//! names place and reason; none brings a panic or memory that the text merely claims.

#[path = "support/text_files.rs"]
mod text_files;
#[path = "support/watched_memory.rs"]
mod watched_memory;

use std::sync::atomic::Ordering;

use esker::input::{ForeignReader, PositionedFile, RowBuffer, TextOptions, TextReader};
use esker::sampling::Random;
use text_files::{columns, fault, leaving_out, open, open_with, read, with_columns};
use watched_memory::LARGEST;

/// More than any honest need of texts below 8 MiB on a few threads.
const MOST_MEMORY: usize = 64 << 20;

const PTX: &str = "2\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n\
                   1 0 0 0\n0 1 0 0\n0 0 1 0\n5 5 5 1\n1 2 3 0.5\n4 5 6 1\n";

#[test]
fn faults_of_tables_name_line_and_column() {
    for (text, expected) in [
        ("", "line 1: no row of numbers"),
        ("\n\n# nothing\n", "line 3: no row of numbers"),
        ("x y z\n", "line 1: no row of numbers"),
        ("hello\nworld\n", "line 2: neither a header nor a row: \"world\" is not a number"),
        ("1 2\n3 4\n", "line 1: 2 columns; a point needs x, y and z"),
        ("1 2 3\n4 5\n", "line 2: 2 columns, expected 3 as in the rows before"),
        ("1 2 3\n4 5 6 7\n", "line 2: more than the 3 columns of the rows before"),
        ("1 2 3\n\n# c\n4 five 6\n", "line 4, column 2: \"five\" is not a number"),
        ("x,y,z,label\n1,2,3,oak\n", "line 2, column 4 (label): \"oak\" is not a number"),
        ("1 2 3\n4 5 6.7.8\n", "line 2, column 3: \"6.7.8\" is not a number"),
        (
            "x,y\n1,2,3\n",
            "line 1: the header has 2 names, the rows have 3 columns; --columns sets the names",
        ),
        (
            "a,b,c\n1,2,3\n",
            "line 1: the header names no x, y and z but \"a\" \"b\" \"c\"; --columns sets the names",
        ),
        ("1,5 2,5 3,5\n", "line 1: \"1,5\" has a decimal comma; numbers need a decimal point"),
        (
            "1.5;2;3\n4;5,5;6\n",
            "line 2, column 2: \"5,5\" has a decimal comma; numbers need a decimal point",
        ),
        ("1 2 3\n4 5\0 6\n", "line 2: a NUL byte: the text is damaged, binary or UTF-16"),
        (
            "1 2 3\r4 5 6\r",
            "line 1: a carriage return within the line; lines must end with a line feed",
        ),
        ("ncols 4\nnrows 2\n1 2 3 4\n", "line 1: an ESRI grid of heights, not a list of points"),
    ] {
        let found = fault(text);
        assert_eq!(found, expected, "{text:?}");
    }
}

#[test]
fn other_encodings_are_refused() {
    let utf_16 = |mark: [u8; 2], swap: bool| {
        let units = "1 2 3\n"
            .encode_utf16()
            .flat_map(|unit| if swap { unit.to_be_bytes() } else { unit.to_le_bytes() });
        mark.into_iter().chain(units).collect::<Vec<u8>>()
    };
    let expected = "line 1: UTF-16 text is not read; save it as UTF-8 or ASCII";
    assert_eq!(fault(utf_16([0xff, 0xfe], false)), expected);
    assert_eq!(fault(utf_16([0xfe, 0xff], true)), expected);
    // Without a mark the NUL bytes tell.
    assert!(fault(&utf_16([0xff, 0xfe], false)[2..]).contains("UTF-16"));
    // Bytes that are no UTF-8 stand in comments and names without harm.
    let latin = open(b"x y z H\xf6he\n1 2 3 4\n# \xe4\n").expect("the rows are right");
    assert_eq!(columns(&latin), "h_he:u16");
}

#[test]
fn lists_of_columns_must_fit() {
    let wrong = open_with("1 2 3 4\n", &with_columns("x,y,z")).expect_err("it is too short");
    assert_eq!(wrong.to_string(), "line 1: 4 columns, but --columns names 3");
    let wrong = open_with("2\n1 2 3\n4 5 6\n", &with_columns("x,y,z,i")).expect_err("too long");
    assert_eq!(wrong.to_string(), "line 2: 3 columns, but --columns names 4");
}

#[test]
fn long_lines_and_many_columns_are_refused() {
    let line = |length: usize| format!("1 2 3\n4 5 {}6\n", " ".repeat(length));
    assert_eq!(open(line(60_000)).expect("64 KiB are read").facts().points, 2);
    let too_long = "longer than 65536 bytes, the most that a line may have";
    assert_eq!(fault(line(70_000)), format!("line 2: {too_long}"));
    assert_eq!(fault(line(3 << 20)), format!("line 2: {too_long}"));
    assert_eq!(fault("7".repeat(3 << 20)), format!("line 1: {too_long}"));
    assert_eq!(
        fault(format!("1 2 3\n# {}\n4 5 6\n", "c".repeat(70_000))),
        format!("line 2: {too_long}")
    );
    // The line that never ends comes after several pieces of good ones.
    let text = "1 2 3\n".repeat(1 << 20) + &"8".repeat(8 << 20);
    assert_eq!(fault(text), format!("line 1048577: {too_long}"));
    let columns = |count: usize| vec!["1"; count].join(" ");
    assert_eq!(open(columns(256)).expect("256 are read").facts().points, 1);
    assert_eq!(fault(columns(257)), "line 1: 257 columns; 256 are the most");
}

#[test]
fn faults_far_into_a_text_name_their_line() {
    let mut text = "1 2 3 4\n".repeat(700_000);
    text.push_str("1 2 3 x\n");
    text.push_str(&"1 2 3 4\n".repeat(300_000));
    assert_eq!(fault(text), "line 700001, column 4: \"x\" is not a number");
}

#[test]
fn faults_of_pts_and_ptx_name_scan_and_line() {
    let ptx = |from: &str, to: &str| {
        assert!(PTX.contains(from), "{from:?} is replaced");
        fault(PTX.replacen(from, to, 1))
    };
    for (found, expected) in [
        (fault("3\n1 2 3\n4 5 6\n"), "line 3: scan 1 counts 3 rows and has 2"),
        (fault("2\n1 2 3\n1\n4 5 6\n"), "line 2: scan 1 counts 2 rows and has 1"),
        (fault("2\n1 2 3\n4 5\n"), "line 3: 2 columns, expected 3 as in the rows before"),
        (fault("1\n1 2 3\n1\n4 5\n"), "line 4: 2 columns, expected 3 to 256"),
        (ptx("4 5 6 1\n", ""), "line 11: scan 1 counts 2 rows and has 1"),
        (ptx("4 5 6 1\n", "4 5 6 1\n7 8 9 1\n"), "line 13: scan 1 counts 2 rows and has 3"),
        (
            ptx("5 5 5 1\n", "5 5 5 2\n"),
            "line 10: the scan's matrix ends in the column [0.0, 0.0, 0.0, 2.0], expected [0, 0, 0, 1]",
        ),
        (ptx("0 1 0\n", "0 1 x\n"), "line 5, column 3: \"x\" is not a number"),
        (ptx("0 1 0\n", "0 nan 0\n"), "line 5, column 2: \"nan\" is not a number"),
        (
            ptx("0 1 0 0\n", "0 1 0\n"),
            "line 8: 3 numbers, expected 4: a row of the scan's matrix of scan 1",
        ),
        (
            fault(PTX.split_inclusive('\n').take(9).collect::<String>()),
            "line 9: the file ends within the head of scan 1",
        ),
        (fault(PTX.to_string() + "7\n"), "line 13: the file ends within the head of scan 2"),
        (
            fault(PTX.to_string() + "7\n1 2 3\n"),
            "line 14: \"1 2 3\" where scan 2 should tell its count of rows",
        ),
        (
            fault("99999999999999999999\n1 2 3\n"),
            "line 2: scan 1 counts 18446744073709551615 rows and has 1",
        ),
    ] {
        assert_eq!(found, expected);
    }
}

#[test]
fn bad_lines_can_be_left_out_and_are_counted() {
    let text = "x y z i\n1 2 3 4\noak\n5 6 7\n8 9 10 11\n1 2 3 4 5\n\0\0\n12 13 14 15\n";
    let reader = open_with(text, &leaving_out()).expect("what can be read is read");
    assert_eq!(reader.facts().points, 3);
    assert_eq!(reader.facts().skipped, [("lines that are no rows".to_string(), 4)]);
    assert_eq!(reader.facts().parts[0].points, 3);
    assert_eq!(read(&reader).attributes, [[4.0], [11.0], [15.0]]);
}

#[test]
fn claims_cost_no_memory() {
    LARGEST.store(0, Ordering::Relaxed);
    let huge = PTX.replacen("2\n1\n", "4000000000\n4000000000\n", 1);
    assert!(fault(huge).contains("counts 16000000000000000000 rows"));
    // Nothing but scans without rows, up to the limit, and rows of many columns.
    let scans = "0\n".repeat(65_537);
    assert_eq!(fault(scans), "line 65537: more than 65536 scans in one file");
    let wide = format!("1\n{}\n", vec!["1"; 256].join(" ")).repeat(4_000);
    assert_eq!(open(wide).expect("it is right").facts().parts.len(), 4_000);
    assert!(LARGEST.load(Ordering::Relaxed) < MOST_MEMORY);
}

#[test]
fn a_file_that_changes_is_noticed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scan.xyz");
    let open_path = || {
        let file = std::fs::File::open(&path).expect("it opens");
        let bytes = file.metadata().expect("it has a length").len();
        TextReader::open(PositionedFile::new(file, bytes), &TextOptions::default())
    };
    std::fs::write(&path, "1 2 3\n4 5 6\n").expect("it is written");
    let reader = open_path().expect("it is right");
    let mut rows = RowBuffer::default();
    let mut after = |text: &str| {
        std::fs::write(&path, text).expect("it is written");
        reader.read_block(0, &mut rows).expect_err("it has changed").to_string()
    };
    assert!(after("1 2 3\n# cc\n\n").contains("it has changed"));
    assert_eq!(after("1 2 3\n4 x 6\n"), "line 2, column 2: \"x\" is not a number");
    assert_eq!(after("1 2 3\n"), "byte 6: the file ended while bytes 0..12 were read");
}

/// Opens and reads whatever comes; answers must be values and agree with themselves.
fn survive(text: &[u8]) {
    for options in [TextOptions::default(), leaving_out()] {
        if let Ok(reader) = open_with(text, &options) {
            read(&reader);
        }
    }
}

#[test]
fn truncated_texts_are_values() {
    let table = "x,y,z,i,r,g,b\n# c\n1.25,-2,3e1,4,5,6,7\r\n,2,nan,4,5,6,7\n8,9,10,11,12,13,14";
    for text in [PTX, table, "2\n1 2 3 4\n5 6 7 8\n1\n9 9 9\n"] {
        for end in 0..=text.len() {
            survive(&text.as_bytes()[..end]);
        }
    }
}

#[test]
fn damaged_texts_are_values() {
    LARGEST.store(0, Ordering::Relaxed);
    let mut random = Random::new(5, 0);
    let table = "x,y,z,i,r,g,b\n1.25,-2,3,4,5,6,7\n2,2,3,4,5,6,7\n8,9,10,11,12,13,14\n";
    let letters = b"0123456789.,;-+eE \t\n\r#/\"nxz\0\xff";
    for text in [PTX, table, "2\n1 2 3 4\n5 6 7 8\n1\n9 9 9\n"] {
        for _ in 0..4_000 {
            let mut bytes = text.as_bytes().to_vec();
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len() as u64) as usize;
                let letter = letters[random.below(letters.len() as u64) as usize];
                match random.below(3) {
                    0 => bytes[at] = letter,
                    1 => bytes.insert(at, letter),
                    _ => drop(bytes.remove(at)),
                }
            }
            survive(&bytes);
        }
    }
    assert!(LARGEST.load(Ordering::Relaxed) < MOST_MEMORY);
}
