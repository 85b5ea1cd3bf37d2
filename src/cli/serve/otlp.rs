//! The exporter of traces, where a collector is set (OTLP over HTTP, protobuf).

use std::time::Duration;

use opentelemetry::global::BoxedTracer;
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::SdkTracerProvider;

use super::super::Failure;
use crate::jobs::Spans;

/// How long the last spans may take on their way when the service ends.
const LAST: Duration = Duration::from_secs(3);

/// Sends spans from a thread of its own, which drops them where the collector does not keep up: requests and jobs
/// never wait for it. Dropping it sends what is left.
pub(super) struct Exporter(Option<SdkTracerProvider>);

impl Exporter {
    /// To the collector at this base URL; nowhere without one.
    ///
    /// # Errors
    /// When it is no URL that can be sent to.
    pub fn start(collector: Option<&str>) -> Result<Self, Failure> {
        let Some(collector) = collector.filter(|url| !url.is_empty()) else { return Ok(Self(None)) };
        let exporter = SpanExporter::builder()
            .with_http()
            .with_protocol(Protocol::HttpBinary)
            .with_endpoint(format!("{}/v1/traces", collector.trim_end_matches('/')))
            .build()
            .map_err(|error| {
                Failure::new(format!(
                    "cannot send traces to {collector}: {error}; give the collector's base URL, as http://127.0.0.1:4318"
                ))
            })?;
        // The environment's name goes before this one.
        let resource = match std::env::var_os("OTEL_SERVICE_NAME") {
            Some(_) => Resource::builder(),
            None => Resource::builder().with_service_name("rosaline"),
        };
        let provider = SdkTracerProvider::builder().with_batch_exporter(exporter);
        Ok(Self(Some(provider.with_resource(resource.build()).build())))
    }

    pub fn spans(&self) -> Spans {
        let tracer = |provider: &SdkTracerProvider| BoxedTracer::new(Box::new(provider.tracer("rosaline")));
        self.0.as_ref().map_or_else(Spans::default, |provider| Spans::to(tracer(provider)))
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        if let Some(provider) = self.0.take()
            && let Err(error) = provider.shutdown_with_timeout(LAST)
        {
            tracing::warn!(%error, "the last traces may not have been sent");
        }
    }
}
