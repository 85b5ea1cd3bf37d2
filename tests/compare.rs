//! The metrics over whole files: shared known centerlines, where they stand beside the project.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use rosaline::compare::{Line, measure};

/// Every shared known centerline, with its name.
fn known_lines() -> Vec<(String, Line)> {
    let Some(folder) = common::shared() else { return Vec::new() };
    let mut paths: Vec<_> =
        std::fs::read_dir(folder.join("phantoms")).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.to_string_lossy().ends_with(".gt.json"));
    paths.sort();
    let read = |path: &std::path::PathBuf| Line::read(&std::fs::read(path).unwrap()).unwrap();
    paths.iter().map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), read(path))).collect()
}

#[test]
fn every_known_line_is_one_part_and_at_no_distance_from_itself() {
    for (name, line) in known_lines() {
        assert_eq!(line.parts, 1, "{name}");
        let measures = measure(&line, &line).unwrap();
        assert!(measures.o_max.percent < 1e-9 && measures.missed.percent < 1e-9, "{name}");
        assert_eq!((measures.cover, measures.excess), (1.0, 0.0), "{name}");
        assert!(measures.same_topology(), "{name}");
    }
}

/// A shift leaves its own length as the largest distance, and each point at no more than that.
#[test]
fn a_shifted_known_line_is_no_farther_than_its_shift() {
    for (name, line) in known_lines() {
        let mut shifted = line.clone();
        let shift = nalgebra::Vector3::new(0.2, -0.1, 0.2);
        for point in shifted.polylines.iter_mut().flat_map(|polyline| &mut polyline.points) {
            *point += shift;
        }
        let measures = measure(&line, &shifted).unwrap();
        let (largest, mean) = (measures.o_max.absolute, measures.o_mean.absolute);
        assert!(largest <= 0.3 + 1e-9 && largest > 0.29, "{name}: {largest}");
        assert!(mean < largest && mean > 0.1, "{name}: {mean}");
        assert!((measures.missed.absolute - largest).abs() < 0.01, "{name}");
    }
}
