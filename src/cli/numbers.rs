//! Numbers among the arguments, and what is said where they are none.

use std::num::{IntErrorKind, NonZeroU64};

const TOO_LARGE: &str = "that is more than any; give a smaller whole number";

/// A whole number from 1.
pub(super) fn positive<T: TryFrom<NonZeroU64>>(text: &str) -> Result<T, &'static str> {
    match text.trim().parse::<NonZeroU64>() {
        Ok(number) => T::try_from(number).map_err(|_| TOO_LARGE),
        Err(error) if *error.kind() == IntErrorKind::PosOverflow => Err(TOO_LARGE),
        Err(_) => Err("give a whole number, 1 or more"),
    }
}

/// A whole number from 0.
pub(super) fn whole<T: TryFrom<u64>>(text: &str) -> Result<T, &'static str> {
    match text.trim().parse::<u64>() {
        Ok(number) => T::try_from(number).map_err(|_| TOO_LARGE),
        Err(error) if *error.kind() == IntErrorKind::PosOverflow => Err(TOO_LARGE),
        Err(_) => Err("give a whole number, 0 or more"),
    }
}

/// A number with or without a fraction.
pub(super) fn real(text: &str) -> Result<f64, &'static str> {
    let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or("give a number, 0.4 for example")
}

#[cfg(test)]
mod tests {
    use std::num::{NonZeroU32, NonZeroUsize};

    use super::*;

    #[test]
    fn what_is_no_number_is_told_in_words() {
        assert_eq!(positive::<NonZeroU32>(" 12 ").map(NonZeroU32::get), Ok(12));
        for text in ["", "0", "-1", "1.5", "many"] {
            assert_eq!(positive::<NonZeroUsize>(text), Err("give a whole number, 1 or more"), "{text}");
        }
        for text in ["4294967296", "99999999999999999999999"] {
            assert_eq!(positive::<NonZeroU32>(text), Err(TOO_LARGE), "{text}");
            assert_eq!(whole::<u32>(text), Err(TOO_LARGE), "{text}");
        }
        assert_eq!((whole::<usize>("0"), real(" -0.5")), (Ok(0), Ok(-0.5)));
        for text in ["", "x", "nan", "inf", "1e999"] {
            assert!(whole::<u64>(text).is_err() && real(text).is_err(), "{text}");
        }
    }
}
