//! The paper's error metrics (V, Table 1) of a result against a known centerline.
//!
//! Both lines are sampled every 1/2000 of the known line's diagonal, and each sample's distance
//! to the other line itself, not to its samples, is taken.

mod known;
mod line;
mod nearest;
mod vmtk;

pub use line::{Line, Polyline};

use serde::Serialize;

use nearest::SegmentTree;

/// Samples in a diagonal.
pub const SAMPLES_PER_DIAGONAL: f64 = 2000.0;

/// A line longer than this many diagonals is not a centerline in the same unit.
const MOST_DIAGONALS: f64 = 1000.0;

/// A length, and the same as a share of the known line's diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Length {
    /// In the lines' unit.
    pub absolute: f64,
    /// Of the diagonal.
    pub percent: f64,
}

/// A count in both lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Count {
    pub truth: usize,
    pub result: usize,
}

/// How far a result is from the known centerline.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measures {
    /// `null` where neither line names its unit.
    pub units: Option<String>,
    /// Diagonal of the known mesh's bounding box, in `units`; of the result's where the known line does not say.
    pub diagonal: f64,
    /// Largest distance from the result to the known line (the paper's O_max).
    pub o_max: Length,
    /// Mean of that distance along the result (O_mean).
    pub o_mean: Length,
    /// Standard deviation of that distance along the result (O_var).
    pub o_var: Length,
    /// Largest distance from the known line to the result.
    pub missed: Length,
    /// Share of the known length that the result passes within half the local radius.
    pub cover: f64,
    /// Share of the result's length that is farther than that from the known line.
    pub excess: f64,
    /// Mean relative error of the radius along the result, against the radius at the nearest
    /// point of the known line, where that is one: above a millionth of the widest.
    pub radius: f64,
    /// Ends of the graph.
    pub tips: Count,
    /// Independent loops of the graph.
    pub loops: Count,
    /// Connected parts of the graph.
    pub parts: Count,
}

impl Measures {
    /// Whether tips, loops and parts are those of the known line.
    pub fn same_topology(&self) -> bool {
        [self.tips, self.loops, self.parts].iter().all(|count| count.truth == count.result)
    }
}

/// Why two lines cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error(
        "this is {0}; a line is read from Rosaline's JSON, from polylines with `l_dia` as JSON, or from VMTK's centerlines (.vtp): \
         of a job take results/centerline.json, of a mesh what 'rosaline extract MESH -o LINE.json' makes"
    )]
    Format(&'static str),
    #[error(
        "this is neither a rosaline.centerline/1 document nor a list of polylines [x, y, z, radius]: {0}"
    )]
    Json(#[from] serde_json::Error),
    #[error("this is no centerline of VMTK's: {0}")]
    Vtp(#[from] crate::mesh::format::ReadError),
    #[error("neither line says the diagonal of its surface; compare with a rosaline result or with `l_dia`")]
    NoDiagonal,
    #[error(transparent)]
    Document(#[from] crate::output::OutputError),
    #[error("the line has no length, so there is nothing to measure")]
    Empty,
    #[error(
        "the result is {found:.3e} long beside a known diagonal of {diagonal}; are both in the same unit?"
    )]
    TooLong { found: f64, diagonal: f64 },
    #[error("polyline {polyline} has a point that is not four finite numbers; each is [x, y, z, radius]")]
    BadPoint { polyline: usize },
    #[error("polyline {polyline} has {points} points; a line needs two")]
    TooShort { polyline: usize, points: usize },
    #[error("the diagonal of the known line is {found}; it must be a positive number")]
    Diagonal { found: f64 },
    #[error(
        "the known line is in {truth} and the result in {result}; extract with the unit of the known line"
    )]
    Units { truth: String, result: String },
}

/// Measures `result` against the known line `truth`. A line without a unit is taken to be in the other's.
///
/// # Errors
/// [`CompareError::Empty`], [`CompareError::TooLong`], [`CompareError::NoDiagonal`], [`CompareError::Diagonal`] and
/// [`CompareError::Units`].
pub fn measure(truth: &Line, result: &Line) -> Result<Measures, CompareError> {
    let diagonal = truth.diagonal.or(result.diagonal).ok_or(CompareError::NoDiagonal)?;
    if !(diagonal.is_finite() && diagonal > 0.0) {
        return Err(CompareError::Diagonal { found: diagonal });
    }
    if let (Some(truth), Some(result)) = (&truth.units, &result.units)
        && truth != result
    {
        return Err(CompareError::Units { truth: truth.clone(), result: result.clone() });
    }
    for line in [truth, result] {
        let found: f64 = line.polylines.iter().map(Polyline::length).sum();
        if found.is_nan() || found > MOST_DIAGONALS * diagonal {
            return Err(CompareError::TooLong { found, diagonal });
        }
        if found <= 0.0 {
            return Err(CompareError::Empty);
        }
    }
    let step = diagonal / SAMPLES_PER_DIAGONAL;
    let known = SegmentTree::new(&truth.polylines).ok_or(CompareError::Empty)?;
    let found = SegmentTree::new(&result.polylines).ok_or(CompareError::Empty)?;
    let widest = truth.polylines.iter().flat_map(|line| line.radii.iter().copied()).fold(0.0, f64::max);
    let forward = from_result(result, &known, widest, step);
    let (missed, cover) = from_truth(truth, &found, step);
    let length = |absolute: f64| Length { absolute, percent: 100.0 * absolute / diagonal };
    let count = |truth, result| Count { truth, result };
    Ok(Measures {
        units: truth.units.clone().or_else(|| result.units.clone()),
        diagonal,
        o_max: length(forward.max),
        o_mean: length(forward.mean),
        o_var: length(forward.deviation),
        missed: length(missed),
        cover,
        excess: forward.excess,
        radius: forward.radius,
        tips: count(truth.tips, result.tips),
        loops: count(truth.loops, result.loops),
        parts: count(truth.parts, result.parts),
    })
}

/// What is measured along the result.
struct Forward {
    max: f64,
    mean: f64,
    deviation: f64,
    excess: f64,
    radius: f64,
}

fn from_result(result: &Line, known: &SegmentTree, widest: f64, step: f64) -> Forward {
    /// Share of the widest known radius below which one is none: at the top of a dome it runs out to nothing.
    const NONE: f64 = 1e-6;
    let least = NONE * widest;
    let (mut weight, mut with_radius) = (0.0, 0.0);
    let mut sums = Forward { max: 0.0, mean: 0.0, deviation: 0.0, excess: 0.0, radius: 0.0 };
    let mut squares = 0.0;
    for sample in result.polylines.iter().flat_map(|polyline| polyline.samples(step)) {
        let near = known.nearest(&sample.point);
        weight += sample.weight;
        sums.max = sums.max.max(near.distance);
        sums.mean += sample.weight * near.distance;
        squares += sample.weight * near.distance * near.distance;
        if near.distance > 0.5 * near.radius {
            sums.excess += sample.weight;
        }
        if near.radius > least {
            sums.radius += sample.weight * (sample.radius - near.radius).abs() / near.radius;
            with_radius += sample.weight;
        }
    }
    let mean = sums.mean / weight;
    Forward {
        max: sums.max,
        mean,
        deviation: (squares / weight - mean * mean).max(0.0).sqrt(),
        excess: sums.excess / weight,
        radius: if with_radius > 0.0 { sums.radius / with_radius } else { 0.0 },
    }
}

/// The largest distance from the known line to the result, and the share of it that is covered.
fn from_truth(truth: &Line, found: &SegmentTree, step: f64) -> (f64, f64) {
    let (mut missed, mut covered, mut weight) = (0.0_f64, 0.0, 0.0);
    for sample in truth.polylines.iter().flat_map(|polyline| polyline.samples(step)) {
        let distance = found.nearest(&sample.point).distance;
        weight += sample.weight;
        missed = missed.max(distance);
        if distance <= 0.5 * sample.radius {
            covered += sample.weight;
        }
    }
    (missed, covered / weight)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    fn straight(from: [f64; 3], to: [f64; 3], radii: [f64; 2]) -> Polyline {
        Polyline { points: vec![Point3::from(from), Point3::from(to)], radii: radii.to_vec() }
    }

    fn line(polylines: Vec<Polyline>) -> Line {
        Line { polylines, tips: 2, loops: 0, parts: 1, units: Some("mm".to_owned()), diagonal: Some(100.0) }
    }

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
    }

    #[test]
    fn a_line_is_at_no_distance_from_itself() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 1.0])]);
        let measures = measure(&truth, &truth).unwrap();
        close(measures.o_max.absolute, 0.0, 1e-12);
        close(measures.missed.absolute, 0.0, 1e-12);
        assert_eq!((measures.cover, measures.excess), (1.0, 0.0));
        close(measures.radius, 0.0, 1e-12);
        assert!(measures.same_topology());
    }

    #[test]
    fn a_shifted_line_is_as_far_everywhere() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 2.0])]);
        let result = line(vec![straight([0.0, 0.5, 0.0], [100.0, 0.5, 0.0], [1.5, 1.5])]);
        let measures = measure(&truth, &result).unwrap();
        close(measures.o_max.absolute, 0.5, 1e-12);
        close(measures.o_mean.percent, 0.5, 1e-12);
        close(measures.o_var.absolute, 0.0, 1e-7);
        close(measures.missed.absolute, 0.5, 1e-12);
        close(measures.radius, 0.25, 1e-12);
        assert_eq!((measures.cover, measures.excess), (1.0, 0.0));
    }

    #[test]
    fn where_the_known_radius_runs_out_to_nothing_there_is_none_to_compare_with() {
        let dome = straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 1e-12]);
        let measures =
            measure(&line(vec![dome]), &line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 0.1])]));
        let radius = measures.unwrap().radius;
        assert!(radius < 1.0, "{radius}");
    }

    /// The distance rises from 0 to 3 along the result: its mean is 3/2, its deviation
    /// 3/sqrt(12), and it passes 1 = r/2 after a third of the way.
    #[test]
    fn a_line_that_leaves_at_a_slope_has_the_moments_of_a_ramp() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 2.0])]);
        let result = line(vec![straight([0.0; 3], [100.0, 3.0, 0.0], [2.0, 2.0])]);
        let measures = measure(&truth, &result).unwrap();
        close(measures.o_max.absolute, 3.0, 1e-12);
        close(measures.o_mean.absolute, 1.5, 1e-9);
        close(measures.o_var.absolute, 3.0 / 12.0_f64.sqrt(), 1e-5);
        close(measures.excess, 2.0 / 3.0, 6e-4);
    }

    /// The result stops 40 short: those 40 are missed but for the radius of 2 that is half a
    /// radius past its end, and nothing of the result is off.
    #[test]
    fn a_short_result_is_missed_and_not_covered() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [4.0, 4.0])]);
        let result = line(vec![straight([0.0; 3], [60.0, 0.0, 0.0], [4.0, 4.0])]);
        let measures = measure(&truth, &result).unwrap();
        close(measures.o_max.absolute, 0.0, 1e-12);
        close(measures.missed.absolute, 40.0, 1e-12);
        close(measures.missed.percent, 40.0, 1e-12);
        close(measures.cover, 0.62, 6e-4);
        assert_eq!(measures.excess, 0.0);
    }

    /// A spurious branch of 20 beside a true 100: 19 of 120 are farther than 1 = r/2.
    #[test]
    fn a_spurious_branch_is_excess() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 2.0])]);
        let spur = straight([50.0, 0.0, 0.0], [50.0, 20.0, 0.0], [2.0, 2.0]);
        let mut result = line(vec![truth.polylines[0].clone(), spur]);
        result.tips = 3;
        let measures = measure(&truth, &result).unwrap();
        close(measures.o_max.absolute, 20.0, 1e-12);
        close(measures.o_mean.absolute, 200.0 / 120.0, 1e-9);
        close(measures.excess, 19.0 / 120.0, 6e-4);
        assert_eq!(measures.tips, Count { truth: 2, result: 3 });
        assert!(!measures.same_topology());
    }

    #[test]
    fn lines_in_other_units_and_empty_ones_are_refused() {
        let truth = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 2.0])]);
        let mut metres = truth.clone();
        metres.units = Some("m".to_owned());
        let error = measure(&truth, &metres).unwrap_err();
        assert!(error.to_string().contains("in mm and the result in m;"), "{error}");
        assert!(matches!(measure(&truth, &line(Vec::new())), Err(CompareError::Empty)));
        let point = straight([1.0; 3], [1.0; 3], [1.0, 1.0]);
        assert!(matches!(measure(&truth, &line(vec![point])), Err(CompareError::Empty)));
        let far = straight([0.0; 3], [1e6, 0.0, 0.0], [1.0, 1.0]);
        assert!(matches!(measure(&truth, &line(vec![far])), Err(CompareError::TooLong { .. })));
        let mut flat = truth.clone();
        flat.diagonal = Some(0.0);
        assert!(matches!(measure(&flat, &truth), Err(CompareError::Diagonal { .. })));
    }

    #[test]
    fn a_line_without_unit_and_diagonal_has_the_other_lines() {
        let mut bare = line(vec![straight([0.0; 3], [100.0, 0.0, 0.0], [2.0, 2.0])]);
        let told = bare.clone();
        (bare.units, bare.diagonal) = (None, None);
        for (truth, result) in [(&bare, &told), (&told, &bare)] {
            let measures = measure(truth, result).unwrap();
            assert_eq!((measures.units.as_deref(), measures.diagonal), (Some("mm"), 100.0));
        }
        assert!(matches!(measure(&bare, &bare), Err(CompareError::NoDiagonal)));
    }
}
