//! Joint collapse by all the wall around a joint (IV.D, eq. 10): the lumen there is the union of its branches,
//! each swept by spheres along a curve from its last firm section to one centre. Centre and curves are those
//! whose union lies nearest to the vertices (Gauss-Newton with Geman and McClure's robust weights, 1987).
//!
//! No section is needed, so it works up to the centre, where no plane cuts one branch alone.

use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};

use crate::centerline::connection::network::Network;
use crate::centerline::laplacian_smoothing::continuation::Continuation;
use crate::centerline::recentering::approach::{Approach, run_up};
use crate::centerline::recentering::joints::information;
use crate::centerline::recentering::limb::{Foot, Limb};
use crate::centerline::segmentation::track::{Bulge, Sight, Station};
use crate::mesh::preparation::Surface;

/// Vertices taken part in a fit; more say the same.
const MOST_VERTICES: usize = 500;
/// Deviation of the wall from the union that is nothing unusual, and beyond which it is not this joint's, in radii.
const USUAL: f64 = 0.03;
const FOREIGN: f64 = 0.15;
/// Where two branches' walls meet, the crease is rounded: vertices count less that are this near to both, in radii.
const CREASE: f64 = 0.25;
/// Vertices near the first section say little of the way beyond: they count less below this leverage.
const LEVER: f64 = 0.5;
/// Prior deviations: radius at the centre (share), centre from where it was (widest radius).
const RADIUS: f64 = 0.08;
const CENTRE: f64 = 1.0;
/// A branch this far (radii) from the centre hides in a wider one.
const FAR: f64 = 4.0;
const STEPS: usize = 10;
/// Unknowns of a limb: its third control point and its radius at the centre.
const OWN: usize = 4;

/// A joint as found: its centre, and the way of each of its branches.
#[derive(Debug, Clone)]
pub struct FittedJoint {
    pub centre: Point3<f64>,
    pub limbs: Vec<FittedLimb>,
}

/// A branch's way, from the station that it starts at.
#[derive(Debug, Clone)]
pub struct FittedLimb {
    pub track: usize,
    pub at_end: bool,
    /// How many stations at its end toward the joint are replaced.
    pub replaced: usize,
    pub limb: Limb,
    /// Whether nearly all of its way lies inside the other branches: no wall says where it runs.
    pub hidden: bool,
}

/// What the fit starts from.
struct Start {
    limb: Limb,
    line: Continuation,
    /// Deviation of the line's continuation over two thirds of the way.
    doubt: f64,
    /// Triangles at its first section.
    seeds: Vec<u32>,
    tangent: Vector3<f64>,
    hidden: bool,
}

/// Fits the joint of `node`; `None` where a branch has no firm section on the way or the fit runs away.
pub fn fit_joint(surface: &Surface, network: &mut Network, node: usize) -> Option<FittedJoint> {
    let incident = network.incident(node);
    let centre = network.anchor(node)?.point;
    if incident.len() < 3 || incident.len() > 6 {
        return None;
    }
    let (mut starts, mut places, mut balls) = (Vec::new(), Vec::new(), Vec::new());
    let mut approaches = Vec::new();
    let headings = headings(network, &incident);
    for &(track, at_end) in &incident {
        if let Some(bulge) = network.tracks[track].bulge {
            balls.push(bulge);
            approaches.extend(Approach::of(&network.tracks[track], &[]));
            continue;
        }
        let before = run_up(network, track, at_end);
        let near = influence(&headings, headings.iter().position(|h| h.track == (track, at_end))?);
        let inner = !network.is_end(network.tracks[track].from) && !network.is_end(network.tracks[track].to);
        let (start, approach, replaced) = network.oriented(track, at_end, |track| {
            let firm = firm_station(&track.stations, inner, near, &centre)?;
            let approach = Approach::of(&track.up_to(firm), &before)?;
            let replaced = track.stations.len() - 1 - firm;
            Some((start(&track.stations[firm], &approach, &centre)?, approach, replaced))
        })?;
        starts.push(start);
        approaches.push(approach);
        places.push((track, at_end, replaced));
    }
    let wall = wall_around(surface, &starts, &centre);
    let (centre, limbs) = Fit {
        starts: &starts,
        balls: &balls,
        wall: &wall,
        origin: centre,
        lines: information(&approaches, &centre),
    }
    .solve()?;
    let found = limbs.into_iter().zip(places).zip(&starts);
    let fitted = found.map(|((limb, (track, at_end, replaced)), start)| FittedLimb {
        track,
        at_end,
        replaced,
        limb,
        hidden: start.hidden,
    });
    let limbs = fitted.collect();
    Some(FittedJoint { centre, limbs })
}

/// How a branch runs into a joint.
struct Heading {
    track: (usize, bool),
    tangent: Vector3<f64>,
    radius: f64,
}

fn headings(network: &mut Network, incident: &[(usize, bool)]) -> Vec<Heading> {
    let one = |&(track, at_end): &(usize, bool)| {
        network.oriented(track, at_end, |own| {
            let last = own.stations.iter().rev().find(|s| s.sight == Sight::Clean)?;
            let bulge = own.bulge.map(|bulge| bulge.radius);
            let radius = bulge.unwrap_or(last.section_radius);
            Some(Heading { track: (track, at_end), tangent: *last.tangent, radius })
        })
    };
    incident.iter().filter_map(one).collect()
}

/// How far a joint reaches into one of its branches: a radius, or where the branch goes straight on into
/// another, as far as the others' mouths.
fn influence(headings: &[Heading], own: usize) -> f64 {
    /// Cosine of the largest bend, and the largest ratio of radii, of one vessel.
    const STRAIGHT: f64 = 0.8;
    const ALIKE: f64 = 1.35;
    /// A mouth's reach in its branch's radii, and the least in the vessel's.
    const MOUTH: f64 = 2.5;
    const LEAST: f64 = 0.3;
    let one = &headings[own];
    let onward = |other: &Heading| {
        let ratio = other.radius / one.radius;
        -other.tangent.dot(&one.tangent) > STRAIGHT && (1.0 / ALIKE..ALIKE).contains(&ratio)
    };
    let others = || headings.iter().enumerate().filter(|&(i, _)| i != own).map(|(_, other)| other);
    if !others().any(onward) {
        return one.radius;
    }
    let mouths =
        others().filter(|other| !onward(other)).map(|other| MOUTH * other.radius).fold(0.0, f64::max);
    mouths.clamp(LEAST * one.radius, one.radius)
}

/// The last clean station that lies before the joint's reach and not in its mouth. Of a
/// track between two joints the half before the middle is the other's.
///
/// `near`: how far the joint reaches, in the input's unit.
fn firm_station(stations: &[Station], inner: bool, near: f64, centre: &Point3<f64>) -> Option<usize> {
    let before = |s: &Station| (centre - s.point).dot(&s.tangent) > near;
    let first = if inner { stations.len() / 2 } else { 0 };
    let clean: Vec<usize> = (first..stations.len())
        .filter(|&i| stations[i].sight == Sight::Clean && before(&stations[i]))
        .collect();
    let &last = clean.last()?;
    let far = (centre - stations[last].point).norm() > FAR * stations[last].section_radius;
    // The last one feels the mouth; from far off every section counts.
    if far { Some(last) } else { clean.iter().rev().nth(1).copied().or(Some(last)) }
}

fn start(station: &Station, approach: &Approach, centre: &Point3<f64>) -> Option<Start> {
    let radius = station.shape.mean;
    let point = station.point;
    let length = (centre - point).norm();
    let ((_, departure), (_, arrival)) = (approach.line.at(0.0), approach.line.at(length));
    let control = [point, point + departure * (length / 3.0), centre - arrival * (length / 3.0), *centre];
    let seeds = station.seeds?.to_vec();
    let doubt = approach.doubt(2.0 * length / 3.0);
    let positive = radius > 0.0 && length > 0.0;
    let limb = Limb { control, radii: [radius, radius] };
    let hidden = length > FAR * radius;
    positive.then_some(Start { limb, line: approach.line, doubt, seeds, tangent: departure, hidden })
}

/// The vertices of the wall between the limbs' first sections.
fn wall_around(surface: &Surface, starts: &[Start], centre: &Point3<f64>) -> Vec<Point3<f64>> {
    /// Reach of a first section's plane, in its radii.
    const ACROSS: f64 = 2.2;
    let reach = starts
        .iter()
        .map(|start| (start.limb.control[0] - centre).norm() + 2.0 * start.limb.radii[0])
        .fold(0.0, f64::max);
    let inside = |p: &Point3<f64>| {
        (p - centre).norm() < reach
            && starts.iter().all(|start| {
                let away = p - start.limb.control[0];
                away.norm() > ACROSS * start.limb.radii[0] || away.dot(&start.tangent) >= 0.0
            })
    };
    let mut found: Vec<u32> = starts
        .iter()
        .flat_map(|start| &start.seeds)
        .flat_map(|&t| surface.mesh.triangles[t as usize])
        .filter(|&v| inside(&surface.mesh.vertices[v as usize]))
        .collect();
    found.sort_unstable();
    found.dedup();
    let mut seen: std::collections::HashSet<u32> = found.iter().copied().collect();
    let mut next = 0;
    while let Some(&v) = found.get(next) {
        next += 1;
        for u in surface.corners.neighbours(v) {
            if inside(&surface.mesh.vertices[u as usize]) && seen.insert(u) {
                found.push(u);
            }
        }
    }
    let stride = found.len().div_ceil(MOST_VERTICES).max(1);
    found.iter().step_by(stride).map(|&v| surface.mesh.vertices[v as usize]).collect()
}

/// The least squares problem. Unknowns: the centre, then of each limb its third control point and its
/// radius at the centre.
struct Fit<'a> {
    starts: &'a [Start],
    balls: &'a [Bulge],
    wall: &'a [Point3<f64>],
    origin: Point3<f64>,
    /// What the branches' lines say of the centre: matrix and right side.
    lines: (Matrix3<f64>, Vector3<f64>),
}

struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    cost: f64,
}

impl Fit<'_> {
    fn solve(&self) -> Option<(Point3<f64>, Vec<Limb>)> {
        let mut limbs: Vec<Limb> = self.starts.iter().map(|start| start.limb).collect();
        let mut normal = self.normal(&limbs);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let mut matrix = normal.matrix.clone();
            for i in 0..matrix.nrows() {
                matrix[(i, i)] *= 1.0 + damping;
            }
            let step = matrix.cholesky()?.solve(&normal.right);
            let moved = self.moved(&limbs, &step);
            let after = self.normal(&moved);
            if after.cost < normal.cost {
                let still = normal.cost - after.cost < 1e-6 * normal.cost;
                (limbs, normal, damping) = (moved, after, damping * 0.3);
                if still {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        let centre = limbs.first()?.control[3];
        let widest = limbs.iter().map(|limb| limb.radii[0]).fold(0.0, f64::max);
        let sound = (centre - self.origin).norm() < 2.0 * widest
            && limbs
                .iter()
                .all(|limb| limb.radii[1] > 0.5 * limb.radii[0] && limb.radii[1] < 1.6 * limb.radii[0]);
        sound.then_some((centre, limbs))
    }

    fn moved(&self, limbs: &[Limb], step: &DVector<f64>) -> Vec<Limb> {
        let vector = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
        let mut moved = limbs.to_vec();
        for (number, limb) in moved.iter_mut().enumerate() {
            let at = 3 + OWN * number;
            limb.control[3] += vector(0);
            limb.control[2] += vector(at);
            limb.radii[1] += step[at + 3];
        }
        moved
    }

    fn normal(&self, limbs: &[Limb]) -> Normal {
        let count = 3 + OWN * limbs.len();
        let mut normal =
            Normal { matrix: DMatrix::zeros(count, count), right: DVector::zeros(count), cost: 0.0 };
        self.add_wall(limbs, &mut normal);
        self.add_priors(limbs, &mut normal);
        normal
    }

    /// The distances of the wall's vertices from the union.
    fn add_wall(&self, limbs: &[Limb], normal: &mut Normal) {
        let pieces: Vec<_> = limbs.iter().map(Limb::pieces).collect();
        for vertex in self.wall {
            let mut feet: Vec<(usize, Foot)> = limbs
                .iter()
                .zip(&pieces)
                .map(|(limb, pieces)| limb.foot(pieces, vertex))
                .enumerate()
                .collect();
            feet.sort_by(|a, b| a.1.outside.total_cmp(&b.1.outside));
            let [(number, foot), (_, second), ..] = feet[..] else { return };
            let in_ball = |ball: &Bulge| (vertex - ball.centre).norm() - ball.radius < foot.outside;
            if self.balls.iter().any(in_ball) {
                continue;
            }
            if self.starts[number].hidden {
                continue;
            }
            let radius = limbs[number].radii[0];
            let foreign = foot.outside / (FOREIGN * radius);
            let share = 1.0 / (1.0 + foreign * foreign);
            let basis = Limb::basis(foot.t);
            let trust = ((second.outside - foot.outside) / (CREASE * radius)).min(1.0)
                * ((basis[2] + basis[3]) / LEVER).min(1.0).powi(4)
                / (USUAL * radius).powi(2);
            let weight = share * share * trust;
            normal.cost += share * foot.outside * foot.outside * trust;
            let at = 3 + OWN * number;
            let mut row = [(0, 0.0); 7];
            for axis in 0..3 {
                row[axis] = (axis, -basis[3] * foot.direction[axis]);
                row[3 + axis] = (at + axis, -basis[2] * foot.direction[axis]);
            }
            row[6] = (at + 3, -foot.t);
            normal.add(&row, foot.outside, weight);
        }
    }

    /// What is expected without the wall: evenly bent curves that continue their lines, radii that stay.
    fn add_priors(&self, limbs: &[Limb], normal: &mut Normal) {
        const PLACE: f64 = 2.0 / 3.0;
        /// Deviation of the curvature at the centre, per radius.
        const BEND: f64 = 0.25;
        let widest = limbs.iter().map(|limb| limb.radii[0]).fold(0.0, f64::max);
        let Some(centre) = limbs.first().map(|limb| limb.control[3]) else { return };
        let hold = 1.0 / (CENTRE * widest).powi(2);
        for axis in 0..3 {
            normal.add_square(&[(axis, 1.0)], centre[axis] - self.origin[axis], hold);
        }
        let (lines, pull) = &self.lines;
        let off =
            lines.pseudo_inverse(1e-12).map_or(Vector3::zeros(), |inverse| centre.coords - inverse * pull);
        normal.add_block(3, 0.0, 1.0, lines, &off);
        for (number, (limb, start)) in limbs.iter().zip(self.starts).enumerate() {
            let (at, radius) = (3 + OWN * number, limb.radii[0]);
            let grown = limb.radii[1] - start.limb.radii[1];
            normal.add_square(&[(at + 3, 1.0)], grown, 1.0 / (RADIUS * radius).powi(2));
            let length = limb.length();
            let (expected, along) = start.line.at(PLACE * length);
            let off = limb.at(PLACE) - expected;
            let across =
                (Matrix3::identity() - along * along.transpose() * 0.9) / (start.doubt * start.doubt);
            let basis = Limb::basis(PLACE);
            // What no wall holds does not pull at the centre: the lines do that.
            let shared = if start.hidden { 0.0 } else { 1.0 };
            normal.add_block(at, basis[2], shared * basis[3], &across, &off);
            let bend = limb.control[1] - limb.control[2] * 2.0 + limb.control[3].coords;
            let scale = 6.0 * radius / (length * length * BEND);
            normal.add_block(at, -2.0, shared, &(Matrix3::identity() * (scale * scale)), &bend);
        }
    }
}

impl Normal {
    /// A residual with its derivatives by some unknowns.
    fn add(&mut self, row: &[(usize, f64)], residual: f64, weight: f64) {
        for &(i, a) in row {
            self.right[i] -= weight * a * residual;
            for &(j, b) in row {
                self.matrix[(i, j)] += weight * a * b;
            }
        }
    }

    fn add_square(&mut self, row: &[(usize, f64)], residual: f64, weight: f64) {
        self.cost += weight * residual * residual;
        self.add(row, residual, weight);
    }

    /// A vector residual that moves with a limb's third control point (`own`) and with the centre (`shared`).
    fn add_block(
        &mut self,
        at: usize,
        own: f64,
        shared: f64,
        weight: &Matrix3<f64>,
        residual: &Vector3<f64>,
    ) {
        self.cost += residual.dot(&(weight * residual));
        let pull = weight * residual;
        for i in 0..3 {
            self.right[at + i] -= own * pull[i];
            self.right[i] -= shared * pull[i];
            for j in 0..3 {
                let value = weight[(i, j)];
                self.matrix[(at + i, at + j)] += own * own * value;
                self.matrix[(i, j)] += shared * shared * value;
                self.matrix[(at + i, j)] += own * shared * value;
                self.matrix[(i, at + j)] += own * shared * value;
            }
        }
    }
}
