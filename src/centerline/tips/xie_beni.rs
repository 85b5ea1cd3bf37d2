//! The validity index of Xie and Beni for fuzzy clusterings (the paper's ref. 31), which says how many of
//! the tips make good first cluster centres (IV.A).

use crate::centerline::segmentation::{DistanceField, power};
use crate::centerline::{CancelToken, ExtractError};

/// `S = sum_j sum_i u_ij² d(i, j)² / (n min d(c_j, c_k)²)` for the first `k` centres, for each `k` from 2 up.
///
/// Compactness over separation: the smaller, the better. `fields[j][i]` is the distance of vertex `i` from
/// centre `j`, `centres[j]` that centre's vertex, `m` the weight index of eq. 1. The answer's entry `e` is for
/// `e + 2` centres; it is infinite where two centres coincide. `O(n K)`.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn validity(
    fields: &[DistanceField],
    centres: &[u32],
    m: f64,
    cancel: &CancelToken,
) -> Result<Vec<f64>, ExtractError> {
    let Some(vertices) = fields.first().map(Vec::len) else { return Ok(Vec::new()) };
    // u_ij = d^-p / D_i with D_i = sum_t d^-p, so sum_j u² d² = sum_j d^(2-2p) / D_i²: both sums grow with k.
    let p = 2.0 / (m - 1.0);
    let mut inverse = vec![0.0f64; vertices];
    let mut compact = vec![0.0f64; vertices];
    let mut separation = f64::INFINITY;
    let mut answer = Vec::with_capacity(fields.len().saturating_sub(1));
    for (k, field) in fields.iter().enumerate() {
        cancel.check()?;
        for (i, &distance) in field.iter().enumerate() {
            let weight = power(f64::from(distance), -p);
            inverse[i] += weight;
            compact[i] += weight * weight * f64::from(distance) * f64::from(distance);
        }
        for &other in &centres[..k] {
            separation = separation.min(f64::from(field[other as usize]));
        }
        if k > 0 {
            // At a centre the inverse distance is infinite and the vertex adds nothing.
            let terms = inverse.iter().zip(&compact);
            let sum: f64 =
                terms.map(|(d, c)| if d.is_finite() && *d > 0.0 { c / (d * d) } else { 0.0 }).sum();
            answer.push(if separation > 0.0 {
                sum / (vertices as f64 * separation * separation)
            } else {
                f64::INFINITY
            });
        }
    }
    Ok(answer)
}

/// How many of the centres to keep, from the first: that of the least index, the larger number of two equal.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn best_count(
    fields: &[DistanceField],
    centres: &[u32],
    m: f64,
    cancel: &CancelToken,
) -> Result<usize, ExtractError> {
    let validity = validity(fields, centres, m, cancel)?;
    let least = validity.iter().copied().fold(f64::INFINITY, f64::min);
    let best = validity.iter().rposition(|&value| value <= least);
    Ok(best.map_or(centres.len().min(2), |index| index + 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distances on a line.
    fn fields(points: &[f64], centres: &[u32]) -> Vec<DistanceField> {
        centres
            .iter()
            .map(|&c| points.iter().map(|x| (x - points[c as usize]).abs() as f32).collect())
            .collect()
    }

    #[test]
    fn the_index_is_what_its_formula_gives() {
        let points = [0.0, 1.0, 3.0, 4.0];
        let centres = [0, 3];
        let (mut sum, m) = (0.0, 2.0);
        for x in points {
            let d: [f64; 2] = [x, 4.0 - x];
            if d[0] > 0.0 && d[1] > 0.0 {
                for j in 0..2 {
                    let u: f64 = 1.0 / d.iter().map(|t| (d[j] / t).powi(2)).sum::<f64>();
                    sum += u * u * d[j] * d[j];
                }
            }
        }
        let index = validity(&fields(&points, &centres), &centres, m, &CancelToken::new()).unwrap();
        assert_eq!(index.len(), 1);
        assert!((index[0] - sum / (4.0 * 16.0)).abs() < 1e-7, "{} {}", index[0], sum / 64.0);
    }

    #[test]
    fn three_clumps_want_three_centres() {
        let clumps: Vec<f64> = [0.0, 10.0, 20.0]
            .iter()
            .flat_map(|c| (0..21).map(move |k| c + f64::from(k - 10) * 0.05))
            .collect();
        // Clump centres first, then two that split a clump.
        let centres = [10, 52, 31, 25, 5];
        assert_eq!(best_count(&fields(&clumps, &centres), &centres, 2.0, &CancelToken::new()).unwrap(), 3);
    }

    #[test]
    fn coinciding_centres_are_never_chosen() {
        let points: Vec<f64> = (0..40).map(f64::from).collect();
        let centres = [0, 39, 39];
        assert!(
            validity(&fields(&points, &centres), &centres, 2.0, &CancelToken::new()).unwrap()[1]
                .is_infinite()
        );
        assert_eq!(best_count(&fields(&points, &centres), &centres, 2.0, &CancelToken::new()).unwrap(), 2);
        assert_eq!(
            best_count(&fields(&points, &centres[..1]), &centres[..1], 2.0, &CancelToken::new()).unwrap(),
            1
        );
    }
}
