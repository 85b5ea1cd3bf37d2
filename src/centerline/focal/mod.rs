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
/// O(sections), and for each focal place O(its sections x (triangles crossed + its sections + points of the branch)); once more
/// where some are dropped.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn told_anew(
    grid: &TriangleGrid<'_>,
    sections: &[OwnSection],
    graph: &ComponentGraph,
    cancel: &CancelToken,
) -> Result<Option<FocalPlaces>, ExtractError> {
    let told = Told { grid, sections, graph, noise: noise(sections, graph), cancel };
    let mut stretches = told.refuted()?;
    while !stretches.is_empty() {
        let (mut finer, windows) = told.moved(&stretches)?;
        let strayed = told.strayed(&stretches, &finer, &windows);
        if strayed.contains(&true) {
            // What comes off the middle of its vessel by that stays as it was told.
            let mut strayed = strayed.into_iter();
            stretches.retain(|_| strayed.next() != Some(true));
            continue;
        }
        for (window, profile) in windows.iter().zip(told.look(&finer, &windows)?) {
            profile.set_radii(window, grid, told.noise[window.branch], &mut finer);
        }
        return Ok(Some(FocalPlaces { graph: finer, branches: branches(&stretches) }));
    }
    Ok(None)
}

/// A line as it was told, and the surface that it is held against.
struct Told<'a> {
    grid: &'a TriangleGrid<'a>,
    /// The line's own.
    sections: &'a [OwnSection],
    graph: &'a ComponentGraph,
    /// Of each branch.
    noise: Vec<f64>,
    cancel: &'a CancelToken,
}

impl Told<'_> {
    /// What the sections of a line tell in its windows.
    fn look(&self, graph: &ComponentGraph, windows: &[Window]) -> Result<Vec<Profile>, ExtractError> {
        self.cancel.check()?;
        let planes: Vec<Plane> = windows.iter().flat_map(Window::planes).collect();
        let seen = own_sections_in(self.grid, &LineTree::new(graph), graph, &planes);
        let profile =
            |window: &Window| Profile::of(window, window.of(&seen), graph, self.noise[window.branch]);
        Ok(windows.par_iter().map(profile).collect())
    }

    /// The stretches where sections tell another radius.
    fn refuted(&self) -> Result<Vec<Stretch>, ExtractError> {
        let suspects = suspects(self.grid, self.sections, self.graph, &self.noise);
        if suspects.is_empty() {
            return Ok(suspects);
        }
        let (finer, windows) = with_points(self.graph, &suspects);
        let seen = self.look(&finer, &windows)?.into_iter().zip(suspects);
        let refuted = seen.filter(|(profile, _)| profile.share > 0.0);
        let fine = |(profile, stretch): (Profile, Stretch)| Stretch {
            step: stretch.step.min(FINE * profile.least),
            ..stretch
        };
        Ok(refuted.map(fine).collect())
    }

    /// The line through the middles of the sections in some stretches, and where those are.
    fn moved(&self, stretches: &[Stretch]) -> Result<(ComponentGraph, Vec<Window>), ExtractError> {
        let (mut finer, windows) = with_points(self.graph, stretches);
        for _ in 0..MOVES {
            for (window, profile) in windows.iter().zip(self.look(&finer, &windows)?) {
                profile.move_points(window, &mut finer);
            }
        }
        Ok((finer, windows))
    }

    /// Of each stretch, whether the line as it was moved lies farther from the middles of its sections than before, or shows
    /// none any more.
    fn strayed(&self, stretches: &[Stretch], moved: &ComponentGraph, windows: &[Window]) -> Vec<bool> {
        let of_branches = branches(stretches).into_iter();
        let seen = own_sections(self.grid, &LineTree::new(moved), moved, of_branches);
        let one = |(window, stretch): (&Window, &Stretch)| {
            let before = offset(stretch.of(self.sections, self.graph));
            before.is_some_and(|before| {
                offset(window.of(&seen).iter()).is_none_or(|after| after > before.max(CENTRED))
            })
        };
        windows.iter().zip(stretches).map(one).collect()
    }
}

/// The branches that some stretches are of.
fn branches(stretches: &[Stretch]) -> Vec<usize> {
    let mut branches: Vec<usize> = stretches.iter().map(|stretch| stretch.branch).collect();
    branches.dedup();
    branches
}

/// Mean distance of a line from the middles of its sections, in their radii; `None` where there are none.
fn offset<'a>(sections: impl Iterator<Item = &'a OwnSection>) -> Option<f64> {
    let (sum, count) = sections.fold((0.0, 0), |(sum, count), s| (sum + s.offset / s.radius, count + 1));
    (count > 0).then(|| sum / f64::from(count))
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
