//! Dry runs: what is wrong with a mesh, without a job.

use reqwest::multipart::{Form, Part};
use rosaline::mesh::TriangleMesh;
use serde_json::{Value, json};

use crate::meshes;
use crate::service::{Service, problem};
use crate::submission::assert_fits;

async fn inspect(service: &Service, mesh: Vec<u8>) -> Value {
    let response = service.submit("?dry_run=true", mesh).await;
    assert_eq!(response.status(), 200);
    assert!(!response.headers().contains_key("location"));
    let body: Value = response.json().await.unwrap();
    assert_fits("Inspection", &body);
    body
}

fn defects(inspection: &Value) -> Vec<(&str, u64, Vec<u64>)> {
    let list = inspection["defects"].as_array().unwrap().iter();
    list.map(|defect| {
        let indices =
            defect["indices"].as_array().unwrap().iter().map(|index| index.as_u64().unwrap()).collect();
        (defect["code"].as_str().unwrap(), defect["count"].as_u64().unwrap(), indices)
    })
    .collect()
}

#[tokio::test]
async fn every_defect_is_named_with_its_count_and_places_and_no_job_is_made() {
    let service = Service::start(&[]);
    let sound = meshes::tube(20, 8);
    let body = inspect(&service, meshes::stl(&sound)).await;
    assert_eq!(body["acceptable"], true);
    assert_eq!((&body["vertices"], &body["triangles"]), (&json!(160), &json!(304)));
    assert_eq!((&body["openings"], &body["genus"], &body["components"]), (&json!(2), &json!(0), &json!(1)));
    assert_eq!(body["format"], "stl");
    assert!(defects(&body).is_empty(), "{body}");

    let mut broken: TriangleMesh = sound.clone();
    let first = broken.triangles[0];
    broken.triangles.push(first);
    broken.triangles.push([first[0], first[0], first[1]]);
    // More than are kept: wound against all others.
    for triangle in &mut broken.triangles[100..140] {
        triangle.swap(0, 1);
    }
    let body = inspect(&service, meshes::stl(&broken)).await;
    assert_eq!(body["acceptable"], true, "{body}");
    let found = defects(&body);
    assert!(found.contains(&("degenerate-triangles", 1, vec![305])), "{body}");
    assert!(found.contains(&("duplicate-triangles", 1, vec![304])), "{body}");
    assert!(found.contains(&("flipped-triangles", 40, (100..124).collect())), "{body}");

    let mut tiny = sound.clone();
    tiny.vertices.iter_mut().for_each(|vertex| *vertex *= 1e-36);
    let body = inspect(&service, meshes::stl(&tiny)).await;
    assert_eq!((&body["acceptable"], defects(&body)), (&json!(false), vec![("out-of-scale", 160, vec![])]));

    let flat = TriangleMesh { triangles: vec![[0, 0, 1]], ..sound };
    let body = inspect(&service, meshes::stl(&flat)).await;
    assert_eq!(
        (&body["acceptable"], &body["defects"][0]["repaired"]),
        (&json!(false), &json!(false)),
        "{body}"
    );
    assert_eq!(defects(&body)[0].0, "all-degenerate");

    let mut far: TriangleMesh = meshes::tube(20, 8);
    // The second that the file names.
    far.vertices[8].y = 1e30;
    let body = inspect(&service, meshes::stl(&far)).await;
    assert_eq!(
        (&body["acceptable"], defects(&body)),
        (&json!(false), vec![("far-out", 1, vec![1])]),
        "{body}"
    );

    let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"], json!([]));
    service.assert_no_files().await;
}

#[tokio::test]
async fn what_is_refused_of_a_job_is_refused_of_a_dry_run() {
    let service = Service::start(&[]);
    problem(service.submit("?dry_run=true", b"\x89PNG\r\n\x1a\n".to_vec()).await, 415, "unsupported-format")
        .await;
    problem(service.submit("?dry_run=true&omega=7", meshes::small()).await, 400, "invalid-parameter").await;
    problem(service.submit("?dry_run=yes", meshes::small()).await, 400, "invalid-parameter").await;
    let form = Form::new()
        .part("parameters", Part::text(r#"{"dry_run": true}"#))
        .part("mesh", Part::bytes(meshes::small()));
    assert_eq!(service.post("/v1/jobs").multipart(form).send().await.unwrap().status(), 200);
    service.assert_no_files().await;
}
