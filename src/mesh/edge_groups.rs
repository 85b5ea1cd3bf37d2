//! The edges of a triangle soup: which half-edges have the same two ends.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::TriangleMesh;
use super::corner_table::{NONE, origin, previous};

/// The half-edges of every undirected edge, grouped by its smaller vertex: `members[start[v]..start[v + 1]]`.
pub(super) struct EdgeGroups {
    start: Vec<u32>,
    /// The larger vertex above, the half-edge below: sorted within each vertex.
    members: Vec<u64>,
}

/// The half-edge of a member of [`EdgeGroups`].
pub(super) fn half_edge(member: u64) -> u32 {
    member as u32
}

/// Vertices that one thread takes at a time: few enough to share them out, many enough to be worth it.
const SHARE: usize = 1 << 14;
/// Every thread that counts and places goes through all triangles: more than so many are no faster.
const READERS: usize = 4;

/// The two ends of a triangle's three edges, the smaller first.
fn sides(corners: &[u32; 3]) -> [(u32, u32); 3] {
    let [a, b, c] = *corners;
    [(a.min(b), a.max(b)), (b.min(c), b.max(c)), (c.min(a), c.max(a))]
}

/// How many vertices each of those that count and place takes.
fn share(mesh: &TriangleMesh) -> usize {
    let readers = rayon::current_num_threads().min(READERS);
    mesh.vertices.len().div_ceil(readers).max(SHARE)
}

/// How many half-edges each vertex has, as the smaller one of their two ends; and a zero after the last.
fn counted(mesh: &TriangleMesh, share: usize) -> Vec<u32> {
    let vertices = mesh.vertices.len();
    let mut counts = vec![0u32; vertices + 1];
    counts[..vertices].par_chunks_mut(share).enumerate().for_each(|(number, counts)| {
        for (low, _) in mesh.triangles.iter().flat_map(sides) {
            if let Some(count) = counts.get_mut((low as usize).wrapping_sub(share * number)) {
                *count += 1;
            }
        }
    });
    counts
}

impl EdgeGroups {
    /// Counting sort of the half-edges by their smaller vertex, then a small sort by the larger one.
    pub(super) fn of(mesh: &TriangleMesh) -> Self {
        let share = share(mesh);
        Self::placed(mesh, share, counted(mesh, share))
    }

    /// [`EdgeGroups::plain_pairs`] of a soup. One that has more edges at a vertex than there are other vertices for is
    /// refused before room is made for any.
    pub(super) fn plain_pairs_of(mesh: &TriangleMesh) -> Option<Vec<u32>> {
        let share = share(mesh);
        let counts = counted(mesh, share);
        if counts.iter().any(|&count| count as usize > 2 * mesh.vertices.len()) {
            return None;
        }
        Self::placed(mesh, share, counts).plain_pairs(&mesh.triangles)
    }

    /// `start`: how many half-edges each vertex has, as the smaller one.
    fn placed(mesh: &TriangleMesh, share: usize, mut start: Vec<u32>) -> Self {
        let vertices = mesh.vertices.len();
        // Each entry comes to be its vertex's end, and is counted down to its start as members come in.
        for v in 1..start.len() {
            start[v] += start[v - 1];
        }
        let mut members = vec![0u64; 3 * mesh.triangles.len()];
        let mut rest = &mut members[..];
        let mut shares = Vec::new();
        for (number, ends) in start[..vertices].chunks_mut(share).enumerate() {
            let first = 3 * mesh.triangles.len() - rest.len();
            let count = ends.last().map_or(0, |&end| end as usize) - first;
            let (own, others) = std::mem::take(&mut rest).split_at_mut(count);
            rest = others;
            shares.push((share * number, first, ends, own));
        }
        shares.into_par_iter().for_each(|(from, first, ends, own)| {
            for (h, (low, high)) in mesh.triangles.iter().flat_map(sides).enumerate() {
                if let Some(slot) = ends.get_mut((low as usize).wrapping_sub(from)) {
                    *slot -= 1;
                    own[*slot as usize - first] = u64::from(high) << 32 | h as u64;
                }
            }
            for v in 0..ends.len() {
                let end = ends.get(v + 1).map_or(own.len(), |&next| next as usize - first);
                own[ends[v] as usize - first..end].sort_unstable();
            }
        });
        Self { start, members }
    }

    /// The half-edges of each edge, ascending.
    pub(super) fn iter(&self) -> impl Iterator<Item = &[u64]> {
        self.within(&self.start)
    }

    fn within<'a>(&'a self, start: &'a [u32]) -> impl Iterator<Item = &'a [u64]> {
        let of_vertex = |pair: &[u32]| &self.members[pair[0] as usize..pair[1] as usize];
        start.windows(2).flat_map(move |pair| of_vertex(pair).chunk_by(|a, b| a >> 32 == b >> 32))
    }

    /// The opposite of each half-edge, or [`NONE`] at a rim, where every edge has one triangle, or two different ones that
    /// are wound alike; `None` where one has not.
    pub(super) fn plain_pairs(&self, triangles: &[[u32; 3]]) -> Option<Vec<u32>> {
        let opposite: Vec<AtomicU32> = (0..self.members.len()).map(|_| AtomicU32::new(NONE)).collect();
        let pair = |group: &[u64]| match *group {
            [_] => true,
            [a, b] => {
                let (a, b) = (half_edge(a), half_edge(b));
                opposite[a as usize].store(b, Ordering::Relaxed);
                opposite[b as usize].store(a, Ordering::Relaxed);
                let apex = |h: u32| origin(triangles, previous(h));
                origin(triangles, a) != origin(triangles, b) && apex(a) != apex(b)
            }
            _ => false,
        };
        let last = self.start.len() - 1;
        let shares: Vec<usize> = (0..last).step_by(SHARE).collect();
        let all_plain = |from: &usize| self.within(&self.start[*from..=(from + SHARE).min(last)]).all(pair);
        let plain = shares.par_iter().all(all_plain);
        plain.then(|| opposite.into_iter().map(AtomicU32::into_inner).collect())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    /// A strip of `2 n` triangles over so many pairs of vertices, numbered so that no thread has all of an edge's ends.
    fn strip(n: u32) -> TriangleMesh {
        let name = |v: u32| v / 2 + (n + 1) * (v % 2);
        let corners = |k: u32| if k.is_multiple_of(2) { [k, k + 1, k + 2] } else { [k + 1, k, k + 2] };
        TriangleMesh {
            vertices: vec![Point3::origin(); 2 * n as usize + 2],
            triangles: (0..2 * n).map(|k| corners(k).map(name)).collect(),
        }
    }

    #[test]
    fn any_number_of_threads_finds_the_same_edges() {
        let mesh = strip(3 * SHARE as u32);
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| EdgeGroups::of(&mesh))
        };
        let (one, four) = (by(1), by(4));
        assert_eq!((&one.start, &one.members), (&four.start, &four.members));
        let count = |threads: usize| one.iter().filter(|group| group.len() == threads).count();
        // Inner edges between neighbours, and a rim all around.
        assert_eq!((count(1), count(2)), (6 * SHARE + 2, 6 * SHARE - 1));
        let opposite = one.plain_pairs(&mesh.triangles).unwrap();
        let paired = opposite.iter().filter(|&&h| h != NONE).count();
        assert_eq!(paired, 2 * (6 * SHARE - 1));
        assert!(opposite.iter().enumerate().all(|(h, &o)| o == NONE || opposite[o as usize] == h as u32));
    }

    #[test]
    fn turned_repeated_and_third_triangles_are_not_plain() {
        let two = [[0, 1, 2], [1, 0, 3]];
        let is_plain = |triangles: &[[u32; 3]]| {
            let mesh = TriangleMesh { vertices: vec![Point3::origin(); 5], triangles: triangles.to_vec() };
            EdgeGroups::of(&mesh).plain_pairs(&mesh.triangles).is_some()
        };
        assert!(is_plain(&two));
        assert!(!is_plain(&[two[0], [0, 1, 3]]), "turned");
        assert!(!is_plain(&[two[0], [0, 2, 1]]), "the same corners");
        assert!(!is_plain(&[two[0], two[1], [0, 1, 4]]), "three at an edge");
        let mesh = |triangles: Vec<[u32; 3]>| TriangleMesh { vertices: vec![Point3::origin(); 5], triangles };
        assert!(EdgeGroups::plain_pairs_of(&mesh(two.to_vec())).is_some());
        assert!(
            EdgeGroups::plain_pairs_of(&mesh(vec![two[0]; 100])).is_none(),
            "more than there are vertices for"
        );
    }
}
