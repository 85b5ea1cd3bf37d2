//! Bodies shown in the document.

use serde_json::{Value, json};

const JOB: &str = "/v1/jobs/019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1";

/// A job that waits.
pub fn accepted() -> Value {
    json!({
        "id": "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1", "status": "accepted", "progress": 0, "stage": null,
        "created": "2026-11-22T05:25:58.123Z", "started": null, "updated": "2026-11-22T05:25:58.123Z",
        "finished": null, "error": null, "priority": "normal",
        "links": [{"rel": "self", "href": JOB, "type": "application/json"}],
    })
}

/// A job that ended well.
pub fn successful() -> Value {
    let result = |extension: &str, kind: &str| json!({"rel": "results", "href": format!("{JOB}/results/centerline.{extension}"), "type": kind});
    json!({
        "id": "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1", "status": "successful", "progress": 100,
        "stage": null, "created": "2026-11-22T05:25:58.123Z", "started": "2026-11-22T05:25:58.130Z",
        "updated": "2026-11-22T05:25:59.201Z", "finished": "2026-11-22T05:25:59.201Z", "error": null,
        "priority": "normal",
        "links": [
            {"rel": "self", "href": JOB, "type": "application/json"},
            result("json", "application/json"), result("glb", "model/gltf-binary"), result("gltf", "model/gltf+json"),
            result("vtp", "model/vtk"),
        ],
    })
}

/// A job that was cancelled before it ran.
pub fn dismissed() -> Value {
    let mut job = accepted();
    job["status"] = json!("dismissed");
    job["finished"] = json!("2026-11-22T05:26:01.500Z");
    job["updated"] = json!("2026-11-22T05:26:01.500Z");
    job
}

/// A page with an older one behind it.
pub fn page() -> Value {
    let next = "/v1/jobs?limit=1&cursor=019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1";
    json!({
        "jobs": [successful()],
        "links": [{"rel": "next", "href": next, "type": "application/json"}],
    })
}

/// The centerline of a slightly flat tube.
pub fn centerline() -> Value {
    json!({
        "schema": "rosaline.centerline/1", "units": "mm",
        "source": {
            "name": "tube.stl", "format": "stl",
            "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
            "vertices": 642, "triangles": 1280, "components": 1, "genus": 0, "openings": 2, "diagonal": 20.4,
        },
        "method": {"preset": "default", "parameters": parameters(), "version": env!("CARGO_PKG_VERSION")},
        "nodes": [
            {"id": 0, "kind": "end", "position": [0.0, 0.0, 0.0], "radius": 1.0, "equivalent_radius": 1.2, "degree": 1},
            {"id": 1, "kind": "end", "position": [20.0, 0.0, 0.0], "radius": 1.0, "equivalent_radius": 1.2, "degree": 1},
        ],
        "branches": [{
            "id": 0, "from": 0, "to": 1, "length": 20.0,
            "points": [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [20.0, 0.0, 0.0]], "radii": [1.0, 1.0, 1.0],
            "equivalent_radii": [1.2, 1.2, 1.2],
        }],
        "quality": {
            "homotopy": {"components": 1, "genus": 0, "parts": 1, "loops": 0, "equal": true}, "inside": 1.0,
            "centeredness": {"mean": 0.0004, "max": 0.0016, "sections": 28}, "coverage": 1.0, "thinness": true,
        },
        "warnings": [],
    })
}

/// Every parameter with its default, as a result shows them.
fn parameters() -> Value {
    use crate::centerline::{ParameterKind, Parameters};
    let values = Parameters::default();
    let members = values.iter().map(|(spec, value)| {
        let value = match spec.kind {
            ParameterKind::Flag => json!(value != 0.0),
            ParameterKind::Number { .. } => json!(value),
        };
        (spec.name.to_owned(), value)
    });
    Value::Object(members.collect())
}

/// A mesh with a defect.
pub fn inspection() -> Value {
    json!({
        "acceptable": true, "format": "stl",
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08", "bytes": 64084,
        "vertices": 642, "triangles": 1281, "components": 1, "genus": 0, "openings": 2, "diagonal": 20.4,
        "defects": [{
            "code": "duplicate-triangles", "count": 1, "of": "triangle", "indices": [1280], "repaired": true,
            "detail": "it repeats another; left out",
        }],
    })
}

/// A service that answers.
pub fn health() -> Value {
    json!({"status": "ok", "version": env!("CARGO_PKG_VERSION")})
}
