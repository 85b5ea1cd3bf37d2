//! Half-edge adjacency of a triangle list as one flat array (a corner table).
//!
//! Half-edge `h = 3 t + k` runs from corner `k` of triangle `t` to the next corner.

/// No opposite half-edge: the surface is open there.
pub const NONE: u32 = u32::MAX;

/// The next half-edge in the same triangle.
#[inline]
pub fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

/// The previous half-edge in the same triangle.
#[inline]
pub fn previous(h: u32) -> u32 {
    if h.is_multiple_of(3) { h + 2 } else { h - 1 }
}

/// The vertex that a half-edge of a triangle list starts at.
#[inline]
pub fn origin(triangles: &[[u32; 3]], h: u32) -> u32 {
    triangles[(h / 3) as usize][(h % 3) as usize]
}

/// Opposite half-edges of a closed, oriented, manifold triangle list, and one outgoing half-edge a vertex.
#[derive(Debug, Clone, Default)]
pub struct CornerTable {
    /// Vertex that each half-edge starts at (the triangle list, flat).
    origin: Vec<u32>,
    opposite: Vec<u32>,
    outgoing: Vec<u32>,
}

impl CornerTable {
    /// Takes the opposites found by [`crate::mesh::preparation`]; `vertices` is the number of vertices.
    pub fn new(triangles: &[[u32; 3]], opposite: Vec<u32>, vertices: usize) -> Self {
        let origin: Vec<u32> = triangles.iter().flatten().copied().collect();
        let mut outgoing = vec![NONE; vertices];
        let target = |h: u32| origin[next(h) as usize];
        for (h, &v) in origin.iter().enumerate() {
            let first = &mut outgoing[v as usize];
            // Toward the lowest neighbour: the order of the triangles decides nothing.
            if *first == NONE || target(h as u32) < target(*first) {
                *first = h as u32;
            }
        }
        Self { origin, opposite, outgoing }
    }

    pub fn half_edges(&self) -> usize {
        self.origin.len()
    }

    pub fn vertices(&self) -> usize {
        self.outgoing.len()
    }

    #[inline]
    pub fn origin(&self, h: u32) -> u32 {
        self.origin[h as usize]
    }

    #[inline]
    pub fn target(&self, h: u32) -> u32 {
        self.origin[next(h) as usize]
    }

    #[inline]
    pub fn opposite(&self, h: u32) -> u32 {
        self.opposite[h as usize]
    }

    /// One half-edge that starts at `v`, or [`NONE`] for a vertex without triangles.
    #[inline]
    pub fn outgoing(&self, v: u32) -> u32 {
        self.outgoing[v as usize]
    }

    /// The smaller of a half-edge and its opposite: a name of the undirected edge.
    #[inline]
    pub fn edge(&self, h: u32) -> u32 {
        h.min(self.opposite[h as usize])
    }

    /// The half-edges that start at `v`, in cyclic order around it (closed surfaces).
    pub fn star(&self, v: u32) -> Star<'_> {
        let first = self.outgoing(v);
        Star { table: self, first, current: first }
    }

    /// The neighbours of `v`, in cyclic order around it.
    pub fn neighbours(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        self.star(v).map(|h| self.target(h))
    }
}

/// Iterator of [`CornerTable::star`].
pub struct Star<'a> {
    table: &'a CornerTable,
    first: u32,
    current: u32,
}

impl Iterator for Star<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        if self.current == NONE {
            return None;
        }
        let h = self.current;
        let turned = self.table.opposite(previous(h));
        self.current = if turned == self.first { NONE } else { turned };
        Some(h)
    }
}
