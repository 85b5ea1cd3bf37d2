//! Results: negotiation, entity tags, ranges.

use std::io::Read;

use reqwest::{Method, RequestBuilder, StatusCode};

use crate::meshes;
use crate::service::{Service, problem};

async fn finished() -> (Service, String) {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    (service, format!("{job}/results/centerline"))
}

async fn content_type(request: RequestBuilder) -> String {
    let response = request.send().await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    response.headers()["content-type"].to_str().unwrap().to_owned()
}

#[tokio::test]
async fn accept_chooses_and_an_extension_beats_it() {
    let (service, result) = finished().await;
    for (accept, expected) in [
        ("*/*", "application/json"),
        ("model/gltf-binary", "model/gltf-binary"),
        ("model/gltf+json;q=0.9, application/json;q=0.1", "model/gltf+json"),
        ("text/html, model/*;q=0.5", "model/gltf-binary"),
    ] {
        assert_eq!(content_type(service.get(&result).header("accept", accept)).await, expected, "{accept}");
    }
    let glb = service.get(&format!("{result}.glb")).header("accept", "application/json");
    assert_eq!(content_type(glb).await, "model/gltf-binary");
    let response = service.get(&result).header("accept", "model/gltf-binary").send().await.unwrap();
    assert_eq!(response.headers()["vary"], "accept, accept-encoding");
    assert_eq!(response.headers()["content-location"], format!("{result}.glb"));
    assert_eq!(&response.bytes().await.unwrap()[..4], b"glTF");
    let response = service.get(&result).header("accept", "text/html").send().await.unwrap();
    assert_eq!(response.headers()["vary"], "accept");
    let body = problem(response, 406, "not-acceptable").await;
    assert_eq!(body["available"].as_array().unwrap().len(), 4);
    let response = service.get(&format!("{result}.obj")).send().await.unwrap();
    problem(response, 404, "not-found").await;
}

#[tokio::test]
async fn a_result_is_cached_by_its_entity_tag() {
    let (service, result) = finished().await;
    let mut tags = Vec::new();
    for extension in ["", ".json", ".gltf", ".glb", ".vtp"] {
        let path = format!("{result}{extension}");
        let response = service.get(&path).send().await.unwrap();
        assert_eq!(response.headers()["cache-control"], "private, max-age=31536000, immutable");
        let tag = response.headers()["etag"].clone();
        assert!(tag.to_str().unwrap().starts_with('"'), "a strong tag");
        let response = service.get(&path).header("if-none-match", &tag).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(response.headers()["etag"], tag);
        assert!(response.bytes().await.unwrap().is_empty());
        let response = service.get(&path).header("if-none-match", "\"other\"").send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK);
        tags.push(tag);
    }
    assert_eq!(tags[0], tags[1], "JSON either way");
    assert!(tags[1] != tags[2] && tags[2] != tags[3] && tags[3] != tags[4]);
}

#[tokio::test]
async fn ranges_are_parts_of_the_whole() {
    let (service, result) = finished().await;
    let path = format!("{result}.glb");
    let response = service.get(&path).send().await.unwrap();
    assert_eq!(response.headers()["accept-ranges"], "bytes");
    let tag = response.headers()["etag"].clone();
    let whole = response.bytes().await.unwrap();
    let length = whole.len();
    for (range, from, to) in [
        ("bytes=0-99".to_owned(), 0, 100),
        ("bytes=100-".to_owned(), 100, length),
        ("bytes=-7".to_owned(), length - 7, length),
        (format!("bytes=10-{}", length * 2), 10, length),
    ] {
        let response = service.get(&path).header("range", &range).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::PARTIAL_CONTENT, "{range}");
        assert_eq!(response.headers()["content-range"], format!("bytes {from}-{}/{length}", to - 1));
        assert_eq!(response.headers()["etag"], tag);
        assert_eq!(response.bytes().await.unwrap(), whole.slice(from..to), "{range}");
    }
    let response = service.get(&path).header("range", format!("bytes={length}-")).send().await.unwrap();
    assert_eq!(response.headers()["content-range"], format!("bytes */{length}"));
    problem(response, 416, "range-not-satisfiable").await;
    for (condition, status) in [(tag.to_str().unwrap(), 206), ("\"other\"", 200)] {
        let request = service.get(&path).header("range", "bytes=0-9").header("if-range", condition);
        assert_eq!(request.send().await.unwrap().status(), status);
    }
}

#[tokio::test]
async fn head_is_get_without_the_body() {
    let (service, result) = finished().await;
    let job = result.strip_suffix("/results/centerline").unwrap();
    for path in [&result, &format!("{result}.glb"), job, "/v1/jobs", "/healthz", "/readyz", "/openapi.yaml"] {
        let got = service.get(path).send().await.unwrap();
        let head =
            service.client.request(Method::HEAD, format!("{}{path}", service.url)).send().await.unwrap();
        assert_eq!(head.status(), got.status(), "{path}");
        for name in ["content-type", "content-length", "etag", "cache-control"] {
            assert_eq!(head.headers().get(name), got.headers().get(name), "{name} of {path}");
        }
        assert!(head.bytes().await.unwrap().is_empty());
    }
}

#[tokio::test]
async fn a_browser_may_read_what_it_needs() {
    let (service, result) = finished().await;
    let response = service.get(&result).header("origin", "https://viewer.example").send().await.unwrap();
    assert_eq!(response.headers()["access-control-allow-origin"], "*");
    let exposed = response.headers()["access-control-expose-headers"].to_str().unwrap().to_owned();
    for name in ["location", "etag", "retry-after", "link", "content-range", "preference-applied"] {
        assert!(exposed.split(',').any(|header| header == name), "{name}");
    }
    let preflight = service
        .client
        .request(Method::OPTIONS, format!("{}/v1/jobs", service.url))
        .header("origin", "https://viewer.example")
        .header("access-control-request-method", "POST")
        .header("access-control-request-headers", "content-type,prefer")
        .send()
        .await
        .unwrap();
    assert!(preflight.status().is_success());
    assert!(preflight.headers()["access-control-allow-methods"].to_str().unwrap().contains("DELETE"));
    let allowed = preflight.headers()["access-control-allow-headers"].to_str().unwrap().to_owned();
    assert!(["content-type", "prefer", "range", "if-none-match"].iter().all(|name| allowed.contains(name)));
    let response = service.post("/v1/jobs").header("origin", "https://viewer.example").send().await.unwrap();
    assert_eq!(response.headers()["access-control-allow-origin"], "*", "errors too");
}

/// Those that were compressed have tags, lengths and ranges of their own.
#[tokio::test]
async fn texts_come_compressed_where_that_is_asked_for() {
    let (service, result) = finished().await;
    let unpack = |coding: &str, bytes: &[u8]| {
        let mut text = Vec::new();
        match coding {
            "gzip" => drop(flate2::read::GzDecoder::new(bytes).read_to_end(&mut text).unwrap()),
            _ => text = zstd::decode_all(bytes).unwrap(),
        }
        text
    };
    for extension in [".json", ".gltf"] {
        let path = format!("{result}{extension}");
        let plain = service.get(&path).send().await.unwrap();
        assert_eq!(plain.headers()["vary"], "accept-encoding");
        let mut tags = vec![plain.headers()["etag"].clone()];
        let plain = plain.bytes().await.unwrap();
        for coding in ["gzip", "zstd"] {
            let asked = |method: Method| {
                let request = service.client.request(method, format!("{}{path}", service.url));
                request.header("accept-encoding", coding)
            };
            let response = asked(Method::GET).send().await.unwrap();
            let headers = response.headers().clone();
            assert_eq!(headers["content-encoding"], coding);
            assert_eq!(headers["vary"], "accept-encoding");
            let packed = response.bytes().await.unwrap();
            assert!(packed.len() < plain.len() && unpack(coding, &packed) == plain, "{coding}");
            assert_eq!(headers["content-length"], packed.len().to_string());
            let head = asked(Method::HEAD).send().await.unwrap();
            assert_eq!(head.headers()["etag"], headers["etag"]);
            assert_eq!(head.headers()["content-encoding"], coding);
            assert_eq!(head.headers()["content-length"], packed.len().to_string());
            let known = asked(Method::GET).header("if-none-match", &headers["etag"]).send().await.unwrap();
            assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
            let part = asked(Method::GET).header("range", "bytes=10-19").header("if-range", &headers["etag"]);
            let part = part.send().await.unwrap();
            assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
            assert_eq!(part.headers()["content-range"], format!("bytes 10-19/{}", packed.len()));
            assert_eq!(part.bytes().await.unwrap(), packed[10..20], "a range of the compressed bytes");
            let mixed = asked(Method::GET).header("range", "bytes=10-19").header("if-range", &tags[0]);
            assert_eq!(
                mixed.send().await.unwrap().status(),
                StatusCode::OK,
                "parts of two codings do not mix"
            );
            tags.push(headers["etag"].clone());
        }
        tags.dedup();
        assert_eq!(tags.len(), 3);
    }
    for (path, accept) in
        [(format!("{result}.glb"), "gzip, zstd"), (format!("{result}.json"), "br, gzip;q=0")]
    {
        let response = service.get(&path).header("accept-encoding", accept).send().await.unwrap();
        assert!(!response.headers().contains_key("content-encoding"), "{path}");
    }
}

/// RFC 9110, section 12.5.3.
#[tokio::test]
async fn the_result_as_it_is_can_be_ruled_out() {
    let (service, result) = finished().await;
    let asked = |path: &str, accept: &'static str| service.get(path).header("accept-encoding", accept).send();
    for (accept, coding) in
        [("identity;q=0, gzip", "gzip"), ("gzip;q=0.5, *;q=0", "gzip"), ("*, identity;q=0", "zstd")]
    {
        let response = asked(&result, accept).await.unwrap();
        assert_eq!(
            (response.status().as_u16(), &response.headers()["content-encoding"]),
            (200, &coding.parse().unwrap())
        );
    }
    for (path, vary) in
        [(result.clone(), "accept, accept-encoding"), (format!("{result}.gltf"), "accept-encoding")]
    {
        for accept in ["identity;q=0", "*;q=0", "br, identity;q=0"] {
            let response = asked(&path, accept).await.unwrap();
            assert_eq!(response.headers()["vary"], vary);
            let body = problem(response, 406, "not-acceptable").await;
            assert!(body["detail"].as_str().unwrap().contains("; leave identity;q=0"), "{body}");
        }
    }
    // It is not there compressed.
    problem(asked(&format!("{result}.glb"), "identity;q=0, gzip").await.unwrap(), 406, "not-acceptable")
        .await;
    assert_eq!(asked(&result, "*;q=0, identity;q=0.1").await.unwrap().status(), 200);
}

#[tokio::test]
async fn every_path_answers_options_and_what_can_be_got_answers_head() {
    let (service, result) = finished().await;
    let job = result.split("/results").next().unwrap().to_owned();
    let paths = ["/v1/jobs", "/v1/limits", "/healthz", "/readyz", "/openapi.yaml"].map(str::to_owned);
    let (events, retry) = (format!("{job}/events"), format!("{job}/retry"));
    for path in paths.into_iter().chain([job, events, retry.clone(), result.clone(), format!("{result}.glb")])
    {
        let url = format!("{}{path}", service.url);
        let preflight = service
            .client
            .request(Method::OPTIONS, &url)
            .header("origin", "https://viewer.example")
            .header("access-control-request-method", "POST")
            .header("access-control-request-headers", "content-type, idempotency-key, last-event-id")
            .send()
            .await
            .unwrap();
        assert_eq!(preflight.status(), StatusCode::OK, "{path}");
        let allowed = preflight.headers()["access-control-allow-methods"].to_str().unwrap().to_owned();
        assert!(["GET", "HEAD", "POST", "DELETE"].iter().all(|method| allowed.contains(method)), "{allowed}");
        if path != retry {
            let head = service.client.head(&url).send().await.unwrap();
            assert_eq!(head.status(), StatusCode::OK, "{path}");
            assert!(head.bytes().await.unwrap().is_empty());
        }
    }
}

/// A file that was cut short or changed on the disk is no result, in no form of the question.
#[tokio::test]
async fn a_result_that_is_not_what_was_stored_is_never_served() {
    let (service, result) = finished().await;
    let is_glb = |path: &std::path::PathBuf| path.extension().is_some_and(|extension| extension == "glb");
    let file = service.files().into_iter().find(is_glb).unwrap();
    let good = std::fs::read(&file).unwrap();
    let mut changed = good.clone();
    changed[good.len() / 2] ^= 1;
    for bad in [&good[..good.len() / 2], &good[..0], &changed, &[&good[..], b"x"].concat()] {
        std::fs::write(&file, bad).unwrap();
        let path = format!("{result}.glb");
        for range in ["bytes=0-", "bytes=0-9", "bytes=-9", "none"] {
            let response = service.get(&path).header("range", range).send().await.unwrap();
            problem(response, 500, "internal-error").await;
        }
        let response = service.get(&result).header("accept", "model/gltf-binary").send().await.unwrap();
        problem(response, 500, "internal-error").await;
        assert_eq!(service.client.head(format!("{}{path}", service.url)).send().await.unwrap().status(), 500);
        assert_eq!(service.get(&result).send().await.unwrap().status(), 200, "the JSON is whole");
    }
    let log = service.log_with("and some are others").await;
    assert!(log.contains(&format!("it has {} bytes, and had {}", good.len() / 2, good.len())), "{log}");
    assert!(log.contains(&format!("it has {} bytes as it had, and some are others", good.len())), "{log}");
    std::fs::write(&file, &good).unwrap();
    assert_eq!(service.get(&format!("{result}.glb")).send().await.unwrap().bytes().await.unwrap(), good);
    std::fs::remove_file(&file).unwrap();
    problem(service.get(&format!("{result}.glb")).send().await.unwrap(), 500, "internal-error").await;
}

/// RFC 9110, section 13.1.1.
#[tokio::test]
async fn a_result_that_is_another_than_if_match_names_is_not_sent() {
    let (service, result) = finished().await;
    for path in [result.clone(), format!("{result}.glb")] {
        let tag = service.get(&path).send().await.unwrap().headers()["etag"].to_str().unwrap().to_owned();
        let asked = |value: &str| service.get(&path).header("if-match", value);
        for value in [tag.as_str(), "*", &format!("\"other\", {tag}")] {
            assert_eq!(asked(value).send().await.unwrap().status(), 200, "{value}");
        }
        for value in ["\"other\"", &format!("W/{tag}")] {
            problem(asked(value).send().await.unwrap(), 412, "precondition-failed").await;
            let known = asked(value).header("if-none-match", &tag).header("range", "bytes=0-9");
            assert_eq!(known.send().await.unwrap().status(), 412, "it goes before the others");
            let head = service.client.head(format!("{}{path}", service.url)).header("if-match", value);
            assert_eq!(head.send().await.unwrap().status(), 412);
        }
    }
    let packed = service.get(&result).header("accept-encoding", "gzip");
    let tag = packed.send().await.unwrap().headers()["etag"].clone();
    let plain = service.get(&result).header("if-match", &tag).send().await.unwrap();
    problem(plain, 412, "precondition-failed").await;
}

/// As a version before VTP left it.
#[tokio::test]
async fn a_form_that_an_older_version_did_not_make_is_told_and_not_offered() {
    let (service, result) = finished().await;
    let job = result.strip_suffix("/results/centerline").unwrap().to_owned();
    let database = service.data().join("jobs.sqlite");
    let service = {
        let mut service = service;
        service.terminate();
        service.wait();
        forget_vtp(&database).await;
        service.restart(&[])
    };
    let links = service.status(&job).await["links"].to_string();
    assert!(links.contains("centerline.glb") && !links.contains("centerline.vtp"), "{links}");
    for coding in ["identity", "gzip, identity;q=0"] {
        let asked = service.get(&format!("{result}.vtp")).header("accept-encoding", coding);
        problem(asked.send().await.unwrap(), 404, "no-such-form").await;
    }
    let preferred = service.get(&result).header("accept", "model/vtk, application/json;q=0.5");
    assert_eq!(content_type(preferred).await, "application/json");
    let alone = service.get(&result).header("accept", "model/vtk").send().await.unwrap();
    assert_eq!(problem(alone, 406, "not-acceptable").await["available"].as_array().unwrap().len(), 3);
}

async fn forget_vtp(database: &std::path::Path) {
    use sqlx::{ConnectOptions, Row};
    let url = format!("sqlite://{}", database.display());
    let options: sqlx::sqlite::SqliteConnectOptions = url.parse().unwrap();
    let mut connection = options.connect().await.unwrap();
    let row = sqlx::query("SELECT artifacts FROM jobs").fetch_one(&mut connection).await.unwrap();
    let mut artifacts: Vec<serde_json::Value> = serde_json::from_str(row.get(0)).unwrap();
    artifacts.retain(|artifact| artifact["format"] != "vtp");
    let text = serde_json::to_string(&artifacts).unwrap();
    sqlx::query("UPDATE jobs SET artifacts = ?").bind(text).execute(&mut connection).await.unwrap();
}
