//! The parameters of section V.A and of the preset `default`, in one table that the
//! command line's help, openapi.yaml and the docs come from.

use std::fmt;
use std::str::FromStr;

use nalgebra::Point3;

/// Which of the two ways through the same stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// Scaled to the local radius and edge length; units do not matter.
    #[default]
    Default,
    /// The printed constants and formulas with the corrections that docs/method.md lists.
    Paper,
}

impl Preset {
    pub const NAMES: [&'static str; 2] = ["default", "paper"];

    pub fn name(self) -> &'static str {
        match self {
            Preset::Default => "default",
            Preset::Paper => "paper",
        }
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Enough of what was given to find it by.
pub(crate) fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}

impl FromStr for Preset {
    type Err = ParameterError;

    fn from_str(text: &str) -> Result<Self, ParameterError> {
        match text {
            "default" => Ok(Preset::Default),
            "paper" => Ok(Preset::Paper),
            _ => Err(ParameterError::UnknownPreset { found: shown(text) }),
        }
    }
}

/// What values a parameter takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterKind {
    /// A finite number in `min..=max`.
    Number { min: f64, max: f64 },
    /// `true` or `false`, held as 1 or 0.
    Flag,
}

/// One row of [`TABLE`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// The paper's name where the paper has one.
    pub name: &'static str,
    pub unit: &'static str,
    pub kind: ParameterKind,
    /// Value under the preset `default`; `None`: that preset has no use for it.
    pub default: Option<f64>,
    /// Value under the preset `paper`.
    pub paper: f64,
    pub doc: &'static str,
}

/// Every parameter. `Parameters` holds its values in this order.
pub const TABLE: &[ParameterSpec] = &[
    ParameterSpec {
        name: "m",
        unit: "1",
        kind: ParameterKind::Number { min: 1.05, max: 10.0 },
        default: None,
        paper: 2.0,
        doc: "weight index of the fuzzy K-means clustering (eq. 1)",
    },
    ParameterSpec {
        name: "mu",
        unit: "1",
        kind: ParameterKind::Number { min: 0.05, max: 0.95 },
        default: None,
        paper: 0.5,
        doc: "probability above which a vertex belongs to a cluster (IV.A)",
    },
    ParameterSpec {
        name: "d_cut",
        unit: "diagonal",
        kind: ParameterKind::Number { min: 0.0005, max: 0.2 },
        default: None,
        paper: 0.025,
        doc: "half width of the band of a cut plane (IV.B), as a share of the bounding box's diagonal; bounded by the local radius and edge length",
    },
    ParameterSpec {
        name: "omega",
        unit: "1",
        kind: ParameterKind::Number { min: 0.34, max: 0.999 },
        default: None,
        paper: 0.75,
        doc: "linearity above which a centerline point belongs to a branch, below to a joint (eq. 5)",
    },
    ParameterSpec {
        name: "h",
        unit: "local radius",
        kind: ParameterKind::Number { min: 0.05, max: 10.0 },
        default: None,
        paper: 1.0,
        doc: "first radius of the thinning neighbourhood (eq. 6, Algorithm 1)",
    },
    ParameterSpec {
        name: "eps_h",
        unit: "local radius",
        kind: ParameterKind::Number { min: 0.01, max: 5.0 },
        default: None,
        paper: 0.1,
        doc: "step by which the thinning neighbourhood grows (Algorithm 1)",
    },
    ParameterSpec {
        name: "delta_h",
        unit: "1",
        kind: ParameterKind::Number { min: 0.0, max: 0.999 },
        default: None,
        paper: 0.6,
        doc: "correlation at which the thinning neighbourhood stops growing (eq. 7, Algorithm 1)",
    },
    ParameterSpec {
        name: "tip_height",
        unit: "local radius",
        kind: ParameterKind::Number { min: 0.1, max: 20.0 },
        default: Some(1.0),
        paper: 1.0,
        doc: "height above which a protrusion is a branch with an end of its own",
    },
    ParameterSpec {
        name: "smoothing",
        unit: "flag",
        kind: ParameterKind::Flag,
        default: Some(0.0),
        paper: 0.0,
        doc: "run the morphology-preserving smoothing filter (the paper's ref. 6) on the surface first",
    },
];

/// How far a coordinate of a point may be from 0: as far as a surface may be large. Its square is a finite `f64`, and
/// itself a finite `f32`.
pub const FARTHEST: f64 = 1e30;

/// A parameter that is a list of points in the mesh's coordinates; both presets use it, and it is empty by default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointsSpec {
    pub name: &'static str,
    /// How many points it takes at most; 1: one point, not a list.
    pub most: usize,
    pub doc: &'static str,
}

/// The paper's interactive refinement (its ref. 32). `Parameters` holds their points in this order.
pub const POINTS: &[PointsSpec] = &[
    PointsSpec {
        name: "include",
        most: 1000,
        doc: "a point whose nearest end stays, however low; where none is near, the line gets one there",
    },
    PointsSpec {
        name: "exclude",
        most: 1000,
        doc: "a point whose nearest end, within 3 of its radii, is no end; it goes before one that is included",
    },
    PointsSpec {
        name: "root",
        most: 1,
        doc: "a point whose nearest end is the first node: distances are taken and branches told from there",
    },
];

/// A preset, the values of every parameter of [`TABLE`] and the points of [`POINTS`].
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    preset: Preset,
    values: Vec<f64>,
    points: Vec<Vec<Point3<f64>>>,
    /// Which ones were set although the preset has no use for them.
    idle: Vec<bool>,
}

impl Default for Parameters {
    fn default() -> Self {
        Self::of(Preset::Default)
    }
}

impl Parameters {
    /// The values of a preset.
    pub fn of(preset: Preset) -> Self {
        // What the preset has no use for is never asked for: any value will do.
        let values = TABLE.iter().map(|spec| spec.value(preset).unwrap_or(spec.paper)).collect();
        let points = vec![Vec::new(); POINTS.len()];
        Self { preset, values, points, idle: vec![false; TABLE.len()] }
    }

    pub fn preset(&self) -> Preset {
        self.preset
    }

    /// Sets a parameter by its name in [`TABLE`] from text, as a query string or a flag gives it; one of [`POINTS`]
    /// gets the point `x,y,z` more.
    ///
    /// # Errors
    /// [`ParameterError`] for an unknown name, a value out of range, and a point too many.
    pub fn set(&mut self, name: &str, text: &str) -> Result<(), ParameterError> {
        if let Some(index) = POINTS.iter().position(|spec| spec.name == name) {
            return self.add_point(index, text);
        }
        let index = TABLE
            .iter()
            .position(|spec| spec.name == name)
            .ok_or_else(|| ParameterError::Unknown { name: name.to_owned() })?;
        let spec = &TABLE[index];
        let bad = || ParameterError::Value { name: spec.name, found: shown(text), expected: spec.expected() };
        self.values[index] = match spec.kind {
            ParameterKind::Flag => match text {
                "true" | "1" => 1.0,
                "false" | "0" => 0.0,
                _ => return Err(bad()),
            },
            ParameterKind::Number { min, max } => {
                let value: f64 = text.parse().map_err(|_| bad())?;
                if !(min..=max).contains(&value) {
                    return Err(bad());
                }
                value
            }
        };
        self.idle[index] = spec.value(self.preset).is_none();
        Ok(())
    }

    fn add_point(&mut self, index: usize, text: &str) -> Result<(), ParameterError> {
        let PointsSpec { name, most, .. } = POINTS[index];
        let numbers: Vec<f64> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
        let is_near = |x: &f64| x.abs() <= FARTHEST;
        let whole = text.split(',').count() == 3 && numbers.len() == 3 && numbers.iter().all(is_near);
        if !whole {
            let found = shown(text);
            let expected =
                format!("x,y,z: three numbers in the mesh's coordinates, each within {FARTHEST:e} of 0");
            return Err(ParameterError::Value { name, found, expected });
        }
        if self.points[index].len() == most {
            return Err(ParameterError::TooManyPoints { name, most });
        }
        self.points[index].push(Point3::from_slice(&numbers));
        Ok(())
    }

    /// The points that were given, by their row of [`POINTS`]; none that is empty.
    pub fn points(&self) -> impl Iterator<Item = (&'static PointsSpec, &[Point3<f64>])> + '_ {
        let rows = POINTS.iter().zip(self.points.iter().map(Vec::as_slice));
        rows.filter(|(_, points)| !points.is_empty())
    }

    fn points_of(&self, name: &str) -> &[Point3<f64>] {
        self.points().find(|(spec, _)| spec.name == name).map_or(&[], |(_, points)| points)
    }

    fn all(&self) -> impl Iterator<Item = (&'static ParameterSpec, f64)> + '_ {
        TABLE.iter().zip(self.values.iter().copied())
    }

    /// Every parameter that the preset uses with its value, in the order of [`TABLE`].
    pub fn iter(&self) -> impl Iterator<Item = (&'static ParameterSpec, f64)> + '_ {
        self.all().filter(|(spec, _)| spec.value(self.preset).is_some())
    }

    /// Every parameter that was set and that the preset has no use for, with its value.
    pub fn unused(&self) -> impl Iterator<Item = (&'static ParameterSpec, f64)> + '_ {
        self.all().zip(&self.idle).filter(|(_, idle)| **idle).map(|(row, _)| row)
    }

    fn get(&self, name: &str) -> f64 {
        self.all().find(|(spec, _)| spec.name == name).map_or(f64::NAN, |(_, value)| value)
    }

    pub fn m(&self) -> f64 {
        self.get("m")
    }
    pub fn mu(&self) -> f64 {
        self.get("mu")
    }
    pub fn d_cut(&self) -> f64 {
        self.get("d_cut")
    }
    pub fn omega(&self) -> f64 {
        self.get("omega")
    }
    pub fn h(&self) -> f64 {
        self.get("h")
    }
    pub fn eps_h(&self) -> f64 {
        self.get("eps_h")
    }
    pub fn delta_h(&self) -> f64 {
        self.get("delta_h")
    }
    pub fn tip_height(&self) -> f64 {
        self.get("tip_height")
    }
    pub fn smoothing(&self) -> bool {
        self.get("smoothing") != 0.0
    }
    pub fn include(&self) -> &[Point3<f64>] {
        self.points_of("include")
    }
    pub fn exclude(&self) -> &[Point3<f64>] {
        self.points_of("exclude")
    }
    pub fn root(&self) -> Option<Point3<f64>> {
        self.points_of("root").first().copied()
    }
}

impl ParameterSpec {
    /// The value under a preset that uses this parameter.
    pub fn value(&self, preset: Preset) -> Option<f64> {
        match preset {
            Preset::Default => self.default,
            Preset::Paper => Some(self.paper),
        }
    }

    /// The accepted values, for help and errors.
    pub fn expected(&self) -> String {
        match self.kind {
            ParameterKind::Number { min, max } => format!("a number from {min} to {max}"),
            ParameterKind::Flag => "true or false".to_owned(),
        }
    }
}

/// A parameter that cannot be taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    #[error("there is no preset '{found}'; use default or paper")]
    UnknownPreset { found: String },
    #[error(
        "there is no parameter '{name}'; the known ones are in /openapi.yaml and in `rosaline extract --help`"
    )]
    Unknown { name: String },
    #[error("parameter {name} has more than {most} points; give at most {most}")]
    TooManyPoints { name: &'static str, most: usize },
    #[error("parameter {name} is '{found}'; give {expected}")]
    Value { name: &'static str, found: String, expected: String },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_three_finite_numbers_and_not_too_many() {
        let mut parameters = Parameters::default();
        assert_eq!(parameters.points().count(), 0);
        parameters.set("include", "1,-2.5, 3e1").unwrap();
        parameters.set("include", "0,0,0").unwrap();
        parameters.set("root", "4,5,6").unwrap();
        assert_eq!(parameters.include(), [Point3::new(1.0, -2.5, 30.0), Point3::origin()]);
        assert_eq!(parameters.root(), Some(Point3::new(4.0, 5.0, 6.0)));
        assert_eq!(parameters.exclude(), []);
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1,2,inf", "1;2;3", "1,2,3,"] {
            let error = parameters.set("exclude", bad).unwrap_err();
            assert!(error.to_string().contains("x,y,z"), "{error}");
        }
        let error = parameters.set("root", "7,8,9").unwrap_err();
        assert_eq!(error, ParameterError::TooManyPoints { name: "root", most: 1 });
        (2..1000).for_each(|_| parameters.set("include", "1,1,1").unwrap());
        let error = parameters.set("include", "1,1,1").unwrap_err();
        assert!(error.to_string().contains("at most 1000"), "{error}");
    }
}
