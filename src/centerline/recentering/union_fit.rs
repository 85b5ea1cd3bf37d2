//! The union of swept spheres that lies nearest to the wall around a joint: least squares over the joint's centre and
//! the curves of its branches, with robust weights (Geman and McClure 1987).
//!
//! Which branch a vertex belongs to, and how far it is to be trusted, is settled at the start of each round; what is left
//! is one sum of squares, which Levenberg's and Marquardt's method makes least.

use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};

use crate::centerline::laplacian_smoothing::continuation::Continuation;
use crate::centerline::recentering::limb::{Foot, Limb, LimbWall};
use crate::centerline::segment::from_segment;
use crate::centerline::segmentation::track::Bulge;

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
const ROUNDS: usize = 3;
/// Steps of a round; of the last, whose result stays, more.
const STEPS: usize = 2;
const LAST_STEPS: usize = 8;
/// A step so small (widest radius) is none.
const STILL: f64 = 1e-10;
/// Unknowns of a limb: its third control point and its radius at the centre.
const OWN: usize = 4;

/// A branch at its last firm section.
pub struct Start {
    /// Its way to the centre as its line alone tells it.
    pub limb: Limb,
    pub line: Continuation,
    /// Deviation of the line's continuation over two thirds of the way, in the input's unit.
    pub doubt: f64,
    /// Triangles at its first section.
    pub seeds: Vec<u32>,
    /// Inscribed radius over mean radius of its first section.
    pub inscribed: f64,
    /// Whether it hides in a wider branch: no wall says where it runs.
    pub hidden: bool,
}

impl Start {
    /// Unit direction in which it leaves its first section.
    pub fn tangent(&self) -> Vector3<f64> {
        self.line.at(0.0).1
    }
}

/// The least squares problem. Unknowns: the centre, then of each limb its third control point and its
/// radius at the centre.
pub struct UnionFit<'a> {
    pub starts: &'a [Start],
    /// Sacs: their wall and their stalks' are not the branches'.
    pub balls: &'a [Bulge],
    /// Vertices of the wall around the joint.
    pub wall: &'a [Point3<f64>],
    /// Where the centre was.
    pub origin: Point3<f64>,
    /// What the branches' lines say of the centre: matrix and right side.
    pub lines: (Matrix3<f64>, Vector3<f64>),
}

/// A vertex of a limb's wall.
struct Share {
    vertex: Point3<f64>,
    limb: usize,
    /// Where along it.
    t: f64,
    trust: f64,
}

/// Normal equations of one limb's wall: the centre's three unknowns, then the limb's own.
#[derive(Clone, Default)]
struct Block {
    matrix: [[f64; 3 + OWN]; 3 + OWN],
    right: [f64; 3 + OWN],
}

impl Block {
    /// A residual with its derivatives by the unknowns.
    fn add(&mut self, row: &[f64; 3 + OWN], residual: f64, weight: f64) {
        for (i, a) in row.map(|a| weight * a).into_iter().enumerate() {
            self.right[i] -= a * residual;
            self.matrix[i].iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
        }
    }
}

struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    cost: f64,
}

impl UnionFit<'_> {
    /// The centre and the branches' ways; `None` when the fit runs away. O(rounds x vertices x branches).
    pub fn solve(&self) -> Option<(Point3<f64>, Vec<Limb>)> {
        let mut limbs: Vec<Limb> = self.starts.iter().map(|start| start.limb).collect();
        let widest = limbs.iter().map(|limb| limb.radii[0]).fold(0.0, f64::max);
        for round in 1..=ROUNDS {
            let shares = self.shares(&limbs);
            let steps = if round < ROUNDS { STEPS } else { LAST_STEPS };
            limbs = self.descend(limbs, &shares, steps, STILL * widest)?;
        }
        let centre = limbs.first()?.control[3];
        let sound = (centre - self.origin).norm() < 2.0 * widest
            && limbs
                .iter()
                .all(|limb| limb.radii[1] > 0.5 * limb.radii[0] && limb.radii[1] < 1.6 * limb.radii[0]);
        sound.then_some((centre, limbs))
    }

    /// Levenberg and Marquardt's steps, until they are smaller than `still`.
    fn descend(&self, mut limbs: Vec<Limb>, shares: &[Share], steps: usize, still: f64) -> Option<Vec<Limb>> {
        let mut normal = self.normal(&limbs, shares);
        let mut damping = 1e-4;
        for _ in 0..steps {
            let mut matrix = normal.matrix.clone();
            for i in 0..matrix.nrows() {
                matrix[(i, i)] *= 1.0 + damping;
            }
            let step = matrix.cholesky()?.solve(&normal.right);
            let moved = self.moved(&limbs, &step);
            let after = self.normal(&moved, shares);
            if after.cost < normal.cost {
                (limbs, normal, damping) = (moved, after, damping * 0.1);
            } else {
                damping *= 10.0;
            }
            if step.amax() < still {
                break;
            }
        }
        Some(limbs)
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

    fn normal(&self, limbs: &[Limb], shares: &[Share]) -> Normal {
        let count = 3 + OWN * limbs.len();
        let mut normal =
            Normal { matrix: DMatrix::zeros(count, count), right: DVector::zeros(count), cost: 0.0 };
        self.add_wall(limbs, shares, &mut normal);
        self.add_priors(limbs, &mut normal);
        normal
    }

    /// Whose wall each vertex is, and how far that is to be trusted.
    fn shares(&self, limbs: &[Limb]) -> Vec<Share> {
        let walls: Vec<LimbWall> = limbs.iter().map(Limb::wall).collect();
        let share = |vertex: &Point3<f64>| {
            let feet = walls.iter().map(|wall| wall.foot(vertex, 0.5));
            let (limb, foot, second) = nearest_two(feet)?;
            let radius = limbs[limb].radii[0];
            // Where two walls meet, sacs' too, the nearer is not surely the vertex's own.
            let balls = self.balls.iter().map(|ball| self.outside_of(ball, vertex));
            let second = balls.fold(second, f64::min);
            let apart = ((second - foot.outside) / (CREASE * radius)).clamp(0.0, 1.0);
            let lever = ((foot.basis[2] + foot.basis[3]) / LEVER).min(1.0).powi(4);
            let trust = apart * lever / (USUAL * radius).powi(2);
            let t = foot.t;
            (!self.starts[limb].hidden && trust > 0.0).then_some(Share { vertex: *vertex, limb, t, trust })
        };
        self.wall.iter().filter_map(share).collect()
    }

    /// How far a point is outside of a sac and of the straight stalk from where the joint was.
    fn outside_of(&self, sac: &Bulge, point: &Point3<f64>) -> f64 {
        let outside = (point - sac.centre).norm() - sac.radius;
        let Some(neck) = sac.neck.filter(|neck| neck.stalk > 0.0) else { return outside };
        outside.min(from_segment(point, &sac.centre, &self.origin) - neck.stalk)
    }

    /// The distances of the wall's vertices from their limbs.
    fn add_wall(&self, limbs: &[Limb], shares: &[Share], normal: &mut Normal) {
        let walls: Vec<LimbWall> = limbs.iter().map(Limb::wall).collect();
        let mut blocks = vec![Block::default(); limbs.len()];
        for &Share { vertex, limb, t, trust } in shares {
            let foot = walls[limb].foot_near(&vertex, t);
            let foreign = foot.outside / (FOREIGN * limbs[limb].radii[0]);
            let usual = 1.0 / (1.0 + foreign * foreign);
            normal.cost += usual * foot.outside * foot.outside * trust;
            let centre = foot.direction * -foot.basis[3];
            let own = foot.direction * -foot.basis[2];
            let row = [centre.x, centre.y, centre.z, own.x, own.y, own.z, -foot.t];
            blocks[limb].add(&row, foot.outside, usual * usual * trust);
        }
        for (limb, block) in blocks.iter().enumerate() {
            normal.add_limb(3 + OWN * limb, block);
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
            normal.add_square(axis, centre[axis] - self.origin[axis], hold);
        }
        let (lines, pull) = &self.lines;
        let off = lines
            .pseudo_inverse(1e-12 * lines.norm())
            .map_or(Vector3::zeros(), |inverse| centre.coords - inverse * pull);
        normal.add_block(3, 0.0, 1.0, lines, &off);
        for (number, (limb, start)) in limbs.iter().zip(self.starts).enumerate() {
            let (at, radius) = (3 + OWN * number, limb.radii[0]);
            let grown = limb.radii[1] - start.limb.radii[1];
            normal.add_square(at + 3, grown, 1.0 / (RADIUS * radius).powi(2));
            // What no wall holds has no part in the fit: it pulls at nothing.
            if start.hidden {
                let still = limb.control[2] - start.limb.control[2];
                normal.add_block(at, 1.0, 0.0, &(Matrix3::identity() / (radius * radius)), &still);
                continue;
            }
            let length = start.limb.length();
            let (expected, along) = start.line.at(PLACE * length);
            let off = limb.at(PLACE) - expected;
            let across =
                (Matrix3::identity() - along * along.transpose() * 0.9) / (start.doubt * start.doubt);
            let basis = Limb::basis(PLACE);
            normal.add_block(at, basis[2], basis[3], &across, &off);
            let bend = limb.control[1] - limb.control[2] * 2.0 + limb.control[3].coords;
            let scale = 6.0 * radius / (length * length * BEND);
            normal.add_block(at, -2.0, 1.0, &(Matrix3::identity() * (scale * scale)), &bend);
        }
    }
}

/// The foot of the nearest limb with its number, and how far the point is outside of the next one's wall.
fn nearest_two(feet: impl Iterator<Item = Foot>) -> Option<(usize, Foot, f64)> {
    let mut nearest: Option<(usize, Foot)> = None;
    let mut second = f64::INFINITY;
    for (number, foot) in feet.enumerate() {
        match nearest {
            Some((_, least)) if foot.outside >= least.outside => second = second.min(foot.outside),
            _ => {
                second = nearest.map_or(second, |(_, least)| least.outside);
                nearest = Some((number, foot));
            }
        }
    }
    nearest.map(|(number, foot)| (number, foot, second))
}

impl Normal {
    /// The wall of the limb whose own unknowns start at `at`.
    fn add_limb(&mut self, at: usize, block: &Block) {
        let place = |i: usize| if i < 3 { i } else { at + i - 3 };
        for (i, row) in block.matrix.iter().enumerate() {
            self.right[place(i)] += block.right[i];
            for (j, value) in row.iter().enumerate() {
                self.matrix[(place(i), place(j))] += value;
            }
        }
    }

    /// A residual that is the unknown `at` itself.
    fn add_square(&mut self, at: usize, residual: f64, weight: f64) {
        self.cost += weight * residual * residual;
        self.right[at] -= weight * residual;
        self.matrix[(at, at)] += weight;
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
