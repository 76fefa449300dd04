//! Protects what `esker render` and `esker info` do with models: one picture of models, stores and
//! scans, framed together; facts and faults in words and as JSON; one line for what is no model.

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/models.rs"]
mod models;

use std::path::Path;
use std::process::{Command, Output};

use las_file::{LasPoint, write_las};
use models::write;
use serde_json::Value;

fn esker(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

fn done(output: &Output) -> String {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    message.into_owned()
}

fn stats(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("s.json")).expect("statistics");
    serde_json::from_str(&text).expect("JSON")
}

fn red_and_all(path: &Path) -> (usize, usize) {
    let picture = image::open(path).expect("a picture").into_rgba8();
    let red = picture.pixels().filter(|p| p[0] > 60 && p[1] < 5 && p[2] < 5).count();
    (red, picture.pixels().len())
}

#[test]
fn models_and_scans_are_in_one_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    // A floor of points, 2 m by 2 m, below a red cube; both far from the origin.
    let points: Vec<_> = (0..40_000)
        .map(|i| LasPoint {
            position: [i % 200 * 10, i / 200 * 10, 0],
            color: [0, 65_535, 0],
            intensity: 1,
        })
        .collect();
    write_las(&path.join("floor.las"), &points);
    let info = esker(path, &["info", "--json", "floor.las"]);
    let facts: Value = serde_json::from_slice(&info.stdout).expect("JSON");
    let min: Vec<f64> = facts["header_bounds"]["min"]
        .as_array()
        .expect("bounds")
        .iter()
        .filter_map(Value::as_f64)
        .collect();
    write(path, "m.mtl", "newmtl red\nKd 1 0 0\n");
    let text = "mtllib m.mtl\nusemtl red\n".to_string() + &models::obj([0.5, 0.5, 0.0]);
    write(path, "cube.obj", text);
    let offset = format!("--mesh-offset={},{},{}", min[0], min[1], min[2] + 0.01);
    let arguments = ["cube.obj", "floor.las", &offset, "--size", "200x160", "--stats", "s.json"];
    let mut seen = Vec::new();
    for renderer in ["cpu", "auto"] {
        let options = ["render", "--renderer", renderer, "-o", "a.png", "--view", "top"];
        done(&esker(path, &[&options[..], &arguments[..]].concat()));
        let stats = stats(path);
        assert_eq!((&stats["triangles_drawn"], &stats["objects_drawn"]), (&12.into(), &1.into()));
        assert_eq!(stats["points_drawn"], 40_000);
        let (red, all) = red_and_all(&path.join("a.png"));
        // The cube covers about a quarter of the floor, which about fills the height.
        assert!(red > all / 20 && red < all / 3, "{renderer}: {red} of {all}");
        seen.push(red);
    }
    assert_eq!(seen[0], seen[1]);
    // The floor has moved away from the cube: presets frame both, so both are small.
    let far = ["render", "--renderer", "cpu", "-o", "b.png", "--view", "top", "cube.obj"];
    done(&esker(
        path,
        &[&far[..], &["floor.las", "--mesh-offset=0,0,0", "--size", "200x160"]].concat(),
    ));
    let (red, _) = red_and_all(&path.join("b.png"));
    assert!(red < 4, "{red}");
}

#[test]
fn a_model_alone_and_what_is_wrong_with_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    write(path, "m.mtl", "newmtl red\nKd 1 0 0\nmap_Kd none.png\n");
    let text = "mtllib m.mtl\nusemtl red\n".to_string() + &models::obj([0.0; 3]) + "f 1 2 99\n";
    write(path, "cube.obj", text);
    let message = done(&esker(path, &["render", "cube.obj", "-o", "a.png", "--renderer", "cpu"]));
    let lines: Vec<_> = message.lines().filter(|line| line.starts_with("esker:")).collect();
    assert!(lines.iter().any(|line| line.contains("1 triangle(s) left out")), "{message}");
    assert!(lines.iter().any(|line| line.contains("none.png")), "{message}");
    assert!(red_and_all(&path.join("a.png")).0 > 1000);
    let output = esker(path, &["info", "--json", "cube.obj", "--up", "y"]);
    let facts: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&facts["format"], &facts["triangles"]), (&"obj".into(), &12.into()));
    let low: Vec<f64> = serde_json::from_value(facts["bounds"]["min"].clone()).expect("numbers");
    let expected = [0.0, -1.0, 0.0];
    assert!(low.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{low:?}");
    assert_eq!(facts["triangles_left_out"], 1);
}

#[test]
fn what_is_no_model_is_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    write(path, "a.glb", b"glTF\x01\0\0\0");
    write(path, "a.stl", "solid\nendsolid\n");
    write(path, "a.gltf", "{");
    for (file, word) in [("a.glb", "version 1"), ("a.stl", "no triangle"), ("a.gltf", "line 1")] {
        let output = esker(path, &["render", file, "-o", "a.png", "--renderer", "cpu"]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{message}");
        assert!(message.contains(word) && message.contains(file), "{message}");
        assert!(!path.join("a.png").exists());
    }
    assert_eq!(
        esker(path, &["render", "a.stl", "-o", "a.png", "--mesh-offset", "1,2"]).status.code(),
        Some(2)
    );
}

/// Made subjects with surfaces are written as a model, and as a scan of the same surfaces.
#[test]
fn made_scenes_come_as_models_and_as_scans() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    let made = ["generate", "--subject", "rooms", "--size", "2", "--origin", "1000,2000,30"];
    let with = |more: &[&str]| esker(path, &[&made[..], more].concat());
    done(&with(&["-o", "rooms.glb"]));
    done(&with(&["--points", "20k", "-o", "rooms.las"]));
    let facts = |file: &str| -> Value {
        let info = esker(path, &["info", "--json", file]);
        serde_json::from_slice(&info.stdout).expect("JSON")
    };
    let scene = esker::mesh::scenes::SceneKind::Rooms.make(2, 1);
    let model = facts("rooms.glb");
    assert_eq!(model["objects"], scene.model.objects.len());
    assert_eq!(model["triangles"], scene.model.triangle_count());
    let scan = facts("rooms.las");
    for axis in 0..3 {
        let bounds = |facts: &Value, side: &str| {
            let found = ["bounds", "header_bounds"]
                .into_iter()
                .find_map(|name| facts[name][side][axis].as_f64());
            found.expect("bounds")
        };
        assert!((bounds(&model, "min") - bounds(&scan, "min")).abs() < 0.2);
        assert!((bounds(&model, "max") - bounds(&scan, "max")).abs() < 0.2);
    }
    let again = with(&["-o", "rooms.glb"]);
    assert_eq!(again.status.code(), Some(1), "it is there already");
    let points = esker(path, &["generate", "--subject", "cube", "-o", "cube.glb"]);
    assert_eq!(points.status.code(), Some(1), "a cube of points is no model");
}

#[test]
fn folders_stand_for_their_models_and_scans() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    std::fs::create_dir_all(path.join("site/deep")).expect("folders");
    let triangle = "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n";
    write(path, "site/a.obj", triangle);
    write(path, "site/deep/b.OBJ", triangle.replace("v 0 0 0", "v 0 0 5"));
    write(path, "site/notes.md", "no model");
    let point = LasPoint { position: [1, 2, 3], color: [0, 65_535, 0], intensity: 1 };
    write_las(&path.join("site/deep/c.las"), &[point]);
    done(&esker(
        path,
        &["render", "site", "-o", "p.png", "--renderer", "cpu", "--stats", "s.json"],
    ));
    let stats = stats(path);
    assert_eq!((&stats["triangles_drawn"], &stats["points_drawn"]), (&2.into(), &1.into()));
    std::fs::remove_file(path.join("site/deep/c.las")).expect("removes");
    done(&esker(path, &["render", "site", "-o", "p.png", "--renderer", "cpu"]));
    std::fs::create_dir(path.join("empty")).expect("a folder");
    let output = esker(path, &["render", "empty", "-o", "p.png", "--renderer", "cpu"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && message.contains("no scan or model"), "{message}");
    // What converts takes scans alone.
    let output = esker(path, &["convert", "site", "-o", "s.esker"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && message.contains("no scan file"), "{message}");
}
