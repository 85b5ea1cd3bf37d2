//! Symmetric band matrices: the normal equations of a curve through points that only neighbours hold together.

/// The widest: four points of three coordinates take part in a third difference.
const WIDEST: usize = 12;

/// A symmetric positive definite band matrix, upper half by rows: the diagonal and what stands `WIDTH - 1` beside it,
/// 11 at most.
#[derive(Clone)]
pub struct Banded<const WIDTH: usize> {
    rows: Vec<[f64; WIDTH]>,
}

impl<const WIDTH: usize> Banded<WIDTH> {
    /// Zero, `n` by `n`.
    pub fn new(n: usize) -> Self {
        const { assert!(WIDTH <= WIDEST) };
        Self { rows: vec![[0.0; WIDTH]; n] }
    }

    /// Adds to entry (`row`, `column`) and its mirror; `row <= column < row + WIDTH`.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        self.rows[row][column - row] += value;
    }

    /// Solves for `right`, in place: elimination row by row (LDL', Golub and Van Loan, *Matrix Computations*, 4.3.5).
    /// O(n).
    pub fn solve(mut self, right: &mut [f64]) {
        /// What rounding leaves of a diagonal entry.
        const ROUNDED: f64 = 1e-15;
        let n = self.rows.len();
        let diagonal: Vec<f64> = self.rows.iter().map(|row| row[0]).collect();
        // With nothing after its end a row can be taken from any entry on, always as long: that is unrolled.
        let mut row = [0.0; 2 * WIDEST];
        for i in 0..n {
            let (done, after) = self.rows.split_at_mut(i + 1);
            let own = &mut done[i];
            // Rounding may leave less than nothing where nothing holds: then hardly anything does.
            own[0] = own[0].max(ROUNDED * diagonal[i]).max(f64::MIN_POSITIVE);
            row[..WIDTH].copy_from_slice(own);
            let (known, unknown) = right.split_at_mut(i + 1);
            for (k, (below, value)) in after.iter_mut().zip(unknown).take(WIDTH - 1).enumerate() {
                let share = row[k + 1] / row[0];
                // Coordinates that nothing ties together are many.
                if share != 0.0
                    && let Some(rest) = row[k + 1..].first_chunk::<WIDTH>()
                {
                    below.iter_mut().zip(rest).for_each(|(entry, own)| *entry -= share * own);
                    *value -= share * known[i];
                }
            }
        }
        for i in (0..n).rev() {
            let row = &self.rows[i];
            let known = row[1..].iter().zip(&right[i + 1..]).map(|(entry, value)| entry * value);
            right[i] = (right[i] - known.sum::<f64>()) / row[0];
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    #[test]
    fn it_solves_as_a_full_matrix_does() {
        solves::<3>();
        solves::<9>();
        solves::<12>();
    }

    fn solves<const WIDTH: usize>() {
        let n = 40;
        let mut banded = Banded::<WIDTH>::new(n);
        let mut full = DMatrix::zeros(n, n);
        for row in 0..n {
            for column in row..(row + WIDTH).min(n) {
                let value = if row == column { 30.0 } else { ((3 * row + 5 * column) as f64).sin() };
                banded.add(row, column, value);
                (full[(row, column)], full[(column, row)]) = (value, value);
            }
        }
        let right = DVector::from_fn(n, |i, _| (i as f64).cos());
        let mut solved = right.as_slice().to_vec();
        banded.solve(&mut solved);
        let left = full * DVector::from_vec(solved) - right;
        assert!(left.amax() < 1e-12, "{left} is left");
    }
}
