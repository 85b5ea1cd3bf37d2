//! The median, by which one wrong value of many says nothing, and other shares of sorted values.

/// The middle one of the values, the upper of two; 0 of none. O(n).
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Place of the first of the weights, in their order, with which their sum reaches a `share` of all. O(n).
pub fn place_at_share(weights: impl Iterator<Item = f64> + Clone, share: f64) -> Option<usize> {
    let enough = share * weights.clone().sum::<f64>();
    let mut sum = 0.0;
    let mut weights = weights;
    weights.position(|weight| {
        sum += weight;
        sum >= enough
    })
}

#[cfg(test)]
mod tests {
    use super::{median, place_at_share};

    #[test]
    fn a_share_is_reached_with_the_weight_that_makes_it_full() {
        let place = |share: f64| place_at_share([1.0, 2.0, 1.0].into_iter(), share);
        assert_eq!([0.0, 0.25, 0.3, 0.75, 1.0].map(place), [0, 0, 1, 1, 2].map(Some));
        assert_eq!(place_at_share(std::iter::empty(), 0.5), None);
    }

    #[test]
    fn it_is_the_middle_value_and_the_upper_of_two() {
        assert_eq!(median(vec![]), 0.0);
        assert_eq!(median(vec![3.0]), 3.0);
        assert_eq!(median(vec![9.0, -1.0, 3.0]), 3.0);
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), 3.0);
    }
}
