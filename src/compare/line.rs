//! A line to be measured, and how it is sampled.

use nalgebra::Point3;

use crate::centerline::Centerline;
use crate::output::{ResultDocument, read_json};

use super::{CompareError, known, vmtk};

/// A curve with a radius at each point.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyline {
    pub points: Vec<Point3<f64>>,
    /// One a point.
    pub radii: Vec<f64>,
}

/// A centerline, with the topology of its graph.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    pub polylines: Vec<Polyline>,
    /// Ends: nodes with one branch.
    pub tips: usize,
    /// Independent loops: branches - nodes + parts.
    pub loops: usize,
    /// Connected parts.
    pub parts: usize,
    /// `None` where the file does not say.
    pub units: Option<String>,
    /// Diagonal of the surface's bounding box, where the file says it.
    pub diagonal: Option<f64>,
}

/// A place on a polyline, with the length of line that it stands for.
pub(super) struct Sample {
    pub point: Point3<f64>,
    pub radius: f64,
    pub weight: f64,
}

/// What the bytes are, where they are nothing that a line is read from.
fn unread(bytes: &[u8]) -> Option<&'static str> {
    #[derive(serde::Deserialize)]
    struct Gltf {
        #[serde(rename = "asset")]
        _asset: serde::de::IgnoredAny,
    }
    if bytes.starts_with(b"glTF") {
        return Some("a GLB");
    }
    match bytes.trim_ascii_start().first() {
        None => Some("empty"),
        Some(b'{') if serde_json::from_slice::<Gltf>(bytes).is_ok() => Some("a glTF"),
        Some(b'{' | b'<') => None,
        Some(_) => Some("neither JSON nor XML"),
    }
}

impl Line {
    /// Reads a `rosaline.centerline/1` document, known polylines `[x, y, z, radius]` in mm with the members
    /// `l_dia`, `tips` and `loops`, or VMTK's centerlines in a VTP.
    ///
    /// # Errors
    /// [`CompareError`] when it is none of them, or contradicts itself.
    pub fn read(bytes: &[u8]) -> Result<Self, CompareError> {
        if let Some(format) = unread(bytes) {
            return Err(CompareError::Format(format));
        }
        if vmtk::is_xml(bytes) {
            vmtk::read(bytes)
        } else if known::is_known(bytes) {
            known::read(bytes)
        } else {
            Self::of(&read_json(bytes)?)
        }
    }

    /// The line of a result.
    ///
    /// # Errors
    /// [`CompareError::Document`] when the document contradicts itself.
    pub fn of(document: &ResultDocument) -> Result<Self, CompareError> {
        let centerline = document.centerline()?;
        let (tips, loops, parts) = topology(&centerline);
        let polylines = centerline
            .branches
            .into_iter()
            .map(|branch| Polyline { points: branch.points, radii: branch.radii });
        Ok(Self {
            polylines: polylines.collect(),
            tips,
            loops,
            parts,
            units: Some(document.units.clone()),
            diagonal: Some(document.source.diagonal),
        })
    }
}

/// Tips, loops and parts of a graph. Nodes without a branch are not counted.
fn topology(centerline: &Centerline) -> (usize, usize, usize) {
    let mut degrees = vec![0_usize; centerline.nodes.len()];
    let mut parts = DisjointSets::new(centerline.nodes.len());
    for branch in &centerline.branches {
        degrees[branch.from] += 1;
        degrees[branch.to] += 1;
        parts.join(branch.from, branch.to);
    }
    let used = degrees.iter().filter(|&&degree| degree > 0).count();
    let bare = degrees.len() - used;
    let parts = parts.count() - bare;
    let tips = degrees.iter().filter(|&&degree| degree == 1).count();
    (tips, centerline.branches.len() + parts - used, parts)
}

impl Polyline {
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }

    /// Samples at equal distances of at most `step` along the line, both ends among them. The
    /// weights are those of the trapezoidal rule: they add up to the length.
    pub(super) fn samples(&self, step: f64) -> Vec<Sample> {
        let length = self.length();
        let count = (length / step).ceil().max(1.0) as usize;
        let spacing = length / count as f64;
        let mut samples = Vec::with_capacity(count + 1);
        let (mut segment, mut before) = (0, 0.0);
        let mut span = self.segment_length(0);
        for place in 0..=count {
            let along = spacing * place as f64;
            while along > before + span && segment + 2 < self.points.len() {
                before += span;
                segment += 1;
                span = self.segment_length(segment);
            }
            let share = if span > 0.0 { ((along - before) / span).clamp(0.0, 1.0) } else { 0.0 };
            let ends = place == 0 || place == count;
            samples.push(Sample {
                point: self.points[segment] + (self.points[segment + 1] - self.points[segment]) * share,
                radius: self.radii[segment] + (self.radii[segment + 1] - self.radii[segment]) * share,
                weight: if ends { 0.5 * spacing } else { spacing },
            });
        }
        samples
    }

    fn segment_length(&self, segment: usize) -> f64 {
        (self.points[segment + 1] - self.points[segment]).norm()
    }
}

/// Union-find over `0..n`.
pub(super) struct DisjointSets(Vec<usize>);

impl DisjointSets {
    pub fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&mut self, mut item: usize) -> usize {
        while self.0[item] != item {
            self.0[item] = self.0[self.0[item]];
            item = self.0[item];
        }
        item
    }

    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }

    pub fn count(&self) -> usize {
        self.0.iter().enumerate().filter(|&(place, &parent)| place == parent).count()
    }
}

#[cfg(test)]
mod tests {
    use crate::centerline::{Branch, Node, NodeKind};

    use super::*;

    fn graph(nodes: usize, branches: &[(usize, usize)]) -> Centerline {
        let node =
            Node { kind: NodeKind::End, position: Point3::origin(), radius: 1.0, equivalent_radius: 1.0 };
        let branch =
            |&(from, to): &(usize, usize)| Branch::new(from, to, vec![Point3::origin(); 2], vec![1.0; 2]);
        Centerline { nodes: vec![node; nodes], branches: branches.iter().map(branch).collect() }
    }

    #[test]
    fn topology_of_small_graphs() {
        assert_eq!(topology(&graph(2, &[(0, 1)])), (2, 0, 1), "tube");
        assert_eq!(topology(&graph(4, &[(0, 1), (1, 2), (3, 1)])), (3, 0, 1), "fork");
        assert_eq!(topology(&graph(1, &[(0, 0)])), (0, 1, 1), "ring");
        assert_eq!(topology(&graph(4, &[(0, 1), (1, 2), (1, 2), (2, 3)])), (2, 1, 1), "island");
        assert_eq!(topology(&graph(5, &[(0, 1), (2, 3)])), (4, 0, 2), "two tubes and a bare node");
        assert_eq!(topology(&graph(3, &[(0, 1), (1, 2), (2, 0), (0, 1)])), (0, 2, 1), "theta");
    }

    #[test]
    fn samples_are_even_and_their_weights_are_the_length() {
        let points = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]];
        let polyline =
            Polyline { points: points.map(Point3::from).to_vec(), radii: vec![1.0, 4.0, 4.0, 8.0] };
        let samples = polyline.samples(1.0);
        assert_eq!(samples.len(), 8);
        let weight: f64 = samples.iter().map(|sample| sample.weight).sum();
        assert!((weight - 7.0).abs() < 1e-12);
        assert_eq!(samples[2].point, Point3::new(2.0, 0.0, 0.0));
        assert!((samples[2].radius - 3.0).abs() < 1e-12);
        assert!((samples[5].point - Point3::new(3.0, 2.0, 0.0)).norm() < 1e-12);
        assert!((samples[5].radius - 6.0).abs() < 1e-12);
        assert_eq!(samples[7].point, polyline.points[3]);
    }

    #[test]
    fn a_line_shorter_than_the_step_keeps_both_ends() {
        let points = vec![Point3::origin(), Point3::new(0.25, 0.0, 0.0)];
        let samples = Polyline { points, radii: vec![1.0; 2] }.samples(10.0);
        let weights: Vec<_> = samples.iter().map(|sample| sample.weight).collect();
        assert_eq!(weights, [0.125, 0.125]);
    }
}
