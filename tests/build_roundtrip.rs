//! Protects against loss: what goes into a store comes out again, record by record.
//!
//! Every LAS and LAZ file of the shared data is converted, checked and exported, once as LAS and
//! once as LAZ; the exported file must hold the same multiset of complete records (coordinates as
//! integers, every field, every extra byte) and the same variable length records.

#[path = "support/shared_data.rs"]
mod shared_data;

use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use esker::input::{BlockBuffer, LasError, LasScan};

fn esker() -> Command {
    Command::new(env!("CARGO_BIN_EXE_esker"))
}

fn convert_and_export(input: &Path, folder: &Path, suffix: &str) -> PathBuf {
    let (store, output) = (folder.join("scan.esker"), folder.join(format!("back.{suffix}")));
    let convert = esker().arg("convert").arg(input).arg("-o").arg(&store).arg("--overwrite").ok();
    convert.unwrap_or_else(|error| panic!("{}: {error}", input.display()));
    esker().arg("check").arg(&store).assert().success();
    esker().arg("export").arg(&store).arg("-o").arg(&output).arg("--overwrite").assert().success();
    output
}

/// All records of a scan, sorted.
fn sorted_records(scan: &LasScan) -> Vec<Vec<u8>> {
    let record_bytes = scan.schema().record_bytes as usize;
    let mut buffer = BlockBuffer::default();
    let mut records = Vec::new();
    for block in scan.blocks() {
        scan.read_block(block, &mut buffer, &mut |_, part| {
            records.extend(part.chunks_exact(record_bytes).map(<[u8]>::to_vec));
            Ok::<(), LasError>(())
        })
        .expect("the block reads");
    }
    records.sort_unstable();
    records
}

/// Hashes of all records, sorted: as good as the records, and quick for millions of them.
fn sorted_hashes(scan: &LasScan) -> Vec<u64> {
    let record_bytes = scan.schema().record_bytes as usize;
    let mut buffer = BlockBuffer::default();
    let mut hashes = Vec::new();
    for block in scan.blocks() {
        scan.read_block(block, &mut buffer, &mut |_, part| {
            hashes.extend(part.chunks_exact(record_bytes).map(|record| {
                let mut hasher = DefaultHasher::new();
                hasher.write(record);
                hasher.finish()
            }));
            Ok::<(), LasError>(())
        })
        .expect("the block reads");
    }
    hashes.sort_unstable();
    hashes
}

/// Variable length records that must survive: all but those that describe compression or the order
/// of points in the file.
fn kept_vlrs(scan: &LasScan) -> Vec<(String, u16, u64, bool)> {
    let facts = scan.facts().vlrs.iter();
    let kept = facts.filter(|vlr| vlr.user_id != "laszip encoded" && vlr.user_id != "copc");
    kept.map(|v| (v.user_id.clone(), v.record_id, v.data_bytes, v.extended)).collect()
}

fn assert_same(input: &Path, output: &Path) {
    let name = input.display();
    let (before, after) = (
        LasScan::open(input).expect("the input opens"),
        LasScan::open(output).unwrap_or_else(|error| panic!("{name}: {error}")),
    );
    assert_eq!(before.schema(), after.schema(), "{name}: record layout");
    assert_eq!(before.lattice(), after.lattice(), "{name}: lattice");
    assert_eq!(before.facts().crs, after.facts().crs, "{name}: reference system");
    assert_eq!(kept_vlrs(&before), kept_vlrs(&after), "{name}: records beside the points");
    let (before, after) = (sorted_hashes(&before), sorted_hashes(&after));
    assert_eq!(before.len(), after.len(), "{name}: points");
    assert!(before == after, "{name}: some record is not what it was");
}

#[test]
fn every_shared_scan_comes_back() {
    let Some(files) = shared_data::scans() else { return };
    assert!(files.len() > 15, "the shared data is complete");
    for input in files {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let size = input.metadata().expect("the file is there").len();
        // The large scan comes back as plain LAS only: compressing it again takes its time.
        let suffixes: &[&str] = if size > 20_000_000 { &["las"] } else { &["las", "laz"] };
        for suffix in suffixes {
            let output = convert_and_export(&input, folder.path(), suffix);
            assert_same(&input, &output);
        }
    }
}

#[test]
fn selections_select() {
    let Some(input) = shared_data::file("autzen_trim_7.las") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (store, output) = (folder.path().join("s.esker"), folder.path().join("part.las"));
    esker().arg("convert").arg(&input).arg("-o").arg(&store).assert().success();
    let scan = LasScan::open(&input).expect("the input opens");
    let all = sorted_records(&scan);
    let lattice = scan.lattice();
    let world = |record: &[u8]| {
        let steps = esker::points::record_coordinates(record).map(i64::from);
        lattice.world(glam::I64Vec3::from_array(steps))
    };
    let export = |arguments: &[&str]| {
        let command = &mut esker();
        command.arg("export").arg(&store).arg("-o").arg(&output).arg("--overwrite");
        command.args(arguments).assert().success();
        sorted_records(&LasScan::open(&output).expect("the part opens"))
    };

    let box_text = "636200,849000,400,636500,849200,450";
    let inside = export(&["--bounds", box_text]);
    let expected: Vec<Vec<u8>> = all
        .iter()
        .filter(|record| {
            let p = world(record);
            (636_200.0..=636_500.0).contains(&p.x)
                && (849_000.0..=849_200.0).contains(&p.y)
                && (400.0..=450.0).contains(&p.z)
        })
        .cloned()
        .collect();
    assert!(!expected.is_empty() && expected.len() < all.len());
    assert!(inside == expected, "{} points inside, expected {}", inside.len(), expected.len());

    let (_, class) = scan.schema().find("classification").expect("format 7 has a class");
    let at = class.record_offset as usize;
    let ground = export(&["--class", "2"]);
    let expected = all.iter().filter(|record| record[at] == 2).count();
    assert!(expected > 0 && ground.len() == expected);
    assert!(ground.iter().all(|record| record[at] == 2));

    let coarse = export(&["--level", "0"]);
    assert!(!coarse.is_empty() && coarse.len() < all.len());
}

#[test]
fn a_store_adds_no_points_and_little_beside_them() {
    let Some(input) = shared_data::file("autzen_trim_7.las") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("s.esker");
    esker().arg("convert").arg(&input).arg("-o").arg(&path).assert().success();
    let store = esker::store::Store::open(&path).expect("the store opens");
    let scan = LasScan::open(&input).expect("the input opens");
    assert_eq!(store.octree().point_count(), scan.points());
    // What drawing needs, decoded: position and colour words, and the directory.
    let (mut words, mut drawn_bytes) = (Vec::new(), store.header().directory.bytes);
    for node in (0..store.octree().nodes().len() as u32).map(esker::ids::NodeId) {
        store.read_positions(node, &mut words).expect("the node reads");
        drawn_bytes += 4 * words.len() as u64;
        store.read_colors(node, &mut words).expect("the node reads");
        drawn_bytes += 4 * words.len() as u64;
    }
    let per_point = drawn_bytes as f64 / scan.points() as f64;
    assert!(per_point <= 16.5, "{per_point} bytes a point");
}
