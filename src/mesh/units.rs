//! Units of length: a label of the coordinates, which are never converted.

use std::fmt;
use std::str::FromStr;

/// The unit of a mesh's coordinates. Results stay in the input's unit and frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Units {
    #[default]
    Millimetres,
    Centimetres,
    Metres,
    Micrometres,
    Inches,
}

impl Units {
    /// Every unit, in the order that help texts list them.
    pub const ALL: [Units; 5] =
        [Units::Millimetres, Units::Centimetres, Units::Metres, Units::Micrometres, Units::Inches];

    /// The word used in parameters and results: `mm`, `cm`, `m`, `um` or `in`.
    pub fn name(self) -> &'static str {
        match self {
            Units::Millimetres => "mm",
            Units::Centimetres => "cm",
            Units::Metres => "m",
            Units::Micrometres => "um",
            Units::Inches => "in",
        }
    }
}

impl fmt::Display for Units {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// A word that is none of [`Units`]' names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a unit of length; use mm, cm, m, um or in")]
pub struct UnknownUnit;

impl FromStr for Units {
    type Err = UnknownUnit;

    fn from_str(text: &str) -> Result<Self, UnknownUnit> {
        Units::ALL.into_iter().find(|unit| unit.name() == text).ok_or(UnknownUnit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back_and_others_do_not() {
        for unit in Units::ALL {
            assert_eq!(unit.name().parse(), Ok(unit));
        }
        assert_eq!("furlong".parse::<Units>(), Err(UnknownUnit));
        assert_eq!("MM".parse::<Units>(), Err(UnknownUnit));
    }
}
