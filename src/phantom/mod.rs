//! Surfaces with known centerlines (the paper's Fig. 12 experiment, its ref. 33).
//!
//! The lumen is the union of spheres along smooth random curves, cut flat at the tips; the
//! surface is marching cubes of its distance field. Lengths are in mm. A seed gives the same
//! curves whatever the voxel and the faults, and the same bytes wherever sines and cosines round
//! alike.

mod curve;
mod faults;
mod growth;
mod kinds;
mod lumen;
mod marching;
mod random;
mod skeleton;

use std::fmt;
use std::str::FromStr;

use crate::centerline::{Centerline, Extraction, SurfaceSummary};
use crate::mesh::TriangleMesh;

use lumen::Grid;
use random::Random;

/// What a phantom is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// One curved tube.
    Tube,
    /// A trunk with two branches.
    Bifurcation,
    /// A tree with 8 leaves.
    Tree,
    /// A tree that forks into threes twice: 9 leaves.
    Trifurcation,
    /// A ring with three branches.
    Loop,
    /// A bifurcation with a sac at the side of its trunk.
    Aneurysm,
    /// A tube that narrows.
    Stenosis,
    /// A trunk of radius 12 with side branches of radius 1.
    Mixed,
    /// Two branches that run wall to wall.
    Parallel,
    /// A tree with 32 leaves.
    Bigtree,
}

impl Kind {
    pub const ALL: [Kind; 10] = [
        Kind::Tube,
        Kind::Bifurcation,
        Kind::Tree,
        Kind::Trifurcation,
        Kind::Loop,
        Kind::Aneurysm,
        Kind::Stenosis,
        Kind::Mixed,
        Kind::Parallel,
        Kind::Bigtree,
    ];

    pub const NAMES: [&'static str; 10] = [
        "tube",
        "bifurcation",
        "tree",
        "trifurcation",
        "loop",
        "aneurysm",
        "stenosis",
        "mixed",
        "parallel",
        "bigtree",
    ];

    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Side of a voxel, in mm.
    pub fn voxel(self) -> f64 {
        match self {
            Kind::Mixed => 0.5,
            Kind::Bigtree => 0.35,
            _ => 0.4,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = PhantomError;

    fn from_str(text: &str) -> Result<Self, PhantomError> {
        let place = Self::NAMES.iter().position(|name| *name == text);
        place
            .map(|place| Self::ALL[place])
            .ok_or_else(|| PhantomError::UnknownKind { found: text.to_owned() })
    }
}

/// How the surface of a phantom is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Side of a voxel, in mm.
    pub voxel: f64,
    /// Deviation of the Gaussian noise on every coordinate of every vertex, in voxels.
    pub noise: f64,
    /// The surface of the lumen's binary voxels instead of its distance field.
    pub stair: bool,
    /// Without the flat caps at the tips.
    pub open: bool,
}

impl Settings {
    /// A clean surface with the kind's own voxel.
    pub fn of(kind: Kind) -> Self {
        Self { voxel: kind.voxel(), noise: 0.0, stair: false, open: false }
    }
}

/// A surface and its known centerline.
#[derive(Debug, Clone, PartialEq)]
pub struct Phantom {
    /// Closed (but for the openings that were asked for) and manifold; normals out of the lumen.
    pub mesh: TriangleMesh,
    /// Points 0.1 mm apart. The radius is that of the branch's own spheres, also where the branch
    /// lies inside a wider one.
    pub centerline: Centerline,
    pub surface: SurfaceSummary,
}

/// A length of some micrometres or more, for messages: without what a product of decimals is off by.
fn plain(millimetres: f64) -> f64 {
    (millimetres * 1e6).round() / 1e6
}

/// Why there is no phantom.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhantomError {
    #[error("there is no phantom '{found}'; the kinds are {}", Kind::NAMES.join(", "))]
    UnknownKind { found: String },
    #[error("seed {seed} finds no room for every branch of a {kind}; take another seed")]
    Crowded { kind: Kind, seed: u64 },
    #[error("a voxel of {voxel} mm is not a length from 0.001 to 10; the kinds' own are 0.35 to 0.5")]
    Voxel { voxel: f64 },
    #[error("noise of {noise} voxels is not a number from 0 to 1")]
    Noise { noise: f64 },
    #[error("a voxel of {} mm makes too many voxels; take a larger one", plain(*voxel))]
    TooFine { voxel: f64 },
    #[error(
        "a voxel of {} mm is too coarse for the thinnest branch or gap of this {kind}; take a smaller one",
        plain(*voxel)
    )]
    TooCoarse { kind: Kind, voxel: f64 },
}

/// Places of the grid under the lumen that are tried until no branch falls between the nodes.
const SHIFTS: u32 = 24;

/// Makes the phantom of a seed.
///
/// # Errors
/// [`PhantomError`] for settings out of range and for a seed whose branches find no room.
pub fn generate(kind: Kind, seed: u64, settings: &Settings) -> Result<Phantom, PhantomError> {
    let &Settings { voxel, noise, stair, open } = settings;
    if !(0.001..=10.0).contains(&voxel) {
        return Err(PhantomError::Voxel { voxel });
    }
    if !(0.0..=1.0).contains(&noise) {
        return Err(PhantomError::Noise { noise });
    }
    let skeleton = kinds::build(kind, seed)?;
    let centerline = skeleton.graph();
    let loops = centerline.branches.len() + 1 - centerline.nodes.len();
    let cuts: Vec<_> =
        (0..skeleton.vessels.len()).flat_map(|vessel| skeleton.cuts(vessel)).flatten().collect();
    let mut mesh = None;
    for shift in 0..SHIFTS {
        let mut grid = Grid::of(&skeleton, voxel, 0.5 + f64::from(shift) / f64::from(SHIFTS))?;
        if stair {
            grid.binarise();
        }
        let candidate = marching::surface(&grid);
        let whole = cuts.iter().all(|cut| faults::reaches(&candidate, cut, voxel));
        if whole && faults::components(&candidate) == 1 && faults::genus(&candidate) == Some(loops) {
            mesh = Some(candidate);
            break;
        }
    }
    let mut mesh = mesh.ok_or(PhantomError::TooCoarse { kind, voxel })?;
    if open {
        for cut in &cuts {
            faults::open(&mut mesh, cut, voxel);
        }
    }
    faults::add_noise(&mut mesh, noise * voxel, &mut Random::new(!seed));
    let surface = SurfaceSummary {
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        components: 1,
        genus: loops,
        openings: if open { cuts.len() } else { 0 },
        diagonal: faults::diagonal(&mesh),
    };
    Ok(Phantom { mesh, centerline, surface })
}

impl Phantom {
    /// The known centerline as the method would answer it.
    pub fn extraction(&self) -> Extraction {
        Extraction {
            centerline: self.centerline.clone(),
            surface: self.surface.clone(),
            quality: None,
            warnings: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back() {
        for kind in Kind::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        let error = "octopus".parse::<Kind>().unwrap_err();
        assert!(error.to_string().contains("tube, bifurcation"), "{error}");
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let settings = Settings::of(Kind::Tube);
        for voxel in [0.0, -1.0, f64::NAN, 11.0] {
            let error = generate(Kind::Tube, 1, &Settings { voxel, ..settings }).unwrap_err();
            assert!(matches!(error, PhantomError::Voxel { .. }));
        }
        let error = generate(Kind::Tube, 1, &Settings { noise: 2.0, ..settings }).unwrap_err();
        assert_eq!(error, PhantomError::Noise { noise: 2.0 });
        let error = generate(Kind::Tree, 1, &Settings { voxel: 6.0, ..settings }).unwrap_err();
        assert!(matches!(error, PhantomError::TooCoarse { .. }));
    }
}
