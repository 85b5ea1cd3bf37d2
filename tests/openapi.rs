//! openapi.yaml against the code, and against the service that runs.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[path = "common/service.rs"]
#[allow(dead_code, reason = "shared with the tests of the service, which use all of it")]
mod service;

use std::path::Path;

use reqwest::Method;
use rosaline::centerline::{POINTS, ParameterKind, TABLE};
use rosaline::http::document;
use serde_json::Value;
use service::Service;

fn document_json() -> Value {
    serde_json::to_value(document::document()).unwrap()
}

/// Every path with its methods, in capitals.
fn operations(document: &Value) -> Vec<(String, Method, Value)> {
    let mut list = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let method = method.to_uppercase().parse().unwrap();
            list.push((path.clone(), method, operation.clone()));
        }
    }
    list
}

#[test]
fn the_committed_document_is_the_generated_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi.yaml");
    let committed = std::fs::read_to_string(path).unwrap();
    let same = committed == document::yaml();
    assert!(same, "openapi.yaml differs from the code; run: cargo run -- openapi > openapi.yaml");
}

#[tokio::test]
async fn the_service_serves_the_committed_document() {
    let service = Service::start(&[]);
    let response = service.get("/openapi.yaml").send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "application/yaml");
    let tag = response.headers()["etag"].clone();
    assert_eq!(response.text().await.unwrap(), document::yaml());
    let again = service.get("/openapi.yaml").header("if-none-match", tag).send().await.unwrap();
    assert_eq!(again.status(), 304);
}

/// What is documented is routed, and what is routed is documented.
#[tokio::test]
async fn documented_operations_are_those_that_answer() {
    let service = Service::start(&[]);
    let document = document_json();
    let documented = operations(&document);
    assert!(documented.len() >= 12, "{}", documented.len());
    for path in document["paths"].as_object().unwrap().keys() {
        let url = format!("{}{}", service.url, path.replace("{id}", "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1"));
        for method in ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"] {
            let method: Method = method.parse().unwrap();
            let response = service.client.request(method.clone(), &url).send().await.unwrap();
            let status = response.status().as_u16();
            let operation = documented.iter().find(|(other, verb, _)| other == path && *verb == method);
            let Some((_, _, operation)) = operation else {
                assert_eq!(status, 405, "{method} {path} is routed and not documented");
                continue;
            };
            assert!(operation["responses"].get(status.to_string()).is_some(), "{method} {path}: {status}");
            assert_ne!(status, 405, "{method} {path} is documented and not routed");
            if method != Method::HEAD && status == 404 {
                let body: Value = response.json().await.unwrap();
                let what = if path.starts_with("/v1/webhooks") { "webhook" } else { "job" };
                assert_eq!(body["type"], format!("urn:rosaline:problem:{what}-not-found"), "{method} {path}");
            }
        }
    }
}

#[test]
fn every_operation_says_what_it_takes_and_answers() {
    let document = document_json();
    let mut ids = Vec::new();
    for (path, method, operation) in operations(&document) {
        assert!(operation["summary"].is_string(), "{method} {path}");
        ids.push(operation["operationId"].as_str().unwrap().to_owned());
        let responses = operation["responses"].as_object().unwrap();
        assert!(responses.keys().any(|status| status.starts_with('2')), "{method} {path}");
        for (status, response) in responses {
            assert!(!response["description"].as_str().unwrap().is_empty(), "{method} {path} {status}");
            let is_error = status.starts_with(['4', '5']);
            if is_error && method != Method::HEAD {
                let schema = &response["content"]["application/problem+json"]["schema"]["$ref"];
                assert_eq!(schema, "#/components/schemas/Problem", "{method} {path} {status}");
            }
        }
        for parameter in operation["parameters"].as_array().unwrap_or(&Vec::new()) {
            assert!(parameter["description"].is_string() && parameter["schema"].is_object(), "{parameter}");
        }
    }
    let count = ids.len();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), count, "operation ids are unique");
}

#[test]
fn points_are_lists_of_texts_or_one() {
    let document = document_json();
    let query = document["paths"]["/v1/jobs"]["post"]["parameters"].as_array().unwrap().clone();
    let form = &document["components"]["schemas"]["JobParameters"]["properties"];
    for spec in POINTS {
        let parameter = query.iter().find(|parameter| parameter["name"] == spec.name).unwrap();
        assert!(parameter["description"].as_str().unwrap().starts_with(spec.doc), "{}", spec.name);
        for schema in [&parameter["schema"], &form[spec.name]] {
            if spec.most > 1 {
                assert_eq!(
                    (schema["type"].as_str(), schema["maxItems"].as_u64()),
                    (Some("array"), Some(spec.most as u64))
                );
            } else {
                assert_eq!(schema["type"], "string");
            }
        }
    }
}

#[test]
fn the_methods_parameters_are_those_of_the_table() {
    let document = document_json();
    let query = document["paths"]["/v1/jobs"]["post"]["parameters"].as_array().unwrap().clone();
    let form = &document["components"]["schemas"]["JobParameters"]["properties"];
    for spec in TABLE {
        let parameter = query.iter().find(|parameter| parameter["name"] == spec.name).unwrap();
        assert!(parameter["description"].as_str().unwrap().starts_with(spec.doc), "{}", spec.name);
        for schema in [&parameter["schema"], &form[spec.name]] {
            match spec.kind {
                ParameterKind::Flag => assert_eq!(schema["type"], "boolean"),
                ParameterKind::Number { min, max } => {
                    assert_eq!(schema["minimum"].as_f64(), Some(min), "{}", spec.name);
                    assert_eq!(schema["maximum"].as_f64(), Some(max));
                    assert_eq!(schema["default"].as_f64(), Some(spec.default.unwrap_or(spec.paper)));
                }
            }
        }
    }
}

/// Examples are of the schema that they stand beside.
#[test]
fn examples_fit_their_schemas() {
    let document = document_json();
    let mut tried = 0;
    for (path, method, operation) in operations(&document) {
        for (status, response) in operation["responses"].as_object().unwrap() {
            for (media_type, content) in response["content"].as_object().into_iter().flatten() {
                let one = content.get("example").into_iter();
                let named = content["examples"]
                    .as_object()
                    .into_iter()
                    .flatten()
                    .map(|(_, example)| &example["value"]);
                // Without a schema anything goes: a part of a file is of no type.
                let schema = serde_json::json!({
                    "$schema": "https://json-schema.org/draft/2020-12/schema",
                    "allOf": [content.get("schema").unwrap_or(&Value::Bool(true))],
                    "components": document["components"],
                });
                let validator = jsonschema::validator_for(&schema).unwrap();
                for example in one.chain(named) {
                    tried += 1;
                    let faults: Vec<_> =
                        validator.iter_errors(example).map(|error| error.to_string()).collect();
                    assert!(faults.is_empty(), "{method} {path} {status} {media_type}: {faults:?}");
                }
            }
        }
    }
    assert!(tried > 40, "{tried}");
}
