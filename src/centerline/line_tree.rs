//! The segments of a line in a tree of boxes, in the order of the line itself.

use nalgebra::Point3;

use crate::centerline::component::ComponentGraph;

/// Segments in one leaf.
const LEAF: usize = 8;

/// A piece of a branch between two of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    pub ends: [Point3<f64>; 2],
    pub radii: [f64; 2],
    pub branch: usize,
    /// Number of its first point in the branch.
    pub place: usize,
    /// Way along the branch to its first point.
    pub along: f64,
}

impl Segment {
    pub fn length(&self) -> f64 {
        (self.ends[1] - self.ends[0]).norm()
    }

    /// The point nearest to `to`, and the radius there.
    pub fn nearest(&self, to: &Point3<f64>) -> (Point3<f64>, f64) {
        let way = self.ends[1] - self.ends[0];
        let share = (to - self.ends[0]).dot(&way) / way.norm_squared();
        // Of a segment without length, its first point.
        let share = if share > 0.0 { share.min(1.0) } else { 0.0 };
        (self.ends[0] + way * share, self.radii[0] + (self.radii[1] - self.radii[0]) * share)
    }

    /// Distance from a point, in radii of the line at the place nearest to it.
    pub fn share(&self, from: &Point3<f64>) -> f64 {
        let (point, radius) = self.nearest(from);
        (from - point).norm() / radius
    }

    fn widest(&self) -> f64 {
        self.radii[0].max(self.radii[1])
    }
}

/// A box around segments, with the greatest of their radii.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Point3<f64>,
    high: Point3<f64>,
    radius: f64,
}

impl Bounds {
    fn of(segments: &[Segment]) -> Self {
        let first = Segment { ..segments[0] };
        let mut bounds = Self { low: first.ends[0], high: first.ends[0], radius: 0.0 };
        for segment in segments {
            for end in &segment.ends {
                (bounds.low, bounds.high) = (bounds.low.inf(end), bounds.high.sup(end));
            }
            bounds.radius = bounds.radius.max(segment.widest());
        }
        bounds
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            low: self.low.inf(&other.low),
            high: self.high.sup(&other.high),
            radius: self.radius.max(other.radius),
        }
    }

    fn distance(&self, point: &Point3<f64>) -> f64 {
        let off = |axis: usize| (self.low[axis] - point[axis]).max(point[axis] - self.high[axis]).max(0.0);
        (off(0) * off(0) + off(1) * off(1) + off(2) * off(2)).sqrt()
    }
}

/// Boxes over neighbours along the line, pairs of them, and so on. Building takes O(segments).
#[derive(Debug, Clone)]
pub struct LineTree {
    segments: Vec<Segment>,
    /// The boxes of the leaves, of pairs of leaves, and so on up to one.
    levels: Vec<Vec<Bounds>>,
}

impl LineTree {
    pub fn new(graph: &ComponentGraph) -> Self {
        let mut segments = Vec::new();
        for (number, branch) in graph.branches.iter().enumerate() {
            let mut along = 0.0;
            for (place, (ends, radii)) in branch.points.windows(2).zip(branch.radii.windows(2)).enumerate() {
                let segment = Segment {
                    ends: [ends[0], ends[1]],
                    radii: [radii[0], radii[1]],
                    branch: number,
                    place,
                    along,
                };
                along += segment.length();
                segments.push(segment);
            }
        }
        let mut levels = vec![segments.chunks(LEAF).map(Bounds::of).collect::<Vec<_>>()];
        while let Some(below) = levels.last().filter(|below| below.len() > 1) {
            let pair = |two: &[Bounds]| two[1..].iter().fold(two[0], |sum, other| sum.with(other));
            let above = below.chunks(2).map(pair).collect();
            levels.push(above);
        }
        Self { segments, levels }
    }

    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Whether `test` holds for any segment whose box lies nearer to a point than `reach` and `radii` of its
    /// widest radius together; the first found ends the search.
    pub fn any_near(
        &self,
        point: &Point3<f64>,
        reach: f64,
        radii: f64,
        mut test: impl FnMut(usize, &Segment) -> bool,
    ) -> bool {
        let near = |bounds: &Bounds| bounds.distance(point) <= reach + radii * bounds.radius;
        self.descend(self.levels.len() - 1, 0, &near, &mut test)
    }

    fn descend(
        &self,
        level: usize,
        place: usize,
        near: &impl Fn(&Bounds) -> bool,
        test: &mut impl FnMut(usize, &Segment) -> bool,
    ) -> bool {
        match self.levels[level].get(place) {
            Some(bounds) if near(bounds) => {}
            _ => return false,
        }
        if level > 0 {
            return self.descend(level - 1, 2 * place, near, test)
                || self.descend(level - 1, 2 * place + 1, near, test);
        }
        let first = LEAF * place;
        let last = (first + LEAF).min(self.segments.len());
        (first..last).any(|index| test(index, &self.segments[index]))
    }

    /// The least distance of the line from a point, each place's in its own radii; infinite where there is no line.
    pub fn least_share(&self, point: &Point3<f64>) -> f64 {
        self.nearest_in_radii(point).map_or(f64::INFINITY, |(share, _)| share)
    }

    /// The least distance of the line from a point, each place's in its own radii, and the line's radius at the place that
    /// has it.
    pub fn nearest_in_radii(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let (mut least, mut nearest) = (f64::INFINITY, None);
        let mut rest = vec![(self.levels.len() - 1, 0)];
        while let Some((level, place)) = rest.pop() {
            match self.levels[level].get(place) {
                Some(bounds) if bounds.distance(point) < least * bounds.radius => {}
                _ => continue,
            }
            if level > 0 {
                rest.extend([(level - 1, 2 * place), (level - 1, 2 * place + 1)]);
                continue;
            }
            for segment in self.segments.iter().skip(LEAF * place).take(LEAF) {
                let share = segment.share(point);
                if share < least {
                    (least, nearest) = (share, Some(segment));
                }
            }
        }
        nearest.map(|segment| (least, segment.nearest(point).1))
    }
}
