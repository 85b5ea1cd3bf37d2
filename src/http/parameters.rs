//! A job's parameters, from the query or from the `parameters` part of a multipart upload.

use std::fmt;
use std::str::FromStr;

use axum::extract::Query;
use axum::http::Uri;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::Value;
use serde_json::error::Category;

use super::limits::Limits;
use super::problem::{INVALID_PARAMETER, MALFORMED_REQUEST, Problem, UNKNOWN_PARAMETER};
use crate::centerline::{POINTS, ParameterKind, Parameters, Preset, TABLE, shown};
use crate::jobs::{FileName, Priority};
use crate::mesh::Units;

/// Names that are no rows of the method's table.
pub const UNITS: &str = "units";
pub const NAME: &str = "name";
pub const PRESET: &str = "preset";
pub const CLIENT_REFERENCE: &str = "client_reference";
pub const PRIORITY: &str = "priority";
pub const DRY_RUN: &str = "dry_run";
const OTHERS: [&str; 6] = [UNITS, NAME, PRESET, CLIENT_REFERENCE, PRIORITY, DRY_RUN];

/// What a client asks of the job, beside the mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    pub units: Units,
    pub name: Option<FileName>,
    pub parameters: Parameters,
    /// The client's own word for the job, opaque.
    pub client_reference: Option<String>,
    pub priority: Priority,
    /// No job is to be made.
    pub dry_run: bool,
}

impl Asked {
    /// From name and value pairs, as the query gives them.
    ///
    /// # Errors
    /// A 400 that names the parameter: unknown, given twice, or with a value that it cannot take.
    pub fn from_pairs(pairs: &[(String, String)], limits: &Limits) -> Result<Self, Problem> {
        for (place, (name, _)) in pairs.iter().enumerate() {
            // First of all: of names that are known, there are not many before one comes twice.
            if !names().any(|known| known == name) {
                return Err(unknown(name));
            }
            let is_list = POINTS.iter().any(|spec| spec.name == name && spec.most > 1);
            if !is_list && pairs[..place].iter().any(|(other, _)| other == name) {
                return Err(invalid(name, format!("{name} is given twice; give it once")));
            }
        }
        let value =
            |wanted: &str| pairs.iter().find(|(name, _)| name == wanted).map(|(_, value)| value.as_str());
        let units: Units = word(UNITS, value(UNITS))?;
        let preset: Preset = word(PRESET, value(PRESET))?;
        let mut parameters = Parameters::of(preset);
        let rows = pairs.iter().filter(|(name, _)| !OTHERS.contains(&name.as_str()));
        for (name, text) in rows {
            parameters.set(name, text).map_err(|error| invalid(name, error.to_string()))?;
        }
        let name = value(NAME).map(|name| source_name(name, limits)).transpose()?.flatten();
        let client_reference = value(CLIENT_REFERENCE).map(|text| reference(text, limits)).transpose()?;
        let priority = word(PRIORITY, value(PRIORITY))?;
        let dry_run = match value(DRY_RUN) {
            None | Some("false") => false,
            Some("true") => true,
            Some(_) => return Err(invalid(DRY_RUN, "dry_run is true or false".to_owned())),
        };
        Ok(Self { units, name, parameters, client_reference, priority, dry_run })
    }
}

/// The decoded query, in order.
///
/// # Errors
/// 400 where it is no query, or not UTF-8: what is no text must not be kept as another one.
pub fn query_pairs(uri: &Uri) -> Result<Vec<(String, String)>, Problem> {
    if !is_utf8(uri.query().unwrap_or_default()) {
        return Err(Problem::new(&MALFORMED_REQUEST, "the query is not UTF-8; encode its text as UTF-8"));
    }
    let query = Query::<Vec<(String, String)>>::try_from_uri(uri);
    query
        .map(|Query(pairs)| pairs)
        .map_err(|error| Problem::new(&MALFORMED_REQUEST, format!("the query cannot be read: {error}")))
}

/// Whether a query is UTF-8 once its percent signs are resolved.
fn is_utf8(query: &str) -> bool {
    let bytes = query.as_bytes();
    let (mut decoded, mut at) = (Vec::with_capacity(bytes.len()), 0);
    while let Some(&byte) = bytes.get(at) {
        let digits = bytes.get(at + 1..at + 3).filter(|digits| digits.iter().all(u8::is_ascii_hexdigit));
        let escaped = digits.and_then(|digits| u8::from_str_radix(str::from_utf8(digits).ok()?, 16).ok());
        match (byte, escaped) {
            (b'%', Some(value)) => {
                decoded.push(value);
                at += 3;
            }
            _ => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    str::from_utf8(&decoded).is_ok()
}

/// An object's members in order, with those that have one name.
struct Members(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Members {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Object;

        impl<'de> Visitor<'de> for Object {
            type Value = Members;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Members, A::Error> {
                let mut members = Vec::new();
                while let Some(member) = map.next_entry()? {
                    members.push(member);
                }
                Ok(Members(members))
            }
        }

        deserializer.deserialize_map(Object)
    }
}

/// Name and value pairs of a JSON object with the same names: `{"units": "mm", "omega": 0.8, "smoothing": true}`.
///
/// # Errors
/// A 400 when it is no such object.
pub fn json_pairs(bytes: &[u8]) -> Result<Vec<(String, String)>, Problem> {
    let malformed = |detail: String| Problem::new(&MALFORMED_REQUEST, detail);
    let Members(members) = serde_json::from_slice(bytes).map_err(|error| match error.classify() {
        Category::Data => malformed("the part 'parameters' is not a JSON object".to_owned()),
        _ => malformed(format!("the part 'parameters' is not JSON: {error}")),
    })?;
    let mut pairs: Vec<(String, String)> = Vec::new();
    for (name, value) in members {
        if pairs.iter().any(|(other, _)| *other == name) {
            return Err(invalid(&name, format!("{} is given twice; give it once", shown(&name))));
        }
        if let Some(spec) = POINTS.iter().find(|spec| spec.name == name) {
            let expected = match spec.most {
                1 => "one text \"x,y,z\", no list",
                _ => "a text \"x,y,z\", or a list of such texts",
            };
            let texts = point_texts(value, spec.most > 1).ok_or_else(|| wrong_type(&name, expected))?;
            pairs.extend(texts.into_iter().map(|text| (name.clone(), text)));
            continue;
        }
        let kind = TABLE.iter().find(|spec| spec.name == name).map(|spec| spec.kind);
        let text = match (kind, value) {
            (Some(ParameterKind::Number { .. }), Value::Number(number)) => number.to_string(),
            (Some(ParameterKind::Flag), Value::Bool(flag)) => flag.to_string(),
            (None, Value::Bool(flag)) if name == DRY_RUN => flag.to_string(),
            (None, _) if name == DRY_RUN => return Err(wrong_type(&name, "true or false")),
            (None, Value::String(text)) => text,
            (Some(ParameterKind::Number { .. }), _) => return Err(wrong_type(&name, "a number")),
            (Some(ParameterKind::Flag), _) => return Err(wrong_type(&name, "true or false")),
            (None, _) if OTHERS.contains(&name.as_str()) => return Err(wrong_type(&name, "a text")),
            (None, _) => return Err(unknown(&name)),
        };
        pairs.push((name, text));
    }
    Ok(pairs)
}

/// The points of a JSON value, each as the query spells it; `None` when it is no such value.
fn point_texts(value: Value, is_list: bool) -> Option<Vec<String>> {
    let text = |value| if let Value::String(text) = value { Some(text) } else { None };
    match value {
        Value::Array(values) if is_list => values.into_iter().map(text).collect(),
        other => Some(vec![text(other)?]),
    }
}

/// As [`FileName::of`] takes it.
///
/// # Errors
/// A 400 when it is empty, too long, or holds control characters.
pub fn source_name(name: &str, limits: &Limits) -> Result<Option<FileName>, Problem> {
    FileName::of(name, limits.name_chars).map_err(|error| invalid(NAME, error.to_string()))
}

/// A client's own word for a job.
pub(super) fn reference(text: &str, limits: &Limits) -> Result<String, Problem> {
    if text.is_empty() || text.chars().count() > limits.reference_chars || text.chars().any(char::is_control)
    {
        let most = limits.reference_chars;
        let expected = format!("a reference has 1 to {most} characters and no control characters");
        return Err(invalid(CLIENT_REFERENCE, expected));
    }
    Ok(text.to_owned())
}

/// The value of a parameter that takes one of a few words; its default where it is not given.
fn word<T: FromStr<Err: ToString> + Default>(name: &str, text: Option<&str>) -> Result<T, Problem> {
    text.map_or(Ok(T::default()), |text| {
        text.parse().map_err(|error: T::Err| invalid(name, error.to_string()))
    })
}

fn invalid(name: &str, detail: String) -> Problem {
    Problem::new(&INVALID_PARAMETER, detail).with("parameter", shown(name))
}

fn wrong_type(name: &str, expected: &str) -> Problem {
    invalid(name, format!("in JSON, {name} is {expected}"))
}

/// All that there are.
fn names() -> impl Iterator<Item = &'static str> {
    let (rows, points) = (TABLE.iter().map(|spec| spec.name), POINTS.iter().map(|spec| spec.name));
    OTHERS.into_iter().chain(rows).chain(points)
}

fn unknown(name: &str) -> Problem {
    let known: Vec<&str> = names().collect();
    let detail = format!("there is no parameter '{}'; the known ones are {}", shown(name), known.join(", "));
    Problem::new(&UNKNOWN_PARAMETER, detail).with("parameter", shown(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(list: &[(&str, &str)]) -> Result<Asked, Value> {
        let pairs: Vec<_> = list.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
        Asked::from_pairs(&pairs, &Limits::default())
            .map_err(|problem| serde_json::to_value(problem).unwrap())
    }

    #[test]
    fn a_query_sets_what_it_names_over_its_preset() {
        let asked =
            pairs(&[("omega", "0.8"), ("units", "cm"), ("preset", "paper"), ("name", "C:\\x\\aorta.stl")]);
        let asked = asked.unwrap();
        assert_eq!(asked.units, "cm".parse().unwrap());
        assert_eq!(asked.parameters.preset(), Preset::Paper);
        assert_eq!(asked.parameters.omega(), 0.8);
        assert_eq!(asked.name.unwrap().expose(), "aorta.stl");
    }

    #[test]
    fn refusals_name_the_parameter() {
        for (list, kind, name) in [
            (vec![("omgea", "0.8")], "unknown-parameter", "omgea"),
            (vec![("omgea", "0.8"), ("omgea", "0.8")], "unknown-parameter", "omgea"),
            (vec![("omega", "7")], "invalid-parameter", "omega"),
            (vec![("omega", "NaN")], "invalid-parameter", "omega"),
            (vec![("units", "furlong")], "invalid-parameter", "units"),
            (vec![("preset", "best")], "invalid-parameter", "preset"),
            (vec![("name", "a\nb")], "invalid-parameter", "name"),
            (vec![("mu", "0.5"), ("mu", "0.5")], "invalid-parameter", "mu"),
        ] {
            let problem = pairs(&list).unwrap_err();
            assert_eq!(problem["type"], format!("urn:rosaline:problem:{kind}"), "{list:?}");
            assert_eq!(problem["parameter"], name);
            assert_eq!(problem["status"], 400);
        }
    }

    #[test]
    fn points_come_one_a_pair_or_in_a_list() {
        let query = pairs(&[("include", "1,2,3"), ("root", "0,0,0"), ("include", "-4,5e1,6")]).unwrap();
        assert_eq!(query.parameters.include().len(), 2);
        let json = br#"{"include": ["1,2,3", "-4,5e1,6"], "root": "0,0,0"}"#;
        assert_eq!(Asked::from_pairs(&json_pairs(json).unwrap(), &Limits::default()).unwrap(), query);
        for (list, name) in [
            (vec![("root", "0,0,0"), ("root", "1,1,1")], "root"),
            (vec![("exclude", "1,2")], "exclude"),
            (vec![("include", "1,2,inf")], "include"),
            (vec![("include", "1e308,0,0")], "include"),
            (vec![("root", "0,0,-1.1e30")], "root"),
        ] {
            assert_eq!(pairs(&list).unwrap_err()["parameter"], name);
        }
        for (bad, shape) in [
            (&br#"{"include": [[1, 2, 3]]}"#[..], "include is a text \"x,y,z\", or a list of such texts"),
            (br#"{"exclude": 1}"#, "or a list of such texts"),
            (br#"{"root": ["1,2,3"]}"#, "root is one text \"x,y,z\", no list"),
            (br#"{"root": [[1, 2, 3]]}"#, "no list"),
        ] {
            let problem = serde_json::to_value(json_pairs(bad).unwrap_err()).unwrap();
            assert!(problem["detail"].as_str().unwrap().ends_with(shape), "{problem}");
        }
    }

    #[test]
    fn json_takes_the_same_names() {
        let json = br#"{"units": "um", "omega": 0.8, "smoothing": true}"#;
        let asked = Asked::from_pairs(&json_pairs(json).unwrap(), &Limits::default()).unwrap();
        let query = pairs(&[("units", "um"), ("omega", "0.8"), ("smoothing", "true")]).unwrap();
        assert_eq!(asked, query);
        for bad in [
            &b"[1]"[..],
            b"{",
            b"",
            b"\xff",
            br#"{"omega": [1]}"#,
            br#"{"omega": "0.8"}"#,
            br#"{"smoothing": 1}"#,
            br#"{"name": null}"#,
            br#"{"omgea": 1}"#,
            br#"{"omega": 0.7, "omega": 0.8}"#,
            br#"{"omega": 0.7, "omeg\u0061": 0.8}"#,
        ] {
            assert!(json_pairs(bad).is_err());
        }
    }
}
