//! From a mesh to its centerline.

use reqwest::multipart::{Form, Part};
use reqwest::{Response, StatusCode};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::meshes;
use crate::service::Service;

/// Asserts that `value` fits the schema `name` of the API's document.
pub fn assert_fits(name: &str, value: &Value) {
    let document = serde_json::to_value(rosaline::http::document::document()).unwrap();
    let schema = serde_json::json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$ref": format!("#/components/schemas/{name}"),
        "components": document["components"],
    });
    let validator = jsonschema::validator_for(&schema).unwrap();
    let faults: Vec<_> = validator.iter_errors(value).map(|error| error.to_string()).collect();
    assert!(faults.is_empty(), "{faults:?}");
}

async fn centerline(service: &Service, job: &str) -> Value {
    let response = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    response.json().await.unwrap()
}

#[tokio::test]
async fn a_mesh_becomes_a_centerline() {
    let service = Service::start(&[]);
    let mesh = meshes::small();
    let request =
        service.post("/v1/jobs?units=cm&omega=0.8&name=tube.stl").header("content-type", "model/stl");
    let response = request.body(mesh.clone()).send().await.unwrap();
    assert_eq!(response.status(), StatusCode::CREATED);
    let job = response.headers()["location"].to_str().unwrap().to_owned();
    assert_eq!(response.headers()["retry-after"], "1");
    let accepted: Value = response.json().await.unwrap();
    assert_fits("JobStatus", &accepted);
    assert_eq!(accepted["status"], "accepted");
    assert_eq!(job, format!("/v1/jobs/{}", accepted["id"].as_str().unwrap()));
    assert_eq!(accepted["links"][0]["href"], job);

    let status = service.ended(&job).await;
    assert_fits("JobStatus", &status);
    assert_eq!(status["status"], "successful", "{status}");
    assert_eq!(status["progress"], 100);
    assert!(status["error"].is_null() && status["finished"].is_string() && status["started"].is_string());

    let result = centerline(&service, &job).await;
    assert_fits("ResultDocument", &result);
    let digest: String = Sha256::digest(&mesh).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(result["source"]["sha256"], digest);
    assert_eq!(result["source"]["name"], "tube.stl");
    assert_eq!(result["source"]["openings"], 2);
    assert_eq!(result["units"], "cm");
    // The preset has no use for it, and says so.
    assert!(result["method"]["parameters"]["omega"].is_null());
    assert!(result["warnings"].to_string().contains("unused-parameter"), "{}", result["warnings"]);
    assert_eq!(result["branches"].as_array().unwrap().len(), 1);
    assert_eq!(result["nodes"].as_array().unwrap().len(), 2);

    for link in status["links"].as_array().unwrap() {
        let response = service.get(link["href"].as_str().unwrap()).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{link}");
        assert_eq!(response.headers()["content-type"], link["type"].as_str().unwrap());
    }
}

async fn post_form(service: &Service, form: Form) -> Response {
    let request = service.post("/v1/jobs?tip_height=2&smoothing=true").header("prefer", "wait=60");
    request.multipart(form).send().await.unwrap()
}

#[tokio::test]
async fn a_form_may_have_its_parts_in_any_order() {
    let service = Service::start(&[]);
    let mesh = || Part::bytes(meshes::small()).file_name("C:\\scans\\aorta.STL");
    let parameters = || Part::text(r#"{"units": "um", "tip_height": 1.5, "client_reference": "a"}"#);
    let forms = [
        Form::new().part("mesh", mesh()).part("parameters", parameters()),
        Form::new().part("parameters", parameters()).part("mesh", mesh()),
    ];
    for form in forms {
        let response = post_form(&service, form).await;
        assert_eq!(response.status(), StatusCode::CREATED);
        let status: Value = response.json().await.unwrap();
        assert_eq!(status["status"], "successful", "{status}");
        let result = centerline(&service, status["links"][0]["href"].as_str().unwrap()).await;
        assert_eq!(result["source"]["name"], "aorta.STL");
        assert_eq!(result["units"], "um");
        assert_eq!(result["method"]["parameters"]["tip_height"], 1.5, "the form overrides the query");
        assert_eq!(result["method"]["parameters"]["smoothing"], true);
    }
    let response = post_form(&service, Form::new().part("mesh", mesh())).await;
    assert_eq!(response.status(), StatusCode::CREATED);
    assert!(!service.log().contains("aorta"), "{}", service.log());
}

#[tokio::test]
async fn a_client_may_wait_for_the_end() {
    let service = Service::start(&[]);
    let request = service.post("/v1/jobs").header("prefer", "wait=60").header("content-type", "model/stl");
    let response = request.body(meshes::small()).send().await.unwrap();
    assert_eq!(response.status(), StatusCode::CREATED);
    assert_eq!(response.headers()["preference-applied"], "wait=60");
    assert!(!response.headers().contains_key("retry-after"));
    let status: Value = response.json().await.unwrap();
    assert_eq!(status["status"], "successful", "{status}");

    let request = service.post("/v1/jobs").header("prefer", "wait=0").header("content-type", "model/stl");
    let response = request.body(meshes::small()).send().await.unwrap();
    // A worker may be ahead of the answer: `wait=0` promises no wait, not that nothing has happened yet.
    assert_eq!(response.status(), StatusCode::CREATED);
    assert_eq!(response.headers()["preference-applied"], "wait=0");
}

#[tokio::test]
async fn the_same_mesh_gives_the_same_bytes() {
    let service = Service::start(&["--workers", "1", "--threads", "2"]);
    let mut results = Vec::new();
    for _ in 0..2 {
        let job = service.accepted("", meshes::small()).await;
        assert_eq!(service.ended(&job).await["status"], "successful");
        let response = service.get(&format!("{job}/results/centerline.glb")).send().await.unwrap();
        results.push(response.bytes().await.unwrap());
    }
    assert!(results[0] == results[1] && !results[0].is_empty());
}

#[tokio::test]
async fn a_surface_without_a_centerline_fails_with_its_own_problem() {
    let service = Service::start(&[]);
    let job = service.accepted("?name=ball.stl", meshes::ball()).await;
    let status = service.ended(&job).await;
    assert_fits("JobStatus", &status);
    assert_eq!(status["status"], "failed", "{status}");
    assert_eq!(status["error"]["type"], "urn:rosaline:problem:not-tubular");
    assert_eq!(status["error"]["instance"], job);
    for extension in ["", ".json", ".gltf", ".glb", ".vtp"] {
        let response = service.get(&format!("{job}/results/centerline{extension}")).send().await.unwrap();
        let problem = crate::service::problem(response, 422, "not-tubular").await;
        assert_eq!(problem, status["error"]);
    }
}
