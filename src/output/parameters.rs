//! Values of parameters, as users see them.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::centerline::ParameterKind;

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum ParameterValue {
    Flag(bool),
    Number(f64),
    /// Points in the mesh's coordinates, for the parameters that name places.
    Points(Vec<[f64; 3]>),
}

impl From<&[Point3<f64>]> for ParameterValue {
    fn from(points: &[Point3<f64>]) -> Self {
        Self::Points(points.iter().map(|&point| point.into()).collect())
    }
}

/// A number of the table as its kind shows it.
pub(super) fn parameter_value(kind: ParameterKind, value: f64) -> ParameterValue {
    match kind {
        ParameterKind::Flag => ParameterValue::Flag(value != 0.0),
        ParameterKind::Number { .. } => ParameterValue::Number(value),
    }
}
