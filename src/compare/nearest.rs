//! The nearest point of a line: a tree of bounding boxes over its segments.

use nalgebra::{Point3, Vector3};

use super::Polyline;

const LEAF: usize = 8;

/// The nearest point of a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    pub distance: f64,
    /// Radius of the line there; of equally near places the largest, for the lumen is a union.
    pub radius: f64,
}

#[derive(Debug, Clone, Copy)]
struct Segment {
    start: Point3<f64>,
    span: Vector3<f64>,
    radii: [f64; 2],
}

#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Point3<f64>,
    high: Point3<f64>,
}

/// Two children follow one another, or a run of segments is a leaf.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Inner { left: usize },
    Leaf { first: usize, end: usize },
}

#[derive(Debug)]
pub(super) struct SegmentTree {
    segments: Vec<Segment>,
    nodes: Vec<(Bounds, Kind)>,
}

impl SegmentTree {
    /// `None` when there is no segment.
    pub fn new(polylines: &[Polyline]) -> Option<Self> {
        let segment = |polyline: &Polyline, place: usize| Segment {
            start: polyline.points[place],
            span: polyline.points[place + 1] - polyline.points[place],
            radii: [polyline.radii[place], polyline.radii[place + 1]],
        };
        let mut segments = Vec::new();
        for polyline in polylines {
            let count = polyline.points.len().saturating_sub(1);
            segments.extend((0..count).map(|place| segment(polyline, place)));
        }
        if segments.is_empty() {
            return None;
        }
        let mut nodes = Vec::new();
        nodes.push(leaf(&segments, 0, segments.len()));
        let mut place = 0;
        // Breadth first: each node is split in turn, and its children join the end of the queue.
        while place < nodes.len() {
            split(&mut segments, &mut nodes, place);
            place += 1;
        }
        Some(Self { segments, nodes })
    }

    pub fn nearest(&self, point: &Point3<f64>) -> Nearest {
        let mut best = (f64::INFINITY, 0.0_f64);
        let mut stack = vec![(0, self.nodes[0].0.distance_squared(point))];
        while let Some((place, bound)) = stack.pop() {
            if bound > best.0 {
                continue;
            }
            match self.nodes[place].1 {
                Kind::Leaf { first, end } => {
                    for segment in &self.segments[first..end] {
                        best = nearer(best, segment.nearest(point));
                    }
                }
                Kind::Inner { left } => {
                    let mut children =
                        [left, left + 1].map(|child| (child, self.nodes[child].0.distance_squared(point)));
                    // The nearer child is pushed last, so that it is looked at first.
                    children.sort_by(|a, b| b.1.total_cmp(&a.1));
                    stack.extend(children);
                }
            }
        }
        Nearest { distance: best.0.sqrt(), radius: best.1 }
    }
}

/// The nearer of two (squared distance, radius); the larger radius of two that rounding alone parts.
fn nearer(best: (f64, f64), other: (f64, f64)) -> (f64, f64) {
    let slack = 1e-12 * best.0;
    if (other.0 - best.0).abs() <= slack {
        (best.0.min(other.0), best.1.max(other.1))
    } else if other.0 < best.0 {
        other
    } else {
        best
    }
}

fn leaf(segments: &[Segment], first: usize, end: usize) -> (Bounds, Kind) {
    let mut bounds =
        Bounds { low: Point3::from([f64::INFINITY; 3]), high: Point3::from([f64::NEG_INFINITY; 3]) };
    for segment in &segments[first..end] {
        for point in [segment.start, segment.start + segment.span] {
            bounds.low = bounds.low.inf(&point);
            bounds.high = bounds.high.sup(&point);
        }
    }
    (bounds, Kind::Leaf { first, end })
}

/// Splits a leaf with too many segments at the median of their middles along its longest side.
fn split(segments: &mut [Segment], nodes: &mut Vec<(Bounds, Kind)>, place: usize) {
    let (bounds, Kind::Leaf { first, end }) = nodes[place] else { return };
    if end - first <= LEAF {
        return;
    }
    let axis = (bounds.high - bounds.low).imax();
    let middle = |segment: &Segment| segment.start[axis] + 0.5 * segment.span[axis];
    let half = (end - first) / 2;
    segments[first..end].select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
    let left = nodes.len();
    nodes.push(leaf(segments, first, first + half));
    nodes.push(leaf(segments, first + half, end));
    nodes[place].1 = Kind::Inner { left };
}

impl Segment {
    /// Squared distance to `point`, and the radius at the nearest place.
    fn nearest(&self, point: &Point3<f64>) -> (f64, f64) {
        let to = point - self.start;
        let length = self.span.norm_squared();
        let share = if length > 0.0 { (to.dot(&self.span) / length).clamp(0.0, 1.0) } else { 0.0 };
        let radius = self.radii[0] + share * (self.radii[1] - self.radii[0]);
        ((to - self.span * share).norm_squared(), radius)
    }
}

impl Bounds {
    fn distance_squared(&self, point: &Point3<f64>) -> f64 {
        let outside =
            |axis: usize| (self.low[axis] - point[axis]).max(point[axis] - self.high[axis]).max(0.0);
        (0..3).map(|axis| outside(axis).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A knot with radii, in 997 segments.
    fn knot() -> Polyline {
        let angle = |step: u32| f64::from(step) * std::f64::consts::TAU / 997.0;
        let point = |step: u32| {
            let (s, c) = (2.0 * angle(step)).sin_cos();
            let (s3, c3) = (3.0 * angle(step)).sin_cos();
            Point3::new((2.0 + c3) * c, (2.0 + c3) * s, s3)
        };
        let radius = |step: u32| 1.0 + 0.5 * angle(step).sin();
        Polyline { points: (0..=997).map(point).collect(), radii: (0..=997).map(radius).collect() }
    }

    #[test]
    fn the_tree_finds_what_a_look_at_every_segment_finds() {
        let line = [knot()];
        let tree = SegmentTree::new(&line).unwrap();
        for step in 0..500 {
            let t = f64::from(step);
            let point = Point3::new(4.0 * (t * 0.7).sin(), 4.0 * (t * 1.3).cos(), 2.0 * (t * 0.31).sin());
            let best = tree.segments.iter().map(|segment| segment.nearest(&point));
            let expected = best.fold((f64::INFINITY, 0.0), nearer);
            let found = tree.nearest(&point);
            assert!((found.distance - expected.0.sqrt()).abs() < 1e-12);
            assert!((found.radius - expected.1).abs() < 1e-9);
        }
    }

    #[test]
    fn where_lines_meet_the_larger_radius_counts() {
        let joint = Point3::new(1.0, 2.0, 3.0);
        let arm = |x: f64, radius: f64| Polyline {
            points: vec![joint, joint + Vector3::new(x, 0.1 * x * x, 1.0)],
            radii: vec![radius; 2],
        };
        let tree = SegmentTree::new(&[arm(1.0, 0.5), arm(-1.0, 2.0), arm(3.0, 1.0)]).unwrap();
        let below = joint - Vector3::new(0.0, 0.0, 0.25);
        let found = tree.nearest(&below);
        assert_eq!((found.distance, found.radius), (0.25, 2.0));
    }

    #[test]
    fn no_segments_no_tree() {
        assert!(SegmentTree::new(&[]).is_none());
        assert!(SegmentTree::new(&[Polyline { points: vec![Point3::origin()], radii: vec![1.0] }]).is_none());
    }
}
