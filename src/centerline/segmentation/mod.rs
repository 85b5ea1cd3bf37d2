//! Fuzzy K-means segmentation of the surface into branches on geodesic distance (IV.A, eqs. 1-3).

pub mod level_sets;
pub mod track;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::centerline::control::{Control, Stage};
use crate::centerline::tips::geodesic::{EdgeGraph, geodesic};
use crate::centerline::{CancelToken, ExtractError};

/// Geodesic distance of every vertex from one centre, in the input's unit.
pub type DistanceField = Vec<f32>;

/// The relocation of the centres stops here even if they still move.
const MOST_ITERATIONS: usize = 24;

/// The surface in segments.
#[derive(Debug, Clone, PartialEq)]
pub struct Segmentation {
    /// Per vertex, the segment of its largest probability.
    pub segment: Vec<u32>,
    /// Per segment, the vertex at its centre.
    pub centres: Vec<u32>,
    /// The objective (eq. 2) before each relocation.
    pub objective: Vec<f64>,
    /// Whether no centre moved at the end; else a cycle or the bound ended it.
    pub settled: bool,
}

/// `base^exponent`, without the cost of a general power for the printed `m = 2`.
#[inline]
pub(in crate::centerline) fn power(base: f64, exponent: f64) -> f64 {
    if exponent == -2.0 { 1.0 / (base * base) } else { base.powf(exponent) }
}

/// Geodesic distances from each of `centres`, one Dijkstra run each, in parallel.
pub fn distance_fields(
    graph: &EdgeGraph,
    centres: &[u32],
    cancel: &CancelToken,
) -> Result<Vec<DistanceField>, ExtractError> {
    let field = |&centre: &u32| {
        let reached = geodesic(graph, &[centre], cancel)?;
        Ok(reached.distance.into_iter().map(|d| d as f32).collect())
    };
    centres.par_iter().map(field).collect()
}

/// The clustering from its first centres `seeds`, whose distances are `fields`.
///
/// A vertex belongs to a cluster where its probability (eq. 1) exceeds `mu`; the others form the fuzzy area,
/// whose centre seeds one more cluster. Centres move (eq. 3) until none does. Eq. 3 is a Euclidean mean off
/// the surface: the cluster's vertex nearest to it is the centre. Each segment holds the vertices that it is
/// the likeliest for, and hangs together. `O(K n)` an iteration, and a Dijkstra run for each centre that moves.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn segment(
    positions: &[Point3<f64>],
    graph: &EdgeGraph,
    seeds: &[u32],
    fields: Vec<DistanceField>,
    (m, mu): (f64, f64),
    control: &Control<'_>,
) -> Result<Segmentation, ExtractError> {
    let mut clusters = Clusters { positions, centres: seeds.to_vec(), fields, m, mu };
    let mut objective = Vec::new();
    let mut before: Vec<Vec<u32>> = Vec::new();
    let mut settled = false;
    let mut grown = false;
    for iteration in 0..MOST_ITERATIONS {
        control.report(Stage::Segmentation, iteration as f64 / MOST_ITERATIONS as f64)?;
        let mut strengths = clusters.strengths(&control.cancel)?;
        if !grown {
            grown = true;
            if let Some(centre) = clusters.fuzzy_centre(&strengths) {
                let field = distance_fields(graph, &[centre], &control.cancel)?;
                clusters.centres.push(centre);
                clusters.fields.extend(field);
                strengths = clusters.strengths(&control.cancel)?;
            }
        }
        control.cancel.check()?;
        objective.push(clusters.objective(&strengths));
        let moved = clusters.relocated(&strengths, &control.cancel)?;
        if moved == clusters.centres {
            settled = true;
            break;
        }
        if before.contains(&moved) {
            break;
        }
        let changed: Vec<usize> = (0..moved.len()).filter(|&j| moved[j] != clusters.centres[j]).collect();
        let from: Vec<u32> = changed.iter().map(|&j| moved[j]).collect();
        for (j, field) in changed.into_iter().zip(distance_fields(graph, &from, &control.cancel)?) {
            clusters.fields[j] = field;
        }
        before.push(std::mem::replace(&mut clusters.centres, moved));
    }
    let segment = clusters.strengths(&control.cancel)?.into_iter().map(|strength| strength.nearest).collect();
    control.report(Stage::Segmentation, 1.0)?;
    Ok(Segmentation { segment, centres: clusters.centres, objective, settled })
}

/// Eq. 1, `u_ij = [sum_t (d(i, j) / d(i, t))^(2 / (m - 1))]^-1`, short of the whole row of a vertex's probabilities.
///
/// A vertex at a centre (distance 0) belongs to it, in equal parts to several.
#[derive(Debug, Clone, Copy)]
struct Strength {
    /// The cluster of the largest probability: that of the nearest centre.
    nearest: u32,
    /// Distance from it.
    distance: f64,
    /// `sum_t (d_nearest / d_t)^p`: the largest probability is its inverse.
    crowd: f64,
}

impl Strength {
    /// `u_ij` of eq. 1 for a centre at `distance`, with `p = 2 / (m - 1)`.
    fn probability(&self, distance: f64, p: f64) -> f64 {
        if self.distance == 0.0 {
            return if distance == 0.0 { 1.0 / self.crowd } else { 0.0 };
        }
        power(distance / self.distance, -p) / self.crowd
    }
}

struct Clusters<'a> {
    positions: &'a [Point3<f64>],
    centres: Vec<u32>,
    fields: Vec<DistanceField>,
    m: f64,
    mu: f64,
}

impl Clusters<'_> {
    fn exponent(&self) -> f64 {
        2.0 / (self.m - 1.0)
    }

    fn strengths(&self, cancel: &CancelToken) -> Result<Vec<Strength>, ExtractError> {
        let p = self.exponent();
        let one = |i: usize| {
            let distance = |j: usize| f64::from(self.fields[j][i]);
            let nearest =
                (1..self.fields.len()).fold(0, |best, j| if distance(j) < distance(best) { j } else { best });
            let least = distance(nearest);
            let share = |d: f64| match least == 0.0 {
                true => f64::from(u8::from(d == 0.0)),
                false => power(d / least, -p),
            };
            let crowd = (0..self.fields.len()).map(|j| share(distance(j))).sum();
            Strength { nearest: nearest as u32, distance: least, crowd }
        };
        cancel.check()?;
        Ok((0..self.positions.len()).into_par_iter().map(one).collect())
    }

    /// Eq. 2: `J = sum u² d`.
    fn objective(&self, strengths: &[Strength]) -> f64 {
        let p = self.exponent();
        let of = |field: &DistanceField| -> f64 {
            let terms = field.iter().zip(strengths);
            terms.map(|(&d, s)| s.probability(f64::from(d), p).powi(2) * f64::from(d)).sum()
        };
        let each: Vec<f64> = self.fields.par_iter().map(of).collect();
        each.iter().sum()
    }

    /// The fuzzy area's vertex nearest to its mean; `None` where every vertex belongs to a cluster.
    fn fuzzy_centre(&self, strengths: &[Strength]) -> Option<u32> {
        let fuzzy: Vec<u32> =
            (0..strengths.len() as u32).filter(|&i| 1.0 / strengths[i as usize].crowd <= self.mu).collect();
        let sum: Vector3<f64> = fuzzy.iter().map(|&i| self.positions[i as usize].coords).sum();
        self.nearest(fuzzy.iter().copied(), &Point3::from(sum / fuzzy.len().max(1) as f64))
    }

    /// Eq. 3 for each centre, taken to the nearest vertex of its cluster.
    fn relocated(&self, strengths: &[Strength], cancel: &CancelToken) -> Result<Vec<u32>, ExtractError> {
        let p = self.exponent();
        let one = |j: usize| {
            cancel.check()?;
            let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
            for (i, strength) in strengths.iter().enumerate() {
                let u = strength.probability(f64::from(self.fields[j][i]), p);
                sum += self.positions[i].coords * u;
                weight += u;
            }
            let mean = Point3::from(sum / weight);
            let own = |i: &u32| strengths[*i as usize].nearest == j as u32;
            let sure = |i: &u32| own(i) && 1.0 / strengths[*i as usize].crowd > self.mu;
            let vertices = 0..strengths.len() as u32;
            let centre = self.nearest(vertices.clone().filter(sure), &mean);
            Ok(centre.or_else(|| self.nearest(vertices.filter(own), &mean)).unwrap_or(self.centres[j]))
        };
        (0..self.centres.len()).into_par_iter().map(one).collect()
    }

    fn nearest(&self, vertices: impl Iterator<Item = u32>, goal: &Point3<f64>) -> Option<u32> {
        let distance = |i: &u32| (self.positions[*i as usize] - goal).norm_squared();
        vertices.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::shapes::torus;
    use crate::centerline::test_surfaces::{capsule, closed_surface};
    use crate::mesh::preparation::Surface;

    fn clustered(surface: &Surface, seeds: &[u32], m: f64, mu: f64) -> Segmentation {
        let graph = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let fields = distance_fields(&graph, seeds, &CancelToken::new()).unwrap();
        segment(&surface.mesh.vertices, &graph, seeds, fields, (m, mu), &Control::silent()).unwrap()
    }

    fn extreme(surface: &Surface, sign: f64) -> u32 {
        let z = |v: &u32| sign * surface.mesh.vertices[*v as usize].z;
        (0..surface.mesh.vertices.len() as u32).max_by(|a, b| z(a).total_cmp(&z(b))).unwrap()
    }

    /// The row of a vertex at these distances from the centres.
    fn memberships(distances: &[f64], m: f64) -> Vec<f64> {
        let clusters = Clusters {
            positions: &[Point3::origin()],
            centres: vec![0; distances.len()],
            fields: distances.iter().map(|&d| vec![d as f32]).collect(),
            m,
            mu: 0.5,
        };
        let strength = clusters.strengths(&CancelToken::new()).unwrap()[0];
        distances.iter().map(|&d| strength.probability(f64::from(d as f32), clusters.exponent())).collect()
    }

    #[test]
    fn probabilities_are_eq_1_and_sum_to_one() {
        let row = memberships(&[1.0, 2.0, 4.0], 2.0);
        for (u, expected) in row.iter().zip([16.0 / 21.0, 4.0 / 21.0, 1.0 / 21.0]) {
            assert!((u - expected).abs() < 1e-12);
        }
        for m in [1.1, 1.5, 2.0, 5.0] {
            for distances in [[1e-9, 3.0, 1e6], [2.0, 2.0, 2.0], [0.0, 1.0, 2.0], [0.0, 0.0, 1.0]] {
                let row = memberships(&distances, m);
                assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{distances:?}, m = {m}: {row:?}");
            }
        }
        assert_eq!(memberships(&[0.0, 0.0, 1.0], 2.0), [0.5, 0.5, 0.0]);
    }

    #[test]
    fn probabilities_are_what_the_printed_formula_gives() {
        for m in [1.3, 2.0, 3.5] {
            let distances = [5.0, 3.0, 0.25, 40.0];
            for (j, u) in memberships(&distances, m).iter().enumerate() {
                let ratio = |t: &f64| (distances[j] / t).powf(2.0 / (m - 1.0));
                let printed = 1.0 / distances.iter().map(ratio).sum::<f64>();
                assert!((u - printed).abs() < 1e-9, "{u} {printed}");
            }
        }
    }

    #[test]
    fn a_tube_seeded_at_its_ends_falls_into_balanced_halves() {
        let surface = closed_surface(&capsule(1.0, 20.0, 16));
        let seeds = [extreme(&surface, -1.0), extreme(&surface, 1.0)];
        let result = clustered(&surface, &seeds, 2.0, 0.5);
        assert!(result.settled, "centres moved {} times", result.objective.len());
        let size = |j: u32| result.segment.iter().filter(|&&s| s == j).count();
        assert!(result.centres.len() <= 3);
        assert!(size(0).abs_diff(size(1)) * 10 < surface.mesh.vertices.len(), "{} {}", size(0), size(1));
        // The centres came in from the tips.
        let z = |j: usize| surface.mesh.vertices[result.centres[j] as usize].z;
        assert!(z(0) > 0.5 && z(1) < 19.5, "{} {}", z(0), z(1));
    }

    #[test]
    fn the_fuzzy_area_of_a_high_threshold_seeds_one_more_cluster() {
        let surface = closed_surface(&capsule(1.0, 20.0, 16));
        let seeds = [extreme(&surface, -1.0), extreme(&surface, 1.0)];
        let result = clustered(&surface, &seeds, 2.0, 0.9);
        assert_eq!(result.centres.len(), 3);
        let middle = surface.mesh.vertices[result.centres[2] as usize].z;
        assert!((middle - 10.0).abs() < 3.0, "{middle}");
    }

    #[test]
    fn every_segment_hangs_together() {
        let surface = closed_surface(&torus(6.0, 1.0, 80, 14));
        let graph = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let result = clustered(&surface, &[0, 400, 900], 2.0, 0.5);
        for j in 0..result.centres.len() as u32 {
            let members: Vec<u32> =
                (0..result.segment.len() as u32).filter(|&v| result.segment[v as usize] == j).collect();
            let mut seen = vec![false; result.segment.len()];
            let mut queue = vec![members[0]];
            seen[members[0] as usize] = true;
            let mut count = 0;
            while let Some(v) = queue.pop() {
                count += 1;
                for &(u, _) in graph.neighbours(v) {
                    if result.segment[u as usize] == j && !std::mem::replace(&mut seen[u as usize], true) {
                        queue.push(u);
                    }
                }
            }
            assert_eq!(count, members.len(), "segment {j}");
        }
    }
}
