//! Protects what models become: the same cube from every format, in its place to the last digit of
//! f64, instances as objects, colours and textures; and that files which lie, end early or hold
//! nonsense give what can be drawn, a line for what cannot, and never a panic or a large
//! allocation.

#[path = "support/models.rs"]
mod models;

use std::path::Path;

use esker::input::{
    ModelFormat, ModelOptions, ModelReport, ReadModel, UpAxis, detect_model, read_model,
};
use glam::{DVec3, dvec3};
use models::{CORNERS, FACES, PlyKind, write};

fn read(path: &Path) -> ReadModel {
    read_model(path, &ModelOptions::default()).expect("the model reads")
}

fn lines(report: &ModelReport) -> String {
    report.lines().join("\n")
}

/// World corners of all triangles of all objects.
fn corners(read: &ReadModel) -> Vec<DVec3> {
    let model = &read.model;
    let of_object = |object: &esker::mesh::Object| {
        let mesh = model.mesh(object);
        let place = object.world_from_mesh;
        let all = (0..mesh.triangles.len()).flat_map(|triangle| mesh.corners(triangle));
        all.map(|corner| place.transform_point3(corner)).collect::<Vec<_>>()
    };
    model.objects.iter().flat_map(of_object).collect()
}

/// The cube's corners, triangle by triangle, where a file has them.
fn cube(at: DVec3) -> Vec<DVec3> {
    let corner = |v: u32| DVec3::from(CORNERS[v as usize]) + at;
    models::triangles().into_iter().flatten().map(corner).collect()
}

fn assert_near(found: &[DVec3], expected: &[DVec3]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((*found - *expected).length() < 1e-6, "{found} for {expected}");
    }
}

#[test]
fn the_same_cube_from_every_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str, bytes: &[u8]| write(folder.path(), name, bytes);
    let here = [0.0; 3];
    let files = [
        (at("a.gltf", models::gltf(r#"{"mesh": 0}"#).as_bytes()), ModelFormat::Gltf),
        (at("a.glb", &models::glb(r#"{"mesh": 0}"#)), ModelFormat::Glb),
        (at("a.obj", models::obj(here).as_bytes()), ModelFormat::Obj),
        (at("ascii.ply", &models::ply(PlyKind::Ascii, here)), ModelFormat::Ply),
        (at("little.ply", &models::ply(PlyKind::Little, here)), ModelFormat::Ply),
        (at("big.ply", &models::ply(PlyKind::Big, here)), ModelFormat::Ply),
        (at("binary.stl", &models::stl_binary()), ModelFormat::Stl),
        (at("text.stl", models::stl_text().as_bytes()), ModelFormat::Stl),
    ];
    let options = ModelOptions { up: Some(UpAxis::Z), offset: DVec3::ZERO };
    for (path, format) in files {
        assert_eq!(detect_model(&path), Some(format), "{}", path.display());
        let read = read_model(&path, &options).expect("the model reads");
        assert_eq!(read.report, ModelReport::default(), "{}", path.display());
        assert_near(&corners(&read), &cube(DVec3::ZERO));
        assert!(read.model.meshes[0].positions.len() == 8, "corners are shared");
    }
}

#[test]
fn a_quarter_turn_brings_y_up_to_z_and_the_offset_moves() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(folder.path(), "a.gltf", models::gltf(r#"{"mesh": 0}"#));
    let turned = |corner: &DVec3| dvec3(corner.x, -corner.z, corner.y);
    let expected: Vec<_> = cube(DVec3::ZERO).iter().map(turned).collect();
    assert_near(&corners(&read(&path)), &expected);
    let path = write(folder.path(), "a.obj", models::obj([0.0; 3]));
    let offset = dvec3(4.5e5, 5.2e6, 300.0);
    let options = ModelOptions { up: Some(UpAxis::Y), offset };
    let moved: Vec<_> = expected.iter().map(|corner| *corner + offset).collect();
    assert_near(&corners(&read_model(&path, &options).expect("it reads")), &moved);
}

#[test]
fn georeferenced_coordinates_keep_their_digits() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = dvec3(10_000_000.125, 5_203_417.875, 310.5);
    let obj = write(folder.path(), "utm.obj", models::obj(at.to_array()));
    let ply = write(folder.path(), "utm.ply", models::ply(PlyKind::Little, at.to_array()));
    for path in [obj, ply] {
        let read = read(&path);
        assert_near(&corners(&read), &cube(at));
        let largest =
            read.model.meshes[0].positions.iter().flatten().fold(0f32, |a, b| a.max(b.abs()));
        assert!(largest <= 1.0, "f32 holds what is near its origin: {largest}");
    }
    // The translation of a node is f64 as well.
    let node = r#"{"mesh": 0, "translation": [10000000.125, 310.5, -5203417.875]}"#;
    let read = read(&write(folder.path(), "utm.gltf", models::gltf(node)));
    let place = read.model.objects[0].world_from_mesh.translation;
    assert!((place - at).length() < 1e-9, "{place}");
}

#[test]
fn nodes_that_name_one_mesh_share_its_shape() {
    let folder = tempfile::tempdir().expect("a folder");
    let nodes = r#"{"children": [1, 2, 3], "translation": [10, 0, 0]},
        {"mesh": 0}, {"mesh": 0, "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,-5,1]}"#;
    for path in [
        write(folder.path(), "a.gltf", models::gltf(nodes)),
        write(folder.path(), "a.glb", models::glb(nodes)),
    ] {
        let read = read(&path);
        assert_eq!((read.model.meshes.len(), read.model.objects.len()), (1, 3));
        assert_eq!(read.model.triangle_count(), 36);
        let places: Vec<_> =
            read.model.objects.iter().map(|o| o.world_from_mesh.translation).collect();
        assert_eq!(places, [dvec3(10.0, 0.0, 0.0), dvec3(10.0, 0.0, 0.0), dvec3(10.0, 5.0, 0.0)]);
        // Half of the light is 188 of 255 in sRGB.
        assert_eq!(read.model.materials[0].color, [255, 188, 0, 255]);
    }
}

#[test]
fn buffers_and_textures_beside_the_document() {
    let folder = tempfile::tempdir().expect("a folder");
    write(folder.path(), "the buffer.bin", models::gltf_buffer());
    write(folder.path(), "a.png", models::png());
    let text = models::gltf_document(r#"{"mesh": 0}"#, r#", "uri": "the%20buffer.bin""#);
    let with = text
        .replace(r#""baseColorFactor": [1, 0.5, 0, 1]"#, r#""baseColorTexture": {"index": 0}"#)
        .replace(
            r#""materials""#,
            r#""textures": [{"source": 0}], "images": [{"uri": "a.png"}], "materials""#,
        );
    let found = read(&write(folder.path(), "a.gltf", &with));
    assert_eq!(found.report, ModelReport::default());
    let texture = found.model.materials[0].texture.expect("a texture");
    let texture = &found.model.textures[texture.index()];
    assert_eq!((texture.width, texture.height), (2, 2));
    assert_eq!(texture.pixels[2], [0, 0, 255, 255]);
    for (what, broken) in [
        ("no such file", with.replace("a.png", "b.png")),
        ("no such image", with.replace(r#""source": 0"#, r#""source": 3"#)),
        ("no picture", with.replace("a.png", "the%20buffer.bin")),
    ] {
        let found = read(&write(folder.path(), "b.gltf", broken));
        assert_eq!(found.report.missing_textures, 1, "{what}");
        assert_eq!(found.model.triangle_count(), 12, "{what}");
    }
}

#[test]
fn obj_materials_groups_and_textures() {
    let folder = tempfile::tempdir().expect("a folder");
    write(folder.path(), "the texture.png", models::png());
    write(
        folder.path(),
        "m.mtl",
        "newmtl plain\nKd 1 0 0\nnewmtl pictured\nKd 0 0 0\nmap_Kd -s 1 1 1 the texture.png\n\
         newmtl lost\nKd 0 1 0\nmap_Kd none.png\n",
    );
    let text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n\
                usemtl plain\nf 1//1 2//1 3//1\nusemtl pictured\nf 1/1 2/2 \\\n3/3\no other\n\
                usemtl lost\nf -4 -2 -1\nusemtl nowhere\nf 1 2 4\nl 1 2\n";
    let found = read(&write(folder.path(), "a.obj", text));
    let model = &found.model;
    assert_eq!(model.objects.len(), 4);
    let material = |object: usize| &model.materials[model.objects[object].material.index()];
    assert_eq!((material(0).color, material(0).texture), ([255, 0, 0, 255], None));
    assert_eq!(material(1).color, [255; 4], "black below a texture means the texture");
    assert!(material(1).texture.is_some() && material(2).texture.is_none());
    assert_eq!(model.mesh(&model.objects[0]).normals, [[0.0, 0.0, 1.0]; 3]);
    let uvs = &model.mesh(&model.objects[1]).uvs;
    assert_eq!(uvs[..], [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]], "rows from the top");
    let report = &found.report;
    let counts = (report.missing_textures, report.missing_materials, report.no_triangles);
    assert_eq!(counts, (1, 1, 1), "{}", lines(report));
    assert!(lines(report).contains("none.png"));
}

#[test]
fn colours_of_vertices() {
    let folder = tempfile::tempdir().expect("a folder");
    let found = read(&write(folder.path(), "a.ply", models::ply(PlyKind::Big, [0.0; 3])));
    // Vertices stand in the order in which triangles name them.
    let first = FACES[0][1];
    assert_eq!(found.model.meshes[0].colors[1], [10 * first as u8, 200, 7, 255]);
    let text = "v 0 0 0 1 0.5 0\nv 1 0 0 0 0 0\nv 0 1 0\nf 1 2 3\n";
    let found = read(&write(folder.path(), "a.obj", text));
    assert_eq!(found.model.meshes[0].colors, [[255, 128, 0, 255], [0, 0, 0, 255], [255; 4]]);
}

#[test]
fn a_ply_without_faces_is_a_scan() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = String::from_utf8(models::ply(PlyKind::Ascii, [0.0; 3])).expect("text");
    let path = write(folder.path(), "a.ply", text.replace("element face 6", "element face 0"));
    assert_eq!(detect_model(&path), None);
    let path = write(folder.path(), "b.ply", text.replace("vertex_indices", "neighbours"));
    assert_eq!(detect_model(&path), None);
}

#[test]
fn bad_triangles_are_counted_and_the_rest_is_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = models::obj([0.0; 3])
        + "v nan 0 0\nv 1 x 1\nf 1 2 9\nf 1 2 10\nf 1 2 77\nf 1 1 2\nf 1 4 3 2\nf 1 2\nf a b c\nf 0 1 2\n";
    let found = read(&write(folder.path(), "a.obj", text));
    let report = &found.report;
    assert_eq!((report.not_finite, report.out_of_range), (2, 2), "{}", lines(report));
    assert_eq!((report.zero_area, report.duplicate, report.damaged), (1, 2, 2));
    assert_eq!(found.model.triangle_count(), 12);
    assert_eq!(report.lines().len(), 5, "a line each");
}

#[test]
fn nodes_that_hold_themselves_end() {
    let folder = tempfile::tempdir().expect("a folder");
    for nodes in [
        r#"{"children": [1]}, {"mesh": 0, "children": [0, 1]}"#,
        r#"{"mesh": 0, "children": [0]}"#,
        r#"{"children": [1, 1, 1], "mesh": 0}, {"children": [0]}"#,
    ] {
        let found = read(&write(folder.path(), "a.gltf", models::gltf(nodes)));
        assert!(found.report.cyclic_nodes > 0, "{nodes}");
        assert_eq!(found.model.objects.len(), 1, "{nodes}");
    }
    let nodes = r#"{"mesh": 0, "children": [7]}, {"mesh": 4}"#;
    let found = read(&write(folder.path(), "a.gltf", models::gltf(nodes)));
    assert_eq!(found.report.unreadable, 1, "{}", lines(&found.report));
    // A chain of nodes as deep as a file may have it.
    let deep: Vec<_> = (1..30_000).map(|i| format!(r#"{{"children": [{i}]}}"#)).collect();
    let nodes = deep.join(",") + r#", {"mesh": 0}"#;
    assert_eq!(read(&write(folder.path(), "a.gltf", models::gltf(&nodes))).model.objects.len(), 1);
}

#[test]
fn headers_that_claim_a_hundred_million_allocate_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut stl = models::stl_binary();
    stl[80..84].copy_from_slice(&100_000_000u32.to_le_bytes());
    let found = read(&write(folder.path(), "a.stl", &stl));
    assert_eq!(found.model.triangle_count(), 12);
    assert!(lines(&found.report).contains("claims 100000000"), "{}", lines(&found.report));
    for kind in [PlyKind::Ascii, PlyKind::Little] {
        let ply = models::ply(kind, [0.0; 3]);
        let at = ply.windows(14).position(|w| w == b"element face 6").expect("it is there");
        let claimed = [&ply[..at], b"element face 100000000", &ply[at + 14..]].concat();
        let found = read(&write(folder.path(), "a.ply", &claimed));
        assert_eq!(found.model.triangle_count(), 12);
        assert!(lines(&found.report).contains("row 7 of 100000000"), "{}", lines(&found.report));
    }
    let nodes = r#"{"mesh": 0}"#;
    for (old, new) in [
        (r#""count": 36"#, r#""count": 300000000"#),
        (r#""count": 36"#, r#""count": 18446744073709551615"#),
        (r#""count": 8"#, r#""count": 100000000"#),
        (r#""bufferView": 0, "#, ""),
        (r#""byteLength": 72"#, r#""byteLength": 720000000"#),
        (r#""byteOffset": 96"#, r#""byteOffset": 18446744073709551600"#),
        (r#""bufferView": 0, "#, r#""bufferView": 90, "#),
    ] {
        let path = write(folder.path(), "a.gltf", models::gltf(nodes).replace(old, new));
        let error = read_model(&path, &ModelOptions::default()).expect_err("nothing to draw");
        assert!(error.to_string().contains("no triangle to draw"), "{error}");
    }
    // Zeros that no byte stands for.
    let sparse = r#""sparse": {"count": 1, "indices": {"bufferView": 1, "componentType": 5123},
        "values": {"bufferView": 0}}, "count": 2000000000"#;
    let text = models::gltf(nodes).replace(r#""bufferView": 0, "#, "");
    let path = write(folder.path(), "a.gltf", text.replace(r#""count": 8"#, sparse));
    assert!(read_model(&path, &ModelOptions::default()).is_err());
}

#[test]
fn sparse_rows_replace_others() {
    let folder = tempfile::tempdir().expect("a folder");
    // Index 3 of the buffer's indices stands first: it names vertex 3 (0, 3, 2, ...).
    let sparse = r#""sparse": {"count": 1, "indices": {"bufferView": 1, "byteOffset": 2,
        "componentType": 5123}, "values": {"bufferView": 0, "byteOffset": 72}}, "count": 8"#;
    let text = models::gltf(r#"{"mesh": 0}"#).replace(r#""count": 8"#, sparse);
    let options = ModelOptions { up: Some(UpAxis::Z), offset: DVec3::ZERO };
    let path = write(folder.path(), "a.gltf", text);
    let found = read_model(&path, &options).expect("it reads");
    let at = corners(&found)[1];
    assert_eq!(at, DVec3::from(CORNERS[6]), "vertex 3 moved to where vertex 6 is");
}

/// Every cut and many flips of every small file: an error or a model, both at once.
#[test]
fn damaged_files_never_panic() {
    let folder = tempfile::tempdir().expect("a folder");
    let nodes = r#"{"mesh": 0}"#;
    let files: [(&str, Vec<u8>); 6] = [
        ("a.gltf", models::gltf(nodes).into_bytes()),
        ("a.glb", models::glb(nodes)),
        ("a.obj", models::obj([0.5; 3]).into_bytes()),
        ("a.ply", models::ply(PlyKind::Little, [0.0; 3])),
        ("b.ply", models::ply(PlyKind::Ascii, [0.0; 3])),
        ("a.stl", models::stl_binary()),
    ];
    let (mut read_count, mut refused) = (0, 0);
    let mut random = 0x9e37_79b9_7f4a_7c15u64;
    for (name, bytes) in &files {
        let mut attempt = |bytes: &[u8]| {
            let path = write(folder.path(), name, bytes);
            match read_model(&path, &ModelOptions::default()) {
                Ok(found) => {
                    assert_eq!(found.model.check(), Ok(()));
                    assert!(!found.model.is_empty());
                    read_count += 1;
                }
                Err(error) => {
                    assert!(!error.to_string().contains('\n'), "{error}");
                    refused += 1;
                }
            }
        };
        for cut in (0..bytes.len()).step_by(13) {
            attempt(&bytes[..cut]);
        }
        for _ in 0..150 {
            let mut flipped = bytes.clone();
            for _ in 0..3 {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let at = (random >> 33) as usize % flipped.len();
                flipped[at] ^= 1 << (random >> 60 & 7);
            }
            attempt(&flipped);
        }
    }
    assert!(read_count > 100 && refused > 100, "{read_count} read, {refused} refused");
}

#[test]
fn files_that_are_no_models_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in [
        ("a.gltf", &b"{\"nodes\": 3}"[..]),
        ("a.glb", b"glTF\x01\0\0\0"),
        ("b.glb", b"nothing"),
        ("a.obj", b"# empty\n"),
        ("a.stl", b"solid\nendsolid\n"),
        ("b.stl", b"short"),
        ("a.txt", b"1 2 3\n"),
        ("c.obj", b""),
    ] {
        let path = write(folder.path(), name, bytes);
        let error = read_model(&path, &ModelOptions::default()).expect_err("no model");
        let text = error.to_string();
        assert!(text.contains(name) && text.len() < 300, "{text}");
    }
}

#[test]
fn reading_ends_when_nobody_wants_the_model() {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    for name in [
        "gltf/cube.gltf",
        "gltf/cube.glb",
        "obj/cube.obj",
        "stl/text.stl",
        "stl/binary.stl",
        "faces/text.ply",
        "faces/binary_little_endian.ply",
    ] {
        let path = folder.join(name);
        let read = |cancelled: bool| {
            let cancelled = Arc::new(AtomicBool::new(cancelled));
            esker::input::read_model_until(&path, &ModelOptions::default(), &cancelled)
        };
        assert!(read(false).is_ok_and(|read| read.model.triangle_count() >= 12), "{name}");
        let error = read(true).expect_err("it was cancelled").to_string();
        assert!(error.contains("cancelled"), "{error}");
    }
}
