//! What is wrong with a surface is repaired with a warning that counts, or refused with its place.

use nalgebra::{Point3, Vector3};
use rosaline::centerline::{ExtractError, Preset};
use rosaline::mesh::TriangleMesh;

use crate::lines::*;
use crate::surfaces::*;

fn tube() -> TriangleMesh {
    sweep(straight(20.0), round(1.0), [60, 24], Ends::Flat)
}

/// A tube with `change` done to it is still one tube on its axis, and its warnings are those named, in order.
#[track_caller]
fn survives(change: impl FnOnce(&mut TriangleMesh), warnings: &[(&str, &str)]) {
    let mut mesh = tube();
    change(&mut mesh);
    let found = line_of(&mesh);
    assert_eq!((ends_and_junctions(&found.centerline), parts_and_loops(&found.centerline)), ((2, 0), (1, 0)));
    assert!(points(&found.centerline).all(|(point, _)| point.x.hypot(point.y) < 0.01));
    let told: Vec<_> = found.warnings.iter().map(|warning| warning.code).collect();
    assert_eq!(told, warnings.iter().map(|warning| warning.0).collect::<Vec<_>>());
    for (warning, (_, start)) in found.warnings.iter().zip(warnings) {
        assert!(warning.detail.starts_with(start), "{}", warning.detail);
    }
}

#[track_caller]
fn refused(change: impl FnOnce(&mut TriangleMesh)) -> ExtractError {
    let mut mesh = tube();
    change(&mut mesh);
    extracted(&mesh, Preset::Default).map(|_| ()).unwrap_err()
}

#[test]
fn triangles_that_repeat_or_have_no_corners_go() {
    let twice = |mesh: &mut TriangleMesh| {
        let again: Vec<_> = mesh.triangles.iter().step_by(480).copied().collect();
        mesh.triangles.extend(again);
        mesh.triangles.extend([[3, 3, 4], [7, 8, 7]]);
    };
    let degenerate = "2 triangles with two equal corners were left out: triangle 2886, 2887";
    let repeated =
        "6 triangles that repeat another were left out: triangle 2880, 2881, 2882, 2883, 2884, ...";
    survives(twice, &[("degenerate-triangles", degenerate), ("duplicate-triangles", repeated)]);
}

#[test]
fn normals_that_point_the_wrong_way_are_turned() {
    let all = |mesh: &mut TriangleMesh| mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    survives(all, &[("inverted-components", "1 components")]);
    let some =
        |mesh: &mut TriangleMesh| mesh.triangles.iter_mut().skip(5).step_by(1000).for_each(|t| t.swap(0, 1));
    let turned = "3 triangles were turned to agree with their neighbours: triangle 5, 1005, 2005";
    survives(some, &[("flipped-triangles", turned)]);
}

#[test]
fn a_fin_on_the_wall_comes_off() {
    let fin = |mesh: &mut TriangleMesh| {
        let [a, b, _] = mesh.triangles[1400];
        let foot = mesh.vertices[a as usize];
        mesh.vertices.push(foot + Vector3::new(0.5 * foot.x, 0.5 * foot.y, 0.0));
        mesh.triangles.push([a, b, mesh.vertices.len() as u32 - 1]);
    };
    let edge = "1 edges have more than two triangles; the surface was taken apart there: an edge of triangle";
    let skipped = ("component-skipped", "component 1 ");
    survives(fin, &[("non-manifold-edges", edge), ("split-vertices", "2 vertices"), skipped]);
}

/// A sheet of seven quads along the wall, to `reach` times its distance from the axis.
fn sheet(mesh: &mut TriangleMesh, reach: f64) {
    let first = mesh.vertices.len() as u32;
    let foot = |k: u32| 24 * (20 + k);
    for k in 0..8 {
        let p = mesh.vertices[foot(k) as usize];
        mesh.vertices.push(Point3::new(reach * p.x, reach * p.y, p.z));
    }
    for k in 0..7 {
        let (a, b, c, d) = (foot(k), foot(k + 1), first + k, first + k + 1);
        mesh.triangles.extend([[a, b, c], [b, d, c]]);
    }
}

#[test]
fn a_sheet_outside_the_wall_comes_off() {
    let edges = ("non-manifold-edges", "7 edges have more than two triangles");
    let rest = [("split-vertices", "8 vertices"), ("component-skipped", "component 1 ")];
    survives(|mesh| sheet(mesh, 2.0), &[edges, rest[0], rest[1]]);
}

#[test]
fn a_sheet_inside_the_wall_comes_off() {
    let edges = ("non-manifold-edges", "7 edges have more than two triangles");
    let rest = [("split-vertices", "8 vertices"), ("component-skipped", "component 1 ")];
    survives(|mesh| sheet(mesh, 0.5), &[edges, rest[0], rest[1]]);
}

#[test]
fn isolated_triangles_and_islands_are_skipped() {
    let lone = |size: f64| {
        move |mesh: &mut TriangleMesh| {
            let first = mesh.vertices.len() as u32;
            let at = |x: f64, y: f64| Point3::new(5.0 + x * size, y * size, 0.0);
            mesh.vertices.extend([at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
    };
    survives(lone(0.1), &[("specks-skipped", "1 components")]);
    survives(lone(3.0), &[("component-skipped", "component 1 ")]);
    let island = |mesh: &mut TriangleMesh| {
        let ball = implicit([-0.8; 3], [0.8; 3], 0.1, |point| point.coords.norm() - 0.6);
        *mesh = together(&[mesh.clone(), mapped(&ball, |point| point + Vector3::new(4.0, 0.0, 5.0))]);
    };
    survives(island, &[("component-skipped", "component 1 ")]);
}

#[test]
fn a_missing_triangle_is_no_end() {
    let holed = |mesh: &mut TriangleMesh| {
        mesh.triangles.remove(1400);
    };
    survives(holed, &[("holes-closed", "1 ")]);
}

#[test]
fn a_triangle_missing_in_a_cap_does_not_move_the_end() {
    survives(|mesh| mesh.triangles.truncate(2879), &[("holes-closed", "1 ")]);
}

#[test]
fn a_small_hole_is_no_end_and_is_told() {
    survives(|mesh| mesh.triangles.retain(|t| !t.contains(&723)), &[("holes-closed", "1 ")]);
}

#[test]
fn a_cavity_is_no_vessel() {
    let cavity = |mesh: &mut TriangleMesh| {
        let inner = sweep(straight(4.0), round(0.3), [20, 12], Ends::Flat);
        let mut inner = mapped(&inner, |point| point + Vector3::new(0.1, 0.0, 8.0));
        inner.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        *mesh = together(&[mesh.clone(), inner]);
    };
    survives(cavity, &[("internal-cavities", "1 ")]);
}

#[test]
fn two_tubes_that_cross_unwelded_are_two() {
    let one = tube();
    let other = mapped(&one, |p| Point3::new(p.z - 10.0, p.x, p.y + 10.0));
    let found = line_of(&together(&[one, other]));
    assert_eq!((ends_and_junctions(&found.centerline), parts_and_loops(&found.centerline)), ((4, 0), (2, 0)));
}

#[test]
fn what_cannot_be_saved_says_where_it_is_wrong() {
    let error = refused(|mesh| [100, 7].iter().for_each(|&v| mesh.vertices[v].x = f64::NAN));
    assert_eq!(error, ExtractError::NotFinite { count: 2, first: "7, 100".to_owned() });
    assert!(error.to_string().contains("(vertex 7, 100); export"), "{error}");
    let error = refused(|mesh| mesh.triangles[5][1] = 999_999);
    assert_eq!(error, ExtractError::OutOfRange { count: 1, first: "5".to_owned() });
    assert_eq!(refused(|mesh| mesh.triangles.clear()), ExtractError::NoTriangles);
    let flat = refused(|mesh| mesh.vertices.iter_mut().for_each(|p| *p = Point3::new(0.0, 0.0, p.z)));
    assert_eq!(flat, ExtractError::AllDegenerate { triangles: 2880 });
}

/// A needle is any number of its radii long: its sections are not followed one by one.
#[test]
fn a_stray_vertex_far_away_makes_no_endless_line() {
    let mut mesh = tube();
    let middle = mesh.vertices.len() / 2;
    mesh.vertices[middle].x += 1000.0;
    let found = line_of(&mesh);
    let count: usize = found.centerline.branches.iter().map(|branch| branch.points.len()).sum();
    assert!(count < 20_000, "{count} points");
    assert!(!found.warnings.is_empty(), "it is told of");
}

/// Squares of areas would overflow.
#[test]
fn a_surface_of_any_size_is_refused_by_its_size() {
    for size in [1e31, 1e78, 1e100, 1e150, 1e300] {
        for ends in [Ends::Flat, Ends::Open] {
            let mesh = sweep(straight(20.0), round(1.0), [60, 24], ends);
            let error = extracted(&mapped(&mesh, |point| point * size), Preset::Default).unwrap_err();
            assert!(matches!(error, ExtractError::OutOfScale { .. }), "{size:e}: {error}");
        }
    }
}

/// Draws the middle of a facet, shrunk to a share `width` of it, out of the wall, and closes the rest of the facet around it;
/// the three new vertices.
fn drawn_out(mesh: &mut TriangleMesh, facet: usize, width: f64, height: f64) -> [u32; 3] {
    let outer = mesh.triangles[facet];
    let corners = outer.map(|v| mesh.vertices[v as usize]);
    let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).normalize();
    let middle = Point3::from(corners.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 3.0);
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(corners.map(|corner| middle + (corner - middle) * width + normal * height));
    let inner = [first, first + 1, first + 2];
    mesh.triangles.remove(facet);
    for k in 0..3 {
        let next = (k + 1) % 3;
        mesh.triangles.extend([[outer[k], outer[next], inner[k]], [outer[next], inner[next], inner[k]]]);
    }
    inner
}

/// As meshes of segmented images have them: many times as high as it is wide, and no higher than a facet is long.
#[test]
fn a_needle_on_the_wall_is_no_branch() {
    for width in [0.02, 0.1] {
        let needle = |mesh: &mut TriangleMesh| {
            let mut top = drawn_out(mesh, 1401, width, 0.0);
            for _ in 0..5 {
                mesh.triangles.push(top);
                top = drawn_out(mesh, mesh.triangles.len() - 1, 0.9, 0.04);
            }
            mesh.triangles.push(top);
        };
        survives(needle, &[]);
    }
}

/// A handle no larger than a facet is one loop of the line, and the vessel's own line is none the worse for it.
#[test]
fn a_strand_beside_the_wall_leaves_the_vessels_line_alone() {
    for width in [1e-4, 0.02, 0.1] {
        let mut mesh = tube();
        let from = drawn_out(&mut mesh, 1405, width, 0.05);
        let to = drawn_out(&mut mesh, 1401, width, 0.05);
        for k in 0..3 {
            let (next, [a, b]) = ((k + 1) % 3, [(3 - k) % 3, (2 - k) % 3]);
            mesh.triangles.extend([[from[k], from[next], to[a]], [from[next], to[b], to[a]]]);
        }
        let found = line_of(&mesh);
        assert_eq!(
            (ends_and_junctions(&found.centerline).0, parts_and_loops(&found.centerline)),
            (2, (1, 1)),
            "{width}"
        );
        let lost =
            found.warnings.iter().filter(|w| ["outside", "wall-without-line", "bridged"].contains(&w.code));
        assert_eq!(lost.count(), 0, "{width}: {:?}", found.warnings);
        let beside =
            |z: f64| points(&found.centerline).any(|(p, _)| p.x.hypot(p.y) < 0.05 && (p.z - z).abs() < 0.3);
        assert!((0..=40).all(|i| beside(0.5 * f64::from(i))), "{width}");
    }
}
