//! Small PLY, PCD and E57 files, made byte by byte (E57 by the crate's own writer), and what a scan
//! of any format hands out.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use e57::{
    E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation,
};
use esker::input::{BlockBuffer, ReadOptions, Scan, ScanError};
use esker::points::{Schema, exact_position, names, record_coordinates};
use glam::{DVec3, I64Vec3};

/// One point of the small files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    pub position: [f32; 3],
    pub color: [u8; 3],
    pub label: i16,
}

/// Points that differ in every value, some of them far apart in size.
pub fn samples(count: usize) -> Vec<Sample> {
    let sample = |i: usize| {
        let t = i as f32;
        Sample {
            position: [
                0.1 + t * 0.37,
                -2.5e-3 * t,
                if i.is_multiple_of(7) { 1e-20 } else { 100.0 / (t + 1.0) },
            ],
            color: [(i * 7) as u8, (i * 13) as u8, (i * 29) as u8],
            label: i as i16 - 50,
        }
    };
    (0..count).map(sample).collect()
}

/// How a PLY file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ply {
    Ascii,
    Little,
    Big,
    /// Little-endian with a list in every vertex.
    Listed,
}

/// A PLY file with an element before the vertices and faces behind them.
pub fn ply(samples: &[Sample], kind: Ply) -> Vec<u8> {
    let format = match kind {
        Ply::Ascii => "ascii",
        Ply::Big => "binary_big_endian",
        Ply::Little | Ply::Listed => "binary_little_endian",
    };
    let list = if kind == Ply::Listed { "property list uchar short rings\n" } else { "" };
    let mut file = format!(
        "ply\nformat {format} 1.0\ncomment made by hand\nelement camera 1\n\
         property list uint double matrix\nproperty float focus\nelement vertex {}\n\
         property float x\nproperty float y\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\n{list}property float z\nproperty short Label\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n",
        samples.len()
    )
    .into_bytes();
    if kind == Ply::Ascii {
        file.extend(b"2 0.5 0.25 35\n");
        for s in samples {
            let ([x, y, z], [r, g, b]) = (s.position, s.color);
            file.extend(format!("{x} {y} {r} {g} {b} {z:e} {}\n", s.label).bytes());
        }
        file.extend(b"3 0 1 2\n");
        return file;
    }
    let mut put = |bytes: &[u8]| match kind {
        Ply::Big => file.extend(bytes.iter().rev()),
        _ => file.extend(bytes),
    };
    put(&2u32.to_le_bytes());
    put(&0.5f64.to_le_bytes());
    put(&0.25f64.to_le_bytes());
    put(&35f32.to_le_bytes());
    for (i, s) in samples.iter().enumerate() {
        put(&s.position[0].to_le_bytes());
        put(&s.position[1].to_le_bytes());
        s.color.iter().for_each(|channel| put(&[*channel]));
        if kind == Ply::Listed {
            put(&[(i % 4) as u8]);
            (0..i % 4).for_each(|ring| put(&(ring as i16).to_le_bytes()));
        }
        put(&s.position[2].to_le_bytes());
        put(&s.label.to_le_bytes());
    }
    put(&[3]);
    (0..3).for_each(|corner: i32| put(&corner.to_le_bytes()));
    file
}

/// How a PCD file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pcd {
    Ascii,
    Binary,
    Compressed,
}

/// A PCD file whose points are each followed by one without coordinates.
pub fn pcd(samples: &[Sample], kind: Pcd) -> Vec<u8> {
    let (encoding, count) = match kind {
        Pcd::Ascii => ("ascii", 2 * samples.len()),
        Pcd::Binary => ("binary", 2 * samples.len()),
        Pcd::Compressed => ("binary_compressed", 2 * samples.len()),
    };
    let padding = if kind == Pcd::Binary { ["_ ", "1 ", "U ", "3 "] } else { [""; 4] };
    let [name, size, scalar, more] = padding;
    let mut file = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z {name}rgb label\n\
         SIZE 4 4 4 {size}4 2\nTYPE F F F {scalar}F I\nCOUNT 1 1 1 {more}1 1\nWIDTH {count}\n\
         HEIGHT 1\nVIEWPOINT 1 2 3 0 1 0 0\nPOINTS {count}\nDATA {encoding}\n"
    )
    .into_bytes();
    let packed = |[r, g, b]: [u8; 3]| f32::from_le_bytes([b, g, r, 0]);
    let rows = samples.iter().flat_map(|s| {
        let empty = Sample { position: [f32::NAN; 3], color: [0; 3], label: 0 };
        [*s, empty]
    });
    if kind == Pcd::Ascii {
        for s in rows {
            let [x, y, z] = s.position;
            file.extend(format!("{x} {y} {z:e} {:e} {}\n", packed(s.color), s.label).bytes());
        }
        return file;
    }
    let mut columns: [Vec<u8>; 6] = Default::default();
    for s in rows {
        let mut row: Vec<Vec<u8>> = s.position.iter().map(|v| v.to_le_bytes().to_vec()).collect();
        row.push(if kind == Pcd::Binary { vec![9; 3] } else { Vec::new() });
        row.push(packed(s.color).to_le_bytes().to_vec());
        row.push(s.label.to_le_bytes().to_vec());
        for (column, value) in columns.iter_mut().zip(row) {
            if kind == Pcd::Binary {
                file.extend(value);
            } else {
                column.extend(value);
            }
        }
    }
    if kind == Pcd::Compressed {
        let plain = columns.concat();
        let compressed = lzf(&plain);
        file.extend((compressed.len() as u32).to_le_bytes());
        file.extend((plain.len() as u32).to_le_bytes());
        file.extend(compressed);
    }
    file
}

/// LZF with literals, short and long references: the last place of each three bytes is remembered.
pub fn lzf(plain: &[u8]) -> Vec<u8> {
    let (mut out, mut literals) = (Vec::new(), Vec::new());
    let mut seen: BTreeMap<[u8; 3], usize> = BTreeMap::new();
    let flush = |literals: &mut Vec<u8>, out: &mut Vec<u8>| {
        for run in literals.chunks(32) {
            out.push(run.len() as u8 - 1);
            out.extend(run);
        }
        literals.clear();
    };
    let mut at = 0;
    while at < plain.len() {
        let key = plain.get(at..at + 3).map(|three| [three[0], three[1], three[2]]);
        let from = key.and_then(|key| seen.insert(key, at)).filter(|from| at - from <= 8192);
        let Some(from) = from else {
            literals.push(plain[at]);
            at += 1;
            continue;
        };
        let longest = (plain.len() - at).min(264);
        let length = (0..longest).take_while(|i| plain[from + i] == plain[at + i]).count();
        flush(&mut literals, &mut out);
        let (code, distance) = (length - 2, at - from - 1);
        if code < 7 {
            out.push((code << 5 | distance >> 8) as u8);
        } else {
            out.push((7 << 5 | distance >> 8) as u8);
            out.push((code - 7) as u8);
        }
        out.push(distance as u8);
        at += length;
    }
    flush(&mut literals, &mut out);
    out
}

/// How a scan of an E57 file writes its coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum E57 {
    Single,
    Double,
    /// Steps of 0.001 from 10.
    Scaled,
    Spherical,
}

/// A scan of an E57 file: its points, their coding, its pose (w, x, y, z; translation).
pub struct E57Scan<'a> {
    pub points: &'a [[f64; 3]],
    pub coding: E57,
    pub pose: Option<([f64; 4], [f64; 3])>,
}

/// An E57 file. Points have a colour, an intensity, a row index of 13 bits, a constant column
/// index, and a mark by which every fifth is invalid.
pub fn e57(scans: &[E57Scan]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    {
        let mut writer = E57Writer::new(&mut file, "file").unwrap();
        for (index, scan) in scans.iter().enumerate() {
            let prototype = prototype(scan.coding);
            let mut cloud = writer.add_pointcloud(&format!("scan {index}"), prototype).unwrap();
            cloud.set_name(Some(format!("station {index}")));
            cloud.set_transform(scan.pose.map(|([w, x, y, z], [tx, ty, tz])| Transform {
                rotation: Quaternion { w, x, y, z },
                translation: Translation { x: tx, y: ty, z: tz },
            }));
            for (i, point) in scan.points.iter().enumerate() {
                let mut values: Vec<RecordValue> = point
                    .iter()
                    .map(|&value| match scan.coding {
                        E57::Single | E57::Spherical => RecordValue::Single(value as f32),
                        E57::Double => RecordValue::Double(value),
                        E57::Scaled => {
                            RecordValue::ScaledInteger(((value - 10.0) / 0.001).round() as i64)
                        }
                    })
                    .collect();
                let integers = [i % 256, i % 251, i % 241, i % 8192, 7];
                values.extend(integers.map(|value| RecordValue::Integer(value as i64)));
                values.push(RecordValue::Single(i as f32 * 0.5));
                values.push(RecordValue::Integer(if i % 5 == 4 { 2 } else { 0 }));
                cloud.add_point(values).unwrap();
            }
            cloud.finalize().unwrap();
        }
        writer.finalize().unwrap();
    }
    file.into_inner()
}

fn prototype(coding: E57) -> Vec<Record> {
    use RecordName::*;
    let scaled = RecordDataType::ScaledInteger {
        min: -1_000_000,
        max: 1_000_000,
        scale: 0.001,
        offset: 10.0,
    };
    let data_type = match coding {
        E57::Single | E57::Spherical => RecordDataType::F32,
        E57::Double => RecordDataType::F64,
        E57::Scaled => scaled,
    };
    let (axes, state) = match coding {
        E57::Spherical => {
            ([SphericalRange, SphericalAzimuth, SphericalElevation], SphericalInvalidState)
        }
        _ => ([CartesianX, CartesianY, CartesianZ], CartesianInvalidState),
    };
    let integer = |max| RecordDataType::Integer { min: 0, max };
    let mut records: Vec<Record> =
        axes.into_iter().map(|name| Record { name, data_type: data_type.clone() }).collect();
    let more = [
        (ColorRed, integer(255)),
        (ColorGreen, integer(255)),
        (ColorBlue, integer(255)),
        (RowIndex, integer(8191)),
        (ColumnIndex, RecordDataType::Integer { min: 7, max: 7 }),
        (Intensity, RecordDataType::F32),
        (state, integer(2)),
    ];
    records.extend(more.into_iter().map(|(name, data_type)| Record { name, data_type }));
    records
}

/// Corrects the checksums of all pages after bytes were changed.
pub fn with_checksums(mut file: Vec<u8>) -> Vec<u8> {
    for page in file.chunks_exact_mut(1024) {
        let checksum = crc32c::crc32c(&page[..1020]);
        page[1020..].copy_from_slice(&checksum.to_be_bytes());
    }
    file
}

/// Writes bytes under a name.
pub fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// A point as its scan hands it out: exact position, and columns as numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    pub position: [f64; 3],
    pub columns: BTreeMap<String, Vec<f64>>,
}

/// The points in records of a schema on a lattice.
pub fn points_of(records: &[u8], schema: &Schema, world: impl Fn(I64Vec3) -> DVec3) -> Vec<Point> {
    let point = |record: &[u8]| {
        let on_lattice = world(record_coordinates(record).map(i64::from).into());
        let residual = schema.find(names::COORDINATE_RESIDUAL);
        let position = residual.map_or(on_lattice, |(_, attribute)| {
            let bytes = &record[attribute.record_offset as usize..];
            exact_position(attribute.scalar, on_lattice, bytes)
        });
        let columns = schema.attributes.iter().map(|attribute| {
            let at = attribute.record_offset as usize;
            let values = record[at..at + attribute.bytes()].chunks_exact(attribute.scalar.bytes());
            (attribute.name.clone(), values.map(|value| attribute.scalar.read(value)).collect())
        });
        Point { position: position.to_array(), columns: columns.collect() }
    };
    records.chunks_exact(schema.record_bytes as usize).map(point).collect()
}

/// Opens a file of any format.
pub fn open(path: &Path) -> Result<Scan, ScanError> {
    Scan::open(path, &ReadOptions::default())
}

/// All points of a scan, in the order of the file.
pub fn read(scan: &Scan) -> Result<Vec<Point>, ScanError> {
    let mut points = Vec::new();
    let mut buffer = BlockBuffer::default();
    for block in scan.blocks() {
        scan.read_block(block, &mut buffer, &mut |_, records| {
            points.extend(points_of(records, scan.schema(), |steps| scan.lattice().world(steps)));
            Ok::<(), ScanError>(())
        })?;
    }
    assert_eq!(points.len() as u64, scan.points());
    Ok(points)
}
