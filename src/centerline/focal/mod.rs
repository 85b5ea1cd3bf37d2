//! Focal places: where a vessel narrows or widens within about a diameter (a stenosis, a fusiform aneurysm).
//!
//! The swept tube takes the wall's radius for one smooth curve along the whole branch, as stiff as noise asks for, and hears no
//! wall half a radius off it: it passes over what changes that fast. So the told radii are held against the line's own
//! sections. Where they do not agree, the line is told anew from sections close together: it runs through their middles, and its
//! radius is that of the largest sphere that fits between them.

mod profile;
mod suspects;
mod window;

use rayon::prelude::*;

use super::ExtractError;
use super::component::ComponentGraph;
use super::control::CancelToken;
use super::line_tree::LineTree;
use super::own_sections::{OwnSection, Plane, own_sections, own_sections_in};
use super::triangle_grid::TriangleGrid;
use profile::{CENTRED, Profile};
use suspects::{noise, suspects};
use window::{Stretch, Window, with_points};

/// Told radius over that of the section, or the other way around: up to the first they agree, from the second on the section
/// alone is believed, and in between both.
const AGREED: f64 = 1.05;
const REFUTED: f64 = 1.12;
/// More than that of both where nothing shows the wall but a few vertices.
const COARSE: f64 = 1.2;
/// Distance of the sections, in radii of the narrowest, where there is something.
const FINE: f64 = 0.125;
/// How often the line is moved into the middles of its sections: a throat that it passes beside is first seen from nearby.
const MOVES: usize = 2;

/// A line whose focal places were told anew, and which of its branches have any.
pub struct FocalPlaces {
    pub graph: ComponentGraph,
    pub branches: Vec<usize>,
}

/// The line with its focal places told anew; `None` where there are none. `sections` are the line's own.
///
/// O(sections), and for each focal place O(its sections x (triangles crossed + its sections + points of the branch)).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn told_anew(
    grid: &TriangleGrid<'_>,
    sections: &[OwnSection],
    graph: &ComponentGraph,
    cancel: &CancelToken,
) -> Result<Option<FocalPlaces>, ExtractError> {
    let noise = noise(sections, graph);
    let look = |graph: &ComponentGraph, windows: &[Window]| {
        cancel.check()?;
        let planes: Vec<Plane> = windows.iter().flat_map(Window::planes).collect();
        let seen = own_sections_in(grid, &LineTree::new(graph), graph, &planes);
        let profile = |window: &Window| {
            let before =
                |place: usize| seen.partition_point(|s| (s.branch, s.place) < (window.branch, place));
            let here = before(window.places.start)..before(window.places.end);
            Profile::of(window, &seen[here], graph, noise[window.branch])
        };
        Ok::<Vec<Profile>, ExtractError>(windows.par_iter().map(profile).collect())
    };
    let suspects = suspects(grid, sections, graph, &noise);
    if suspects.is_empty() {
        return Ok(None);
    }
    let (finer, windows) = with_points(graph, &suspects);
    let seen = look(&finer, &windows)?.into_iter().zip(suspects);
    let refuted = seen.filter(|(profile, _)| profile.share > 0.0);
    let mut stretches: Vec<Stretch> = refuted
        .map(|(profile, stretch)| Stretch { step: stretch.step.min(FINE * profile.least), ..stretch })
        .collect();
    while !stretches.is_empty() {
        let (mut finer, windows) = with_points(graph, &stretches);
        for _ in 0..MOVES {
            for (window, profile) in windows.iter().zip(look(&finer, &windows)?) {
                profile.move_points(window, &mut finer);
            }
        }
        let mut branches: Vec<usize> = stretches.iter().map(|stretch| stretch.branch).collect();
        branches.dedup();
        let moved = own_sections(grid, &LineTree::new(&finer), &finer, branches.iter().copied());
        let strayed = |(window, stretch): (&Window, &Stretch)| {
            offset(window.of(&moved)) > offset(stretch.of(sections, graph)).max(CENTRED)
        };
        let strayed: Vec<bool> = windows.iter().zip(&stretches).map(strayed).collect();
        if strayed.contains(&true) {
            // What came off the middle of its vessel by that stays as it was told, and is warned of.
            let mut strayed = strayed.into_iter();
            stretches.retain(|_| strayed.next() != Some(true));
            continue;
        }
        for (window, profile) in windows.iter().zip(look(&finer, &windows)?) {
            profile.set_radii(window, grid, noise[window.branch], &mut finer);
        }
        return Ok(Some(FocalPlaces { graph: finer, branches }));
    }
    Ok(None)
}

/// Mean distance of a line from the middles of its sections, in their radii; 0 where there are none.
fn offset<'a>(sections: impl Iterator<Item = &'a OwnSection>) -> f64 {
    let (sum, count) = sections.fold((0.0, 0), |(sum, count), s| (sum + s.offset / s.radius, count + 1));
    sum / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use crate::centerline::test_surfaces::revolved;
    use crate::centerline::{Control, Parameters, extract};

    /// Radii told and known along a tube of radius 2 that is `least` at its middle, over a length of `width`.
    fn radii(least: f64, width: f64) -> Vec<[f64; 2]> {
        let known = |z: f64| 2.0 + (least - 2.0) * (-((z - 20.0) / width).powi(2)).exp();
        let wall = (0..=240).map(|k| f64::from(k) / 6.0).map(|z| (known(z), z));
        let profile: Vec<(f64, f64)> = std::iter::once((0.0, 0.0)).chain(wall).chain([(0.0, 40.0)]).collect();
        let found = extract(&revolved(&profile, 32), &Parameters::default(), &Control::silent()).unwrap();
        let fits = |z: f64| {
            let away = (0..=1600).map(|k| f64::from(k) / 40.0).map(|w| known(w).hypot(w - z));
            away.fold(f64::INFINITY, f64::min)
        };
        let branch = &found.centerline.branches[0];
        let inner =
            branch.points.iter().zip(&branch.radii).filter(|(point, _)| (3.0..37.0).contains(&point.z));
        inner.map(|(point, &radius)| [radius, fits(point.z)]).collect()
    }

    #[test]
    fn a_narrow_place_shorter_than_a_diameter_has_its_radius() {
        for (least, width) in [(1.0, 1.0), (1.0, 1.5), (1.4, 1.5), (0.5, 1.5), (0.5, 2.0)] {
            let radii = radii(least, width);
            let narrowest = radii.iter().map(|[told, _]| *told).fold(f64::INFINITY, f64::min);
            assert!((narrowest / least - 1.0).abs() < 0.05, "{least} over {width}: {narrowest}");
            for [told, fits] in radii {
                assert!((told / fits - 1.0).abs() < 0.12, "{least} over {width}: {told}, not {fits}");
            }
        }
    }

    #[test]
    fn a_short_widening_has_the_spheres_that_fit() {
        for (most, width) in [(3.0, 1.5), (3.0, 3.0), (4.0, 2.0), (4.0, 3.0), (4.0, 5.0)] {
            for [told, fits] in radii(most, width) {
                assert!((told / fits - 1.0).abs() < 0.07, "{most} over {width}: {told}, not {fits}");
            }
        }
    }
}
