//! The API's table of contents: every route, its documentation, and what stands around them all.

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::counters::Counters;
use super::operations::{
    delete, events, health, limits, list, metrics, openapi, result, retry, status, submit, webhooks,
};
use super::problem::{INTERNAL_ERROR, METHOD_NOT_ALLOWED, NOT_FOUND, Problem};
use super::{App, access, cors, crowd, document, host, lingering, trace};
use crate::jobs::Spans;

/// Every route; each brings its own part of the document.
pub fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(document::base())
        .routes(routes!(submit::submit, list::list))
        .routes(routes!(status::status, delete::delete))
        .routes(routes!(events::events))
        .routes(routes!(retry::retry))
        .routes(routes!(result::negotiated))
        .routes(routes!(result::json))
        .routes(routes!(result::gltf))
        .routes(routes!(result::glb))
        .routes(routes!(result::vtp))
        .routes(routes!(limits::limits))
        .routes(routes!(metrics::metrics))
        .routes(routes!(webhooks::dead))
        .routes(routes!(webhooks::resend))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(openapi::openapi))
}

/// The whole service.
pub fn router(app: App) -> Router {
    let (router, _) = routes().split_for_parts();
    let router = router.fallback(not_found).method_not_allowed_fallback(method_not_allowed);
    let admitted = middleware::from_fn_with_state(app.clone(), access::admit);
    let turned_away = middleware::from_fn_with_state(app.clone(), crowd::turn_away);
    let watched = (app.counters().clone(), app.jobs().spans().clone());
    wrapped(router.with_state(app).layer(admitted).layer(turned_away), watched)
}

/// What stands around every route.
fn wrapped(router: Router, watched: (Counters, Spans)) -> Router {
    router
        // Uploads are streams with a limit of their own.
        .layer(DefaultBodyLimit::disable())
        .layer(CatchPanicLayer::custom(|_: Box<dyn std::any::Any + Send>| panicked()))
        .layer(cors::layer())
        // Around what answers preflights.
        .layer(middleware::from_fn(host::check))
        .layer(middleware::from_fn(lingering::linger))
        .layer(middleware::from_fn_with_state(watched, trace::log))
}

async fn not_found() -> Problem {
    Problem::new(&NOT_FOUND, "there is nothing at this path; /openapi.yaml lists what there is")
}

async fn method_not_allowed(request: Request) -> Problem {
    let method = request.method();
    Problem::new(&METHOD_NOT_ALLOWED, format!("{method} does not apply here; `Allow` lists what does"))
}

/// The panic's message stays out: it may quote the mesh. The process's panic hook logs where it was.
fn panicked() -> Response {
    Problem::new(&INTERNAL_ERROR, "the service is at fault, not the request; its log has the place")
        .into_response()
}

#[cfg(test)]
mod tests {
    use axum::body::{Body, to_bytes};
    use axum::http::{StatusCode, header};
    use axum::routing::get;
    use tower::ServiceExt;

    use super::*;

    async fn panics() -> StatusCode {
        panic!("the name of a patient")
    }

    #[tokio::test]
    async fn a_panic_is_a_problem_without_its_message() {
        let router = wrapped(Router::new().route("/", get(panics)), Default::default());
        let request = Request::builder().header(header::HOST, "x").body(Body::empty()).unwrap();
        let response = router.oneshot(request).await.unwrap();
        assert_eq!(response.status(), StatusCode::INTERNAL_SERVER_ERROR);
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
        assert_eq!(response.headers()[header::ACCESS_CONTROL_ALLOW_ORIGIN], "*");
        let body = to_bytes(response.into_body(), 10_000).await.unwrap();
        let body: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(body["type"], "urn:rosaline:problem:internal-error");
        assert!(!body.to_string().contains("patient"));
    }
}
