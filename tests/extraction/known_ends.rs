//! Every end, loop and part of vessels whose line is known, on surfaces that once lost or gained one.

use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::*;

/// The line of a phantom has the ends, loops and parts of the known one, and comes within 2 % of the diagonal of it
/// everywhere.
#[track_caller]
fn is_whole(kind: Kind, seed: u64, change: impl FnOnce(&mut Settings)) {
    let mut settings = Settings::of(kind);
    change(&mut settings);
    let phantom = generate(kind, seed, &settings).unwrap();
    let (known, found) = (phantom.extraction(), line_of(&phantom.mesh));
    let shape = |line: &rosaline::centerline::Centerline| (ends_and_junctions(line).0, parts_and_loops(line));
    assert_eq!(shape(&found.centerline), shape(&known.centerline));
    let off = apart(&known, &found) / known.surface.diagonal;
    assert!(off < 0.02, "{off}");
}

#[test]
fn an_open_trunk_with_a_thin_branch_near_its_cut_keeps_its_end() {
    is_whole(Kind::Mixed, 42, |settings| settings.open = true);
}

#[test]
fn a_trunk_that_is_all_but_covered_by_a_sac_is_followed() {
    is_whole(Kind::Aneurysm, 34, |_| {});
}

#[test]
fn a_sac_on_a_noisy_wall_is_a_branch() {
    is_whole(Kind::Aneurysm, 48, |settings| settings.noise = 0.2);
}

#[test]
fn a_coarse_sac_is_a_branch() {
    is_whole(Kind::Aneurysm, 46, |settings| settings.voxel *= 3.0);
}

#[test]
fn fronts_that_meet_on_a_ring_leave_no_end() {
    is_whole(Kind::Loop, 38, |settings| settings.stair = true);
    is_whole(Kind::Loop, 45, |settings| settings.noise = 0.3);
}

#[test]
fn a_noisy_trunk_is_followed_to_its_cap() {
    is_whole(Kind::Bifurcation, 32, |settings| settings.noise = 0.3);
}
