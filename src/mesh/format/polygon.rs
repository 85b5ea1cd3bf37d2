//! Splitting a polygon into triangles.

use nalgebra::{Point3, Vector3};

/// Point-in-triangle tests allowed for each corner; bounds the time for a polygon made to be slow.
const TESTS_PER_CORNER: usize = 512;

/// Splits a polygon into its `n - 2` triangles of corner numbers, wound as the polygon is.
///
/// A convex polygon becomes a fan around its first corner; others lose one ear after another
/// (Meisters, *Polygons Have Ears*, 1975) in the plane of their mean normal. What has no ear left
/// (crossing itself, without area) becomes a fan too. Deterministic.
pub(super) fn triangulate(corners: &[Point3<f64>], mut emit: impl FnMut([usize; 3])) {
    let normal = newell_normal(corners);
    let all: Vec<usize> = (0..corners.len()).collect();
    let rest = if is_convex(corners, &normal) { all } else { clip_ears(corners, &normal, all, &mut emit) };
    for pair in rest.get(1..).unwrap_or_default().windows(2) {
        emit([rest[0], pair[0], pair[1]]);
    }
}

/// Twice the area's vector; its length is zero for a polygon without area.
fn newell_normal(corners: &[Point3<f64>]) -> Vector3<f64> {
    // Relative to a corner: far from the origin the products would lose the area's digits.
    let Some(&origin) = corners.first() else { return Vector3::zeros() };
    corners.windows(2).map(|pair| (pair[0] - origin).cross(&(pair[1] - origin))).sum()
}

/// Turns left everywhere, and once around in all.
fn is_convex(corners: &[Point3<f64>], normal: &Vector3<f64>) -> bool {
    let count = corners.len();
    let turns_left = |i: usize| {
        let [a, b, c] = [i, i + 1, i + 2].map(|k| corners[k % count]);
        doubled_area(&a, &b, &c, normal) >= 0.0
    };
    // The fan must not fold: a star turns left everywhere too.
    let sees_left = |i: usize| doubled_area(&corners[0], &corners[i], &corners[i + 1], normal) >= 0.0;
    (0..count).all(turns_left) && (1..count.saturating_sub(1)).all(sees_left)
}

/// Signed, seen against `normal`, and scaled by its length.
fn doubled_area(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
    (b - a).cross(&(c - a)).dot(normal)
}

/// Emits ears while there are any and the budget lasts; answers the corners that are left.
fn clip_ears(
    corners: &[Point3<f64>],
    normal: &Vector3<f64>,
    mut left: Vec<usize>,
    emit: &mut impl FnMut([usize; 3]),
) -> Vec<usize> {
    let mut budget = TESTS_PER_CORNER * corners.len();
    let mut at = 0;
    let mut refused = 0;
    while left.len() > 3 && refused < left.len() && budget > 0 {
        let count = left.len();
        at %= count;
        let ear = [left[(at + count - 1) % count], left[at], left[(at + 1) % count]];
        if is_ear(corners, normal, &left, ear, &mut budget) {
            emit(ear);
            left.remove(at);
            refused = 0;
        } else {
            at += 1;
            refused += 1;
        }
    }
    left
}

fn is_ear(
    corners: &[Point3<f64>],
    normal: &Vector3<f64>,
    left: &[usize],
    ear: [usize; 3],
    budget: &mut usize,
) -> bool {
    let [a, b, c] = ear.map(|corner| corners[corner]);
    if doubled_area(&a, &b, &c, normal) <= 0.0 {
        return false;
    }
    *budget = budget.saturating_sub(left.len());
    let holds = |point: &Point3<f64>| {
        let is_corner = *point == a || *point == b || *point == c;
        !is_corner
            && doubled_area(&a, &b, point, normal) >= 0.0
            && doubled_area(&b, &c, point, normal) >= 0.0
            && doubled_area(&c, &a, point, normal) >= 0.0
    };
    !left.iter().any(|&corner| holds(&corners[corner]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(corners: &[[f64; 2]]) -> Vec<Point3<f64>> {
        // Tilted and far away, so that no axis is special.
        let point = |[x, y]: [f64; 2]| Point3::new(x + 1000.0, 0.6 * y - 0.8 * x, 0.8 * y + 0.6 * x - 500.0);
        corners.iter().map(|&corner| point(corner)).collect()
    }

    fn triangles(corners: &[Point3<f64>]) -> Vec<[usize; 3]> {
        let mut triangles = Vec::new();
        triangulate(corners, |triangle| triangles.push(triangle));
        triangles
    }

    fn area(corners: &[Point3<f64>], [a, b, c]: [usize; 3]) -> f64 {
        let normal = newell_normal(corners).normalize();
        doubled_area(&corners[a], &corners[b], &corners[c], &normal) / 2.0
    }

    /// Covers the polygon exactly when no triangle is turned over and the areas add up.
    fn assert_covers(corners: &[Point3<f64>]) {
        let triangles = triangles(corners);
        assert_eq!(triangles.len(), corners.len() - 2);
        let areas: Vec<f64> = triangles.iter().map(|&triangle| area(corners, triangle)).collect();
        let whole = newell_normal(corners).norm() / 2.0;
        assert!(areas.iter().all(|&area| area >= -1e-9), "{areas:?}");
        assert!((areas.iter().sum::<f64>() - whole).abs() < 1e-9 * whole, "{areas:?} {whole}");
    }

    #[test]
    fn a_convex_polygon_is_a_fan() {
        let square = polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert_eq!(triangles(&square), [[0, 1, 2], [0, 2, 3]]);
        let ring: Vec<[f64; 2]> =
            (0..500).map(|i| f64::from(i).to_radians() * 0.72).map(|t| [t.cos(), t.sin()]).collect();
        assert_covers(&polygon(&ring));
    }

    #[test]
    fn an_arrowhead_is_cut_along_its_inner_diagonal() {
        let arrow = polygon(&[[0.0, 0.0], [4.0, -3.0], [1.0, 0.0], [4.0, 3.0]]);
        assert_covers(&arrow);
        let mirrored: Vec<_> = arrow.iter().rev().copied().collect();
        assert_covers(&mirrored);
    }

    #[test]
    fn combs_and_spirals_are_covered() {
        let mut comb = vec![[0.0, 0.0], [20.0, 0.0]];
        for tooth in (0..10).rev() {
            comb.extend([[2.0 * f64::from(tooth) + 1.0, 5.0], [2.0 * f64::from(tooth), 1.0]]);
        }
        assert_covers(&polygon(&comb));
        let arm = |radius: f64| move |i: i32| [f64::from(i) * 0.4, radius + f64::from(i) * 0.1];
        let bend = |[angle, radius]: [f64; 2]| [radius * angle.cos(), radius * angle.sin()];
        let spiral = (0..40).map(arm(2.0)).chain((0..40).rev().map(arm(1.0))).map(bend);
        assert_covers(&polygon(&spiral.collect::<Vec<_>>()));
    }

    #[test]
    fn polygons_without_area_and_stars_still_give_all_triangles() {
        let line = polygon(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [1.5, 0.0]]);
        assert_eq!(triangles(&line).len(), 3);
        let tip = |i: u32| f64::from(i * 144).to_radians();
        let star: Vec<[f64; 2]> = (0..5).map(tip).map(|t| [t.cos(), t.sin()]).collect();
        assert_eq!(triangles(&polygon(&star)).len(), 3);
        assert_eq!(triangles(&line[..2]).len(), 0);
        assert_eq!(triangles(&[]).len(), 0);
    }

    #[test]
    fn a_huge_zigzag_takes_bounded_time() {
        let upper = (0..20_000).map(|i| [f64::from(i), f64::from(i % 2) * 0.9 + 1.0]);
        let lower = (0..20_000).rev().map(|i| [f64::from(i), f64::from(i % 2) * 0.9]);
        let zigzag = polygon(&upper.chain(lower).rev().collect::<Vec<_>>());
        assert_eq!(triangles(&zigzag).len(), 39_998);
    }
}
