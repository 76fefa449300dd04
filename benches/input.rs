//! Reading of scans: points a second from LAS and LAZ, on one thread and on all.
//!
//! Inputs are seeded scenes of two sizes and, where the shared scans are, the airborne one of
//! 10.65 M points. Texts of the same scenes are opened, which reads all of them, and read again:
//! bytes a second.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use esker::input::{
    BlockBuffer, ForeignReader, LasError, LasScan, LasTemplate, NewScan, PointFormat,
    PositionedFile, RowBuffer, TextOptions, TextReader,
};
use esker::output::{Compression, LasWriter};
use esker::points::Lattice;
use esker::sampling::Random;
use esker::sampling::scene::{self, Scene, SceneSettings};
use rayon::prelude::*;

/// Reads every block; the sum keeps the work from being dropped.
fn read(scan: &LasScan) -> u64 {
    let sums = scan.blocks().par_iter().map_init(BlockBuffer::default, |buffer, block| {
        let mut sum = 0u64;
        let outcome = scan.read_block::<LasError>(block, buffer, &mut |first, records| {
            sum = sum.wrapping_add(first + u64::from(records[0]));
            Ok(())
        });
        outcome.expect("the scan is whole");
        sum
    });
    sums.reduce(|| 0, u64::wrapping_add)
}

fn write_scene(path: &Path, points: u64, compression: Compression) {
    let scene = Scene::new(SceneSettings::new(points, 1));
    let (scale, offset) = scene.scale_and_offset();
    let point_format = PointFormat::new(scene::POINT_FORMAT).expect("the scene's format exists");
    let template = LasTemplate::for_new_scan(&NewScan {
        minor: 2,
        point_format,
        extra_bytes: 0,
        lattice: Lattice { scale, offset },
        system_identifier: "",
        generating_software: "",
        creation: (0, 0),
    });
    let (schema, _) = point_format.schema(scene::RECORD_BYTES as u16, &[]);
    let mut records = vec![0; points as usize * scene::RECORD_BYTES];
    scene.fill(0, &mut records);
    let writer = LasWriter::create(path, &template, &schema, compression);
    let mut writer = writer.expect("the folder takes files");
    writer.write(&records).expect("the disk has room");
    writer.finish(&mut std::io::empty()).expect("the disk has room");
}

fn inputs(folder: &Path) -> Vec<(String, PathBuf)> {
    let mut inputs = Vec::new();
    for points in [200_000, 1_000_000] {
        for (suffix, compression) in [("las", Compression::None), ("laz", Compression::Laz)] {
            let name = format!("scene-{points}.{suffix}");
            let path = folder.join(&name);
            write_scene(&path, points, compression);
            inputs.push((name, path));
        }
    }
    let real = "autzen-rgb-10m.laz";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(real);
    if path.exists() {
        inputs.push((real.to_string(), path));
    }
    inputs
}

fn reading(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut group = criterion.benchmark_group("read");
    group.sample_size(10);
    for (name, path) in inputs(folder.path()) {
        let scan = LasScan::open(&path).expect("the scan is whole");
        group.throughput(Throughput::Elements(scan.points()));
        for threads in [1, rayon::current_num_threads()] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.expect("threads can be started");
            group.bench_function(BenchmarkId::new(&name, threads), |bencher| {
                bencher.iter(|| pool.install(|| read(&scan)));
            });
        }
    }
}

/// Rows as PTS and as XYZ with colours, of whole millimetres.
fn texts(points: u64) -> [(String, Vec<u8>); 2] {
    let mut random = Random::new(1, points);
    let (mut pts, mut xyz) = (format!("{points}\n"), String::new());
    for _ in 0..points {
        let mut number = || random.between(-500.0, 500.0);
        let (x, y, z) = (635_000.0 + number(), 848_000.0 + number(), number());
        let [i, r, g, b] = [0; 4].map(|_| random.below(256));
        writeln!(pts, "{x:.3} {y:.3} {z:.3} {i} {r} {g} {b}").expect("memory suffices");
        writeln!(xyz, "{:.6} {:.6} {z:.6}", x - 635_000.0, y - 848_000.0).expect("memory suffices");
    }
    [("pts", pts), ("xyz", xyz)].map(|(name, text)| (format!("{points}.{name}"), text.into_bytes()))
}

fn parsing(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("text");
    group.sample_size(10);
    for (name, text) in texts(200_000).into_iter().chain(texts(1_000_000)) {
        group.throughput(Throughput::Bytes(text.len() as u64));
        let open = |text: Vec<u8>| {
            let opened = TextReader::open(PositionedFile::in_memory(text), &TextOptions::default());
            opened.expect("the text is right")
        };
        for threads in [1, rayon::current_num_threads()] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.expect("threads can be started");
            group.bench_function(BenchmarkId::new(format!("open {name}"), threads), |bencher| {
                let size = BatchSize::PerIteration;
                bencher.iter_batched(|| text.clone(), |text| pool.install(|| open(text)), size);
            });
            let reader = open(text.clone());
            group.bench_function(BenchmarkId::new(format!("read {name}"), threads), |bencher| {
                let blocks = 0..reader.facts().blocks.len();
                bencher.iter(|| {
                    pool.install(|| {
                        let read = |rows: &mut RowBuffer, block| {
                            reader.read_block(block, rows).expect("the text is right");
                        };
                        blocks.clone().into_par_iter().for_each_init(RowBuffer::default, read);
                    });
                });
            });
        }
    }
}

criterion_group!(benches, reading, parsing);
criterion_main!(benches);
