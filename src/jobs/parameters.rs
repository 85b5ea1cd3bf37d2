//! A job's parameters as the store keeps them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::centerline::{ParameterError, ParameterKind, Parameters, TABLE};

/// A preset and parameter values as the store keeps them: by name, so that they outlive the table's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterValues {
    pub preset: String,
    pub values: BTreeMap<String, f64>,
    /// Points by the name of their parameter; none that is empty.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub points: BTreeMap<String, Vec<[f64; 3]>>,
}

impl From<&Parameters> for ParameterValues {
    fn from(parameters: &Parameters) -> Self {
        // Also what was set in vain: the result warns of it.
        let values = parameters.iter().chain(parameters.unused());
        Self {
            preset: parameters.preset().name().to_owned(),
            values: values.map(|(spec, value)| (spec.name.to_owned(), value)).collect(),
            points: parameters
                .points()
                .map(|(spec, points)| {
                    (spec.name.to_owned(), points.iter().map(|&point| point.into()).collect())
                })
                .collect(),
        }
    }
}

impl TryFrom<&ParameterValues> for Parameters {
    type Error = ParameterError;

    /// Values that a newer version added take their preset's default.
    fn try_from(stored: &ParameterValues) -> Result<Self, ParameterError> {
        let mut parameters = Parameters::of(stored.preset.parse()?);
        for (name, value) in &stored.values {
            let spec = TABLE.iter().find(|spec| spec.name == name);
            let text = match spec.map(|spec| spec.kind) {
                Some(ParameterKind::Flag) => (*value != 0.0).to_string(),
                _ => value.to_string(),
            };
            parameters.set(name, &text)?;
        }
        for (name, points) in &stored.points {
            for [x, y, z] in points {
                parameters.set(name, &format!("{x},{y},{z}"))?;
            }
        }
        Ok(parameters)
    }
}

#[cfg(test)]
mod tests {
    use crate::centerline::Preset;

    use super::*;

    #[test]
    fn parameters_survive_the_store() {
        let mut parameters = Parameters::of(Preset::Paper);
        parameters.set("omega", "0.8000000000000003").unwrap();
        parameters.set("smoothing", "true").unwrap();
        for (name, point) in
            [("include", "0.1,-2e-7,3"), ("include", "1,2,3"), ("root", "4.000000000000001,5,6")]
        {
            parameters.set(name, point).unwrap();
        }
        let json = serde_json::to_string(&ParameterValues::from(&parameters)).unwrap();
        let stored: ParameterValues = serde_json::from_str(&json).unwrap();
        assert_eq!(Parameters::try_from(&stored), Ok(parameters));
        let mut in_vain = Parameters::default();
        in_vain.set("omega", "0.8").unwrap();
        let restored = Parameters::try_from(&ParameterValues::from(&in_vain)).unwrap();
        assert_eq!(
            restored.unused().map(|(spec, value)| (spec.name, value)).collect::<Vec<_>>(),
            [("omega", 0.8)]
        );
    }

    #[test]
    fn a_parameter_of_another_version_is_named() {
        let mut stored = ParameterValues::from(&Parameters::default());
        stored.values.insert("gone".to_owned(), 1.0);
        let error = Parameters::try_from(&stored).unwrap_err();
        assert!(error.to_string().contains("'gone'"), "{error}");
        stored.values.clear();
        assert_eq!(Parameters::try_from(&stored), Ok(Parameters::default()), "missing ones take the default");
    }
}
