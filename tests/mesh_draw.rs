//! Models in the picture of the points: the four ways to draw give the same, what is nearer shows
//! whatever it is, places are exact far from the origin, and a scene without models pays nothing.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameSettings, FrameStats, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View, ViewPreset};
use esker::ids::{MaterialId, MeshId, ObjectId, TextureId};
use esker::mesh::scenes::SceneKind;
use esker::mesh::{Material, Mesh, Model, Object, Texture};
use esker::passes::{EyeDome, FinishSettings, Picture};
use esker::points::Lattice;
use glam::{DAffine3, DQuat, DVec3, UVec3, dvec3};
use memory_cloud::MemoryCloud;

const BACKGROUND: u32 = 0xff20_1c1a;

fn paths() -> Vec<RasterPath> {
    match gpu() {
        Some(_) => {
            vec![RasterPath::Cpu, RasterPath::Compute, RasterPath::Compute32, RasterPath::Raster]
        }
        None => vec![RasterPath::Cpu],
    }
}

fn renderer(path: RasterPath) -> Renderer {
    match path {
        RasterPath::Cpu => Renderer::on_cpu(1 << 28),
        path => Renderer::on_gpu(gpu().expect("asked before"), path, 1 << 28).unwrap(),
    }
}

fn draw(
    path: RasterPath,
    model: &Arc<Model>,
    cloud: Option<&Arc<MemoryCloud>>,
    view: &View,
    settings: &FrameSettings,
) -> (Picture, FrameStats) {
    let mut renderer = renderer(path);
    renderer
        .set_scene(cloud.map(|cloud| cloud.clone() as Arc<dyn NodeSource>).into_iter().collect());
    renderer.set_model(model.clone());
    let stats = renderer.render(view, settings).unwrap().clone();
    (renderer.read_picture().unwrap().expect("a frame was drawn"), stats)
}

fn framing(model: &Model, preset: ViewPreset, width_px: u32, height_px: u32) -> View {
    let aspect = f64::from(width_px) / f64::from(height_px);
    let camera = Camera::framing(&model.bounds(), preset, 1.0, aspect);
    View { camera, width_px, height_px }
}

/// Shares of pixels whose colours differ, and whose depths differ by more than 1e-4.
fn difference(a: &Picture, b: &Picture) -> (f64, f64) {
    let count = a.colors.len() as f64;
    let colors = a.colors.iter().zip(&b.colors).filter(|(a, b)| a != b).count();
    let depths = a.distances.iter().zip(&b.distances);
    let depths = depths.filter(|(a, b)| a != b && (*a / *b - 1.0).abs() >= 1e-4).count();
    (colors as f64 / count, depths as f64 / count)
}

/// The same picture but for ties at edges.
fn assert_twins(a: &Picture, b: &Picture, what: &str) {
    let (colors, depths) = difference(a, b);
    assert!(colors <= 1e-3 && depths <= 1e-3, "{what}: colours {colors}, depths {depths} differ");
}

#[test]
fn the_city_looks_the_same_from_every_path() {
    let scene = SceneKind::City.make(3, 3);
    let model = Arc::new(scene.model);
    for (preset, width_px, height_px) in
        [(ViewPreset::Iso, 640, 400), (ViewPreset::Front, 333, 201), (ViewPreset::Top, 64, 64)]
    {
        let view = framing(&model, preset, width_px, height_px);
        let settings = FrameSettings::default();
        let (expected, stats) = draw(RasterPath::Cpu, &model, None, &view, &settings);
        assert!(expected.covered() > expected.colors.len() / 10);
        assert!(stats.objects_drawn > 100);
        for path in paths().into_iter().skip(1) {
            let (found, on_device) = draw(path, &model, None, &view, &settings);
            let name = format!("{} {preset}", path.name());
            assert_twins(&expected, &found, &name);
            assert_eq!(on_device.triangles_drawn, stats.triangles_drawn);
            assert_eq!(on_device.objects_drawn, stats.objects_drawn);
        }
    }
}

fn object(mesh: u32, material: u32, world_from_mesh: DAffine3) -> Object {
    Object { mesh: MeshId(mesh), material: MaterialId(material), world_from_mesh }
}

/// A square of 2 m in the x-z plane, seen from -y, with texture coordinates over `repeat` tiles.
fn square(repeat: f32) -> Mesh {
    Mesh {
        positions: vec![[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]],
        uvs: vec![[0.0, repeat], [repeat, repeat], [repeat, 0.0], [0.0, 0.0]],
        colors: vec![[255; 4], [255, 200, 255, 255], [200, 255, 255, 255], [255; 4]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

fn of_color(color: [u8; 4]) -> Material {
    Material { color, ..Material::default() }
}

/// A checked texture with holes.
fn checked(side: u32) -> Texture {
    let texel = |i: u32| match (i % side / 4 + i / side / 4) % 3 {
        0 => [250, 30, 30, 255],
        1 => [20, 20, 240, 255],
        _ => [255, 255, 255, 20],
    };
    Texture { width: side, height: side, pixels: (0..side * side).map(texel).collect() }
}

/// A camera at the origin that looks along y.
fn ahead(width_px: u32, height_px: u32) -> View {
    let camera = Camera::looking_at(DVec3::ZERO, DVec3::Y, DVec3::Z, 1.0, 0.1);
    View { camera, width_px, height_px }
}

#[test]
fn textures_holes_and_sides_look_the_same_from_every_path() {
    let turned = |x: f64, y: f64, z: f64, turn: f64| {
        DAffine3::from_rotation_translation(DQuat::from_rotation_z(turn), dvec3(x, y, z))
    };
    let mirror = DAffine3::from_scale(dvec3(1.0, -1.0, 1.0));
    let textured = Material { texture: Some(TextureId(0)), ..of_color([255; 4]) };
    let cut_out = Material { alpha_cutoff: Some(0.5), ..textured.clone() };
    let single = Material { double_sided: false, ..textured.clone() };
    let model = Arc::new(Model {
        meshes: vec![square(1.0), square(3.5)],
        materials: vec![textured, cut_out, single],
        textures: vec![checked(64)],
        objects: vec![
            object(0, 0, turned(-1.2, 3.0, 0.6, 0.7)),
            object(1, 0, turned(1.5, 9.0, 0.0, -1.2)),
            object(1, 1, turned(0.0, 3.5, -0.7, 0.3)),
            object(0, 2, turned(0.5, 4.0, 1.0, 0.2)),
            // The backs of these face the eye: one is not there, the other turned by its placement.
            object(0, 2, turned(-2.0, 4.0, -1.2, 3.1)),
            object(0, 2, turned(2.4, 4.5, -1.0, 3.1) * mirror),
            // A floor below the eye that reaches behind it.
            object(
                1,
                0,
                DAffine3::from_translation(dvec3(0.0, 0.0, -1.0))
                    * DAffine3::from_rotation_x(-1.6)
                    * DAffine3::from_scale(DVec3::splat(30.0)),
            ),
        ],
    });
    model.check().expect("sound");
    let view = ahead(480, 320);
    let settings = FrameSettings::default();
    let (expected, _) = draw(RasterPath::Cpu, &model, None, &view, &settings);
    let only = |objects: &[usize]| {
        let objects = objects.iter().map(|&at| model.objects[at]).collect();
        let model = Arc::new(Model { objects, ..(*model).clone() });
        draw(RasterPath::Cpu, &model, None, &view, &settings).0.covered()
    };
    assert_eq!(only(&[4]), 0, "a back that is not drawn");
    assert!(only(&[5]) > 3000 && only(&[3]) > 3000, "fronts that are");
    assert!(only(&[2]) < only(&[0]) * 4 / 5, "holes");
    assert!(only(&[6]) > 480 * 320 / 3, "the floor goes on behind the eye");
    for path in paths().into_iter().skip(1) {
        let (found, _) = draw(path, &model, None, &view, &settings);
        // Blends of texels round differently by one of 255 levels here and there, no more.
        let steps = |(a, b): (&u32, &u32)| {
            let pairs = a.to_le_bytes().into_iter().zip(b.to_le_bytes());
            pairs.map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0)
        };
        let pairs = || expected.colors.iter().zip(&found.colors);
        assert_eq!(pairs().filter(|&pair| steps(pair) > 1).count(), 0, "{}", path.name());
        let (colors, depths) = difference(&expected, &found);
        assert!(colors <= 2e-3 && depths <= 1e-3, "{}: {colors} {depths}", path.name());
    }
}

/// Points on a square lattice in the plane at distance `y`, 10 mm apart and 4 m wide, at `offset`.
fn wall(y: f64, color: u32, gap: impl Fn(u32, u32) -> bool, offset: DVec3) -> Arc<MemoryCloud> {
    let lattice = Lattice { scale: DVec3::splat(0.01), offset: offset + dvec3(-2.0, y, -2.0) };
    let points: Vec<_> = (0..160_000u32)
        .map(|i| (i % 400, i / 400))
        .filter(|&(x, z)| !gap(x, z))
        .map(|(x, z)| (UVec3::new(x, 0, z), color))
        .collect();
    Arc::new(MemoryCloud::new(lattice, 10, 4, &points))
}

const GREEN: u32 = 0xff00_ff00;

#[test]
fn whatever_is_nearer_shows() {
    let model = |y: f64| {
        Arc::new(Model {
            meshes: vec![square(1.0)],
            materials: vec![of_color([255, 0, 0, 255])],
            objects: vec![object(0, 0, DAffine3::from_translation(dvec3(0.0, y, 0.0)))],
            ..Model::default()
        })
    };
    let view = ahead(200, 150);
    let settings = FrameSettings::default();
    let cloud = wall(3.0, GREEN, |_, _| false, DVec3::ZERO);
    let is_red = |color: u32| color & 0xff > 80 && color & 0xff00 == 0;
    for path in paths() {
        let name = path.name();
        let (front, stats) = draw(path, &model(2.0), Some(&cloud), &view, &settings);
        let middle = 75 * 200 + 100;
        assert!(is_red(front.colors[middle]), "{name}: the mesh hides the points");
        assert!((front.distances[middle] - 2.0).abs() < 1e-4, "{name}");
        assert_eq!(front.colors[20], GREEN, "{name}: beside it they show");
        assert_eq!((stats.objects_drawn, stats.triangles_drawn), (1, 2), "{name}");
        let (behind, _) = draw(path, &model(4.0), Some(&cloud), &view, &settings);
        assert!(behind.colors.iter().all(|&color| !is_red(color)), "{name}: hidden by points");
        assert!((behind.distances[middle] - 3.0).abs() < 1e-4, "{name}");
    }
}

#[test]
fn edges_are_shaded_and_gaps_filled_among_points_alone() {
    let model = Arc::new(Model {
        meshes: vec![square(1.0)],
        materials: vec![of_color([255, 0, 0, 255])],
        objects: vec![object(
            0,
            0,
            DAffine3::from_translation(dvec3(0.0, 2.0, 0.0))
                * DAffine3::from_scale(DVec3::splat(0.4)),
        )],
        ..Model::default()
    });
    let view = ahead(240, 200);
    // A wall with small gaps in it, behind the mesh.
    let cloud = wall(3.0, GREEN, |x, z| x % 8 == 0 && z % 8 == 0, DVec3::ZERO);
    let plain = FrameSettings::default();
    let finish = FinishSettings { gap_radius_px: 2, eye_dome: Some(EyeDome::default()) };
    let finished = FrameSettings { finish, ..plain.clone() };
    for path in paths() {
        let name = path.name();
        let (alone, _) = draw(path, &Arc::new(Model::default()), Some(&cloud), &view, &finished);
        let (before, _) = draw(path, &model, Some(&cloud), &view, &plain);
        let (after, _) = draw(path, &model, Some(&cloud), &view, &finished);
        let mut shown = 0;
        for at in 0..after.colors.len() {
            if before.distances[at] < 2.5 {
                assert_eq!(after.colors[at], before.colors[at], "{name}: a mesh stays as it is");
                shown += 1;
            } else {
                assert_eq!(after.colors[at], alone.colors[at], "{name}: and changes no point");
            }
        }
        assert!(shown > 500, "{name}");
    }
}

#[test]
fn a_point_and_a_mesh_at_one_place_share_their_pixel_ten_thousand_kilometres_away() {
    let offset = dvec3(1e7, -1e7, 4e3);
    // Small flags around single points: a point's pixel must lie in the middle of its flag.
    let cells: Vec<UVec3> = (0..40u32)
        .map(|i| UVec3::new(37 * i % 200 * 10, 500 + 11 * i, 53 * i % 190 * 10))
        .collect();
    let lattice = Lattice { scale: DVec3::splat(0.001), offset };
    let points: Vec<_> = cells.iter().map(|&cell| (cell, GREEN)).collect();
    let cloud = Arc::new(MemoryCloud::new(lattice, 11, 3, &points));
    // The same flag about its own origin, and a hundred kilometres from it.
    let half = 1.0 / 128.0;
    let away = dvec3(98_304.5, 32_768.25, 8192.125);
    let moved = |[x, y, z]: [f32; 3]| (dvec3(x.into(), y.into(), z.into()) * half + away).as_vec3();
    let near = square(1.0);
    let far = Mesh {
        positions: near.positions.iter().map(|&at| moved(at).to_array()).collect(),
        ..near.clone()
    };
    let flag = |(at, cell): (usize, &UVec3)| {
        let place = lattice.world(cell.as_i64vec3());
        match at % 2 {
            0 => object(
                0,
                0,
                DAffine3::from_translation(place) * DAffine3::from_scale(DVec3::splat(half)),
            ),
            _ => object(1, 0, DAffine3::from_translation(place - away)),
        }
    };
    let model = Arc::new(Model {
        meshes: vec![near, far],
        materials: vec![of_color([255, 0, 0, 255])],
        objects: cells.iter().enumerate().map(flag).collect(),
        ..Model::default()
    });
    for (step, path) in (0..9).flat_map(|step| paths().into_iter().map(move |path| (step, path))) {
        // The camera moves by a fraction of a millimetre from picture to picture.
        let eye = offset + dvec3(1.0 + 1.3e-4 * f64::from(step), -1.7, 0.9);
        let camera = Camera::looking_at(eye, eye + DVec3::Y, DVec3::Z, 0.8, 0.01);
        let view = View { camera, width_px: 1600, height_px: 1200 };
        let settings = FrameSettings::default();
        let (picture, _) = draw(path, &model, None, &view, &settings);
        let (dots, _) = draw(path, &Arc::new(Model::default()), Some(&cloud), &view, &settings);
        let mut compared = 0;
        for cell in &cells {
            let world = lattice.world(cell.as_i64vec3());
            let (x, y, w) = view.project(world).expect("in front");
            let half_px = half * view.focal_px() / w;
            let (x, y) = (x as i32, y as i32);
            if !(8..1592).contains(&x) || !(8..1192).contains(&y) {
                continue;
            }
            // The flag's box of pixels is where f64 puts it, within one pixel at each side.
            let is_flag = |dx: i32, dy: i32| {
                picture.distances[((y + dy) * 1600 + x + dx) as usize].is_finite()
            };
            let inside = half_px as i32 - 1;
            let outside = half_px as i32 + 2;
            assert!(is_flag(0, 0) && is_flag(inside, 0) && is_flag(0, -inside), "{step} {cell}");
            assert!(!is_flag(outside, 0) && !is_flag(0, outside), "{step} {cell}");
            let at = (y * 1600 + x) as usize;
            assert!(dots.distances[at].is_finite(), "{step} {cell}: the point is in that pixel");
            assert!((dots.distances[at] / picture.distances[at] - 1.0).abs() < 1e-4);
            compared += 1;
        }
        assert!(compared > 20, "{compared}");
    }
}

#[test]
fn instances_share_a_call_and_what_is_out_of_sight_is_left_out() {
    let many = (0..5000).map(|i| {
        let (x, z) = (f64::from(i % 100) - 50.0, f64::from(i / 100) - 25.0);
        object(i as u32 % 3, 0, DAffine3::from_translation(dvec3(x, 200.0, z)))
    });
    let behind =
        (0..1000).map(|i| object(0, 0, DAffine3::from_translation(dvec3(f64::from(i), -9.0, 0.0))));
    let model = Arc::new(Model {
        meshes: vec![square(1.0), square(2.0), square(3.0)],
        materials: vec![of_color([255, 0, 0, 255])],
        objects: many.chain(behind).collect(),
        ..Model::default()
    });
    for path in paths() {
        let (_, stats) = draw(path, &model, None, &ahead(64, 48), &FrameSettings::default());
        assert_eq!((stats.objects_drawn, stats.objects_culled), (5000, 1000));
        assert_eq!(stats.triangles_drawn, 10_000);
        assert!(stats.draw_calls <= 3, "{} calls for {}", stats.draw_calls, path.name());
    }
}

#[test]
fn an_object_that_moves_is_drawn_in_its_new_place() {
    let model = Arc::new(Model {
        meshes: vec![square(1.0)],
        materials: vec![of_color([255, 0, 0, 255])],
        objects: vec![object(0, 0, DAffine3::from_translation(dvec3(-3.0, 9.0, 0.0)))],
        ..Model::default()
    });
    let moved = DAffine3::from_translation(dvec3(3.0, 8.0, 1.0));
    let view = ahead(160, 120);
    let settings = FrameSettings::default();
    for path in paths() {
        let mut renderer = renderer(path);
        renderer.set_model(model.clone());
        renderer.render(&view, &settings).unwrap();
        assert!(renderer.render(&view, &settings).unwrap().unchanged);
        renderer.place_object(ObjectId(0), moved);
        renderer.place_object(ObjectId(9), moved);
        assert!(!renderer.render(&view, &settings).unwrap().unchanged);
        let found = renderer.read_picture().unwrap().expect("drawn");
        let mut placed = (*model).clone();
        placed.objects[0].world_from_mesh = moved;
        let (expected, _) = draw(path, &Arc::new(placed), None, &view, &settings);
        assert_eq!(found, expected, "{}", path.name());
        assert_eq!(renderer.bounds().min.x, expected_min(&moved));
    }
}

/// Left end of the square's box.
fn expected_min(place: &DAffine3) -> f64 {
    let mut model = Model { meshes: vec![square(1.0)], ..Model::default() };
    model.materials.push(Material::default());
    model.objects.push(object(0, 0, *place));
    model.bounds().min.x
}

#[test]
fn a_picture_in_parts_is_the_whole_one() {
    let scene = SceneKind::City.make(2, 5);
    let model = Arc::new(scene.model);
    let view = framing(&model, ViewPreset::Iso, 300, 200);
    let finish = FinishSettings { gap_radius_px: 2, eye_dome: Some(EyeDome::default()) };
    let settings = FrameSettings { finish, ..FrameSettings::default() };
    for path in paths() {
        let (whole, _) = draw(path, &model, None, &view, &settings);
        let mut renderer = renderer(path);
        renderer.set_model(model.clone());
        let again = renderer.render_picture(&view, &settings).unwrap();
        assert_eq!(whole.colors, again.colors, "{}", path.name());
    }
}

#[test]
fn without_models_nothing_is_drawn_counted_or_held() {
    let cloud = wall(3.0, GREEN, |_, _| false, DVec3::ZERO);
    let view = ahead(100, 80);
    let settings = FrameSettings::default();
    for path in paths() {
        let mut plain = renderer(path);
        plain.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
        let stats = plain.render(&view, &settings).unwrap().clone();
        assert_eq!((stats.objects_drawn, stats.objects_culled, stats.triangles_drawn), (0, 0, 0));
        assert!(stats.passes.iter().all(|time| time.pass != "meshes"));
        assert_eq!(plain.mesh_bytes(), 0);
        // With a model that is taken away again: the same calls, and its memory is given back.
        let model = Arc::new(SceneKind::Boxes.make(50, 1).model);
        let mut other = renderer(path);
        other.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
        other.set_model(model);
        other.render(&view, &settings).unwrap();
        if path != RasterPath::Cpu {
            assert!(other.mesh_bytes() > 0);
        }
        other.set_model(Arc::new(Model::default()));
        let after = other.render(&view, &settings).unwrap().clone();
        let calls = |stats: &FrameStats| (stats.draw_calls, stats.dispatches);
        assert_eq!((calls(&after), other.mesh_bytes()), (calls(&stats), 0), "{}", path.name());
        let picture = other.read_picture().unwrap().expect("drawn");
        assert_eq!(picture, plain.read_picture().unwrap().expect("drawn"));
        assert!(picture.colors.contains(&GREEN) && !picture.colors.contains(&0));
        assert_eq!(settings.background, BACKGROUND);
    }
}

/// A recording of lists as culling makes them: some objects in one order, the rest later, depth
/// first or with colour, in several passes over one depth buffer.
#[test]
fn lists_recorded_in_any_order_give_the_picture_of_one_recording() {
    use esker::gpu::Gpu;
    use esker::passes::{
        DrawOrder, MeshColor, MeshCounts, MeshList, MeshOutput, Meshes, Targets, Tile,
    };
    use esker::select::SplatSettings;

    let Some(gpu) = gpu() else { return };
    let model = SceneKind::Pipes.make(6, 2).model;
    let view = framing(&model, ViewPreset::Iso, 320, 240);
    let frame = Tile::whole(&view).gpu_frame(&view, &SplatSettings::default(), BACKGROUND);
    let all: Vec<ObjectId> = model.object_ids().collect();
    let backwards: Vec<ObjectId> = all.iter().rev().copied().collect();
    type Step<'a> = (&'a MeshList, std::ops::Range<usize>, MeshOutput);
    let picture = |gpu: &Gpu, meshes: &mut Meshes, steps: &[Step]| {
        let targets = Targets::new(gpu, 320, 240).unwrap();
        let mut counts = MeshCounts::default();
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        targets.clear(&mut encoder, BACKGROUND);
        for (list, range, output) in steps {
            let (color, depth) = targets.cleared(BACKGROUND);
            let load = wgpu::LoadOp::Load;
            let color = wgpu::RenderPassColorAttachment {
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                ..color
            };
            let depth = depth.map(|depth| wgpu::RenderPassDepthStencilAttachment {
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Load,
                    store: wgpu::StoreOp::Store,
                }),
                ..depth
            });
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                color_attachments: &[(output.color != MeshColor::Absent).then_some(color)]
                    [..usize::from(output.color != MeshColor::Absent)],
                depth_stencil_attachment: depth,
                ..Default::default()
            });
            counts += meshes.record_part(gpu, &mut pass, list, range.clone(), *output).unwrap();
        }
        gpu.queue().submit([encoder.finish()]);
        (
            targets.read_colors(gpu).unwrap(),
            targets.read_distances(gpu, frame.near).unwrap(),
            counts,
        )
    };
    let mut meshes = Meshes::new(&gpu, &model).unwrap();
    meshes.begin(&gpu, &view, &frame).unwrap();
    let grouped = meshes.list(&gpu, &all, DrawOrder::Grouped).unwrap();
    let one = picture(&gpu, &mut meshes, &[(&grouped, 0..grouped.draw_count(), MeshOutput::COLOR)]);
    assert!(one.1.iter().filter(|d| d.is_finite()).count() > 10_000);
    assert_eq!(one.2.objects as usize, all.len());
    assert!(one.2.draw_calls <= 4, "{} calls", one.2.draw_calls);

    let kept = meshes.list(&gpu, &backwards, DrawOrder::Kept).unwrap();
    assert_eq!(kept.draw_count(), all.len());
    let (half, end) = (all.len() / 2, all.len());
    let equal = MeshOutput {
        depth_compare: wgpu::CompareFunction::Equal,
        writes_depth: false,
        ..MeshOutput::COLOR
    };
    let unseen = MeshOutput { color: MeshColor::Kept, ..MeshOutput::COLOR };
    for (what, steps) in [
        ("parts", vec![(&kept, half..end, MeshOutput::COLOR), (&kept, 0..half, MeshOutput::COLOR)]),
        (
            "depth first",
            vec![(&kept, 0..end, MeshOutput::DEPTH), (&grouped, 0..grouped.draw_count(), equal)],
        ),
        ("depth beside colours", vec![(&kept, 0..end, unseen), (&kept, 0..end, equal)]),
    ] {
        let found = picture(&gpu, &mut meshes, &steps);
        assert_eq!(found.1, one.1, "{what}: depths");
        assert_eq!(found.0.colors, one.0.colors, "{what}: colours");
    }
    // Without arguments in a buffer each shape is a call.
    let mut direct = Meshes::new(&gpu, &model).unwrap().without_indirect_draws();
    direct.begin(&gpu, &view, &frame).unwrap();
    let list = direct.list(&gpu, &all, DrawOrder::Grouped).unwrap();
    let found = picture(&gpu, &mut direct, &[(&list, 0..list.draw_count(), MeshOutput::COLOR)]);
    assert_eq!((&found.0.colors, &found.1), (&one.0.colors, &one.1));
    assert_eq!(found.2.draw_calls as usize, list.draw_count());
}
