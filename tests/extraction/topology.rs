//! Phantoms whose line was told with a wrong or doubled branch once.

use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::{ends_and_junctions, line_of, parts_and_loops};

/// Ends, joints, parts and loops are those of the known line, and the line is thin and without `not-thin`.
fn check(kind: Kind, seed: u64, settings: &Settings) {
    let phantom = generate(kind, seed, settings).unwrap();
    let (found, known) = (line_of(&phantom.mesh), phantom.centerline);
    let counts = |line| (ends_and_junctions(line), parts_and_loops(line));
    assert_eq!(counts(&found.centerline), counts(&known), "{kind:?} {seed}");
    assert!(found.quality.is_some_and(|quality| quality.thinness), "{kind:?} {seed}");
    assert!(found.warnings.iter().all(|warning| warning.code != "not-thin"), "{kind:?} {seed}");
}

#[test]
fn a_trunk_whose_short_wide_end_a_front_came_to_aslant_is_passed_once() {
    check(Kind::Mixed, 65, &Settings::of(Kind::Mixed));
    check(Kind::Mixed, 108, &Settings { stair: true, ..Settings::of(Kind::Mixed) });
}

#[test]
fn joints_that_the_fit_brings_together_are_one() {
    check(Kind::Trifurcation, 3, &Settings { noise: 0.3, ..Settings::of(Kind::Trifurcation) });
}

#[test]
fn a_sac_that_the_front_along_its_vessel_climbs_is_kept() {
    check(Kind::Aneurysm, 304, &Settings { noise: 0.3, ..Settings::of(Kind::Aneurysm) });
}
