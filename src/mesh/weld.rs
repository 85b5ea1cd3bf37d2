//! Welding: vertices at exactly equal coordinates become one.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::TriangleMesh;

/// Merges the vertices that have exactly equal coordinates (-0 equals 0).
///
/// Vertices keep the order of their first appearance; triangles keep their number and order, so
/// some may come out with two equal corners. Unreferenced vertices stay. Expects finite
/// coordinates and indices in range. Linear in time on average, O(n log n) at worst.
pub fn weld(mesh: TriangleMesh) -> TriangleMesh {
    let TriangleMesh { vertices, mut triangles } = mesh;
    let mut welder = Welder::with_capacity(vertices.len());
    let map: Vec<u32> = vertices.iter().map(|&vertex| welder.insert(vertex)).collect();
    if welder.len() < vertices.len() {
        for corner in triangles.iter_mut().flatten() {
            *corner = map[*corner as usize];
        }
    }
    TriangleMesh { vertices: welder.into_vertices(), triangles }
}

/// Gives each distinct point an index, in order of first appearance.
#[derive(Debug)]
pub struct Welder {
    vertices: Vec<Point3<f64>>,
    index: Index,
}

#[derive(Debug)]
enum Index {
    Hashed(Table),
    /// Taken when points collide in the table far more often than chance allows, which only
    /// points built for that purpose do: keeps the worst case at O(n log n).
    Ordered(BTreeMap<[u64; 3], u32>),
}

/// Open addressing with linear probing; a slot holds the point's hash and its vertex.
#[derive(Debug)]
struct Table {
    slots: Vec<Slot>,
    /// The home slot of a hash is `hash >> shift`.
    shift: u32,
    lookups: u64,
    /// Occupied slots passed over in all lookups.
    probes: u64,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    hash: u32,
    vertex: u32,
}

const VACANT: Slot = Slot { hash: 0, vertex: u32::MAX };

/// Probes a lookup may take on average before the table is given up; chance gives one at most.
const PROBES_PER_LOOKUP: u64 = 16;

impl Welder {
    /// Room for `points` distinct points before anything grows; up to 2^31 may be inserted.
    pub fn with_capacity(points: usize) -> Self {
        Welder { vertices: Vec::with_capacity(points), index: Index::Hashed(Table::for_points(points)) }
    }

    /// How many distinct points there are.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// The distinct points, by index.
    pub fn into_vertices(self) -> Vec<Point3<f64>> {
        self.vertices
    }

    /// The index of a point with finite coordinates.
    pub fn insert(&mut self, point: Point3<f64>) -> u32 {
        // Adding zero turns -0 into 0 and changes nothing else.
        let point = Point3::new(point.x + 0.0, point.y + 0.0, point.z + 0.0);
        let next = self.vertices.len() as u32;
        let vertex = match &mut self.index {
            Index::Hashed(table) => table.find_or_insert(&self.vertices, &point),
            Index::Ordered(tree) => *tree.entry(key(&point)).or_insert(next),
        };
        if vertex == next {
            self.vertices.push(point);
        }
        self.leave_flooded_table();
        vertex
    }

    fn leave_flooded_table(&mut self) {
        if let Index::Hashed(table) = &self.index
            && table.probes > PROBES_PER_LOOKUP * table.lookups + 4096
        {
            let entries = self.vertices.iter().enumerate();
            self.index = Index::Ordered(entries.map(|(index, vertex)| (key(vertex), index as u32)).collect());
        }
    }
}

impl Table {
    fn for_points(points: usize) -> Self {
        let slots = (points * 2).next_power_of_two().max(16);
        Table { slots: vec![VACANT; slots], shift: 32 - slots.trailing_zeros(), lookups: 0, probes: 0 }
    }

    /// The index of `point` among `vertices`, or their number after making room for it.
    fn find_or_insert(&mut self, vertices: &[Point3<f64>], point: &Point3<f64>) -> u32 {
        let hash = hash(point);
        self.lookups += 1;
        let mut at = (hash >> self.shift) as usize;
        loop {
            let slot = self.slots[at];
            if slot.vertex == VACANT.vertex {
                let vertex = vertices.len() as u32;
                self.slots[at] = Slot { hash, vertex };
                if (vertices.len() + 1) * 2 > self.slots.len() {
                    self.grow();
                }
                return vertex;
            }
            if slot.hash == hash && vertices[slot.vertex as usize] == *point {
                return slot.vertex;
            }
            self.probes += 1;
            at = (at + 1) & (self.slots.len() - 1);
        }
    }

    fn grow(&mut self) {
        let old = std::mem::take(&mut self.slots);
        self.slots = vec![VACANT; old.len() * 2];
        self.shift -= 1;
        for slot in old {
            if slot.vertex != VACANT.vertex {
                let mut at = (slot.hash >> self.shift) as usize;
                while self.slots[at].vertex != VACANT.vertex {
                    at = (at + 1) & (self.slots.len() - 1);
                    self.probes += 1;
                }
                self.slots[at] = slot;
            }
        }
    }
}

fn key(point: &Point3<f64>) -> [u64; 3] {
    [point.x.to_bits(), point.y.to_bits(), point.z.to_bits()]
}

/// The upper half of two folded multiplications; the constants are digits of pi.
fn hash(point: &Point3<f64>) -> u32 {
    let [x, y, z] = key(point);
    let plane = folded_product(x ^ 0x243f_6a88_85a3_08d3, y ^ 0x1319_8a2e_0370_7344);
    (folded_product(plane ^ z, 0xa409_3822_299f_31d1) >> 32) as u32
}

fn folded_product(a: u64, b: u64) -> u64 {
    let product = u128::from(a) * u128::from(b);
    (product >> 64) as u64 ^ product as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64, z: f64) -> Point3<f64> {
        Point3::new(x, y, z)
    }

    #[test]
    fn equal_vertices_become_the_first_of_them() {
        let mesh = TriangleMesh {
            vertices: vec![
                point(1.0, 0.0, 0.0),
                point(0.0, 1.0, 0.0),
                point(1.0, -0.0, 0.0),
                point(0.0, 0.0, 1.0),
                point(0.0, 1.0, 0.0),
                point(9.0, 9.0, 9.0),
            ],
            triangles: vec![[0, 1, 3], [2, 4, 3], [0, 2, 3]],
        };
        let welded = weld(mesh);
        assert_eq!(
            welded.vertices,
            [point(1.0, 0.0, 0.0), point(0.0, 1.0, 0.0), point(0.0, 0.0, 1.0), point(9.0, 9.0, 9.0)]
        );
        assert_eq!(welded.triangles, [[0, 1, 2], [0, 1, 2], [0, 0, 2]]);
    }

    #[test]
    fn nearly_equal_vertices_stay_apart() {
        let mut welder = Welder::with_capacity(0);
        assert_eq!(welder.insert(point(0.1, 0.2, 0.3)), 0);
        assert_eq!(welder.insert(point(0.1, 0.2, 0.1 + 0.2)), 1);
        assert_eq!(welder.insert(point(0.1, 0.2, 0.3)), 0);
        assert_eq!(welder.len(), 2);
    }

    #[test]
    fn a_grown_table_finds_all_its_points_again() {
        let mut welder = Welder::with_capacity(0);
        let points: Vec<_> = (0..5000).map(|i| point(f64::from(i % 17), f64::from(i / 17), 0.5)).collect();
        let first: Vec<u32> = points.iter().map(|&p| welder.insert(p)).collect();
        let second: Vec<u32> = points.iter().map(|&p| welder.insert(p)).collect();
        assert_eq!(first, second);
        assert_eq!(first, (0..5000).collect::<Vec<u32>>());
        assert_eq!(welder.into_vertices(), points);
    }

    #[test]
    fn colliding_points_cannot_make_it_quadratic() {
        // These two factors are multiplied to zero, whatever y is: every hash is that of z alone.
        let x = f64::from_bits(0x243f_6a88_85a3_08d3);
        let points = (0..200_000u32).map(|i| point(x, f64::from(i), 1.0));
        let mut welder = Welder::with_capacity(0);
        for (index, point) in points.clone().enumerate() {
            assert_eq!(welder.insert(point), index as u32);
        }
        assert!(matches!(welder.index, Index::Ordered(_)));
        for (index, point) in points.enumerate() {
            assert_eq!(welder.insert(point), index as u32);
        }
        assert_eq!(welder.len(), 200_000);
    }
}
