//! Traces (OpenTelemetry): one from an upload to its job's result, also across restarts.
//!
//! A span names an operation, a stage or an outcome, and the job's id. File names, paths and queries as sent may be
//! patient data: none is ever given to a span.

use std::collections::HashMap;
use std::fmt;
use std::sync::Arc;
use std::time::SystemTime;

use opentelemetry::global::BoxedTracer;
use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{Span as _, Status, TraceContextExt, Tracer as _};
use opentelemetry::{Context, KeyValue, Value};
use opentelemetry_sdk::propagation::TraceContextPropagator;

pub use opentelemetry::trace::SpanKind;

/// The header and the member that names a span to its children (W3C Trace Context, section 3.2).
pub const TRACEPARENT: &str = "traceparent";

/// Where spans go: nowhere, unless the operator set it.
#[derive(Clone, Default)]
pub struct Spans(Option<Arc<BoxedTracer>>);

impl fmt::Debug for Spans {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Spans(on)" } else { "Spans(off)" })
    }
}

impl Spans {
    pub fn to(tracer: BoxedTracer) -> Self {
        Self(Some(Arc::new(tracer)))
    }

    /// Whether spans go anywhere.
    pub fn are_on(&self) -> bool {
        self.0.is_some()
    }

    /// A span that begins now, below the one that `traceparent` names; what is no such name is passed over.
    pub fn begin(&self, name: impl Into<String>, kind: SpanKind, traceparent: Option<&str>) -> Span {
        Span(self.0.as_ref().map(|tracer| {
            let parent = parent(traceparent);
            let builder = tracer.span_builder(name.into()).with_kind(kind);
            Live {
                tracer: tracer.clone(),
                context: parent.with_span(builder.start_with_context(tracer.as_ref(), &parent)),
            }
        }))
    }

    /// A span of what is over, below the one that `traceparent` names.
    pub fn past(&self, name: &'static str, traceparent: Option<&str>, begin: SystemTime, end: SystemTime) {
        if let Some(tracer) = &self.0 {
            past(tracer, &parent(traceparent), name, begin, end);
        }
    }
}

/// The context that a `traceparent` names.
fn parent(traceparent: Option<&str>) -> Context {
    let Some(text) = traceparent else { return Context::new() };
    let carrier = HashMap::from([(TRACEPARENT.to_owned(), text.to_owned())]);
    TraceContextPropagator::new().extract_with_context(&Context::new(), &carrier)
}

fn past(tracer: &BoxedTracer, parent: &Context, name: &'static str, begin: SystemTime, end: SystemTime) {
    let builder = tracer.span_builder(name).with_start_time(begin);
    builder.start_with_context(tracer, parent).end_with_timestamp(end);
}

/// A span that goes on until its last clone is dropped; nothing where spans go nowhere.
#[derive(Clone, Default)]
pub struct Span(Option<Live>);

#[derive(Clone)]
struct Live {
    tracer: Arc<BoxedTracer>,
    context: Context,
}

impl Span {
    /// A span below this one that begins now.
    pub fn child(&self, name: &'static str) -> Span {
        Span(self.0.as_ref().map(|Live { tracer, context }| {
            let span = tracer.start_with_context(name, context);
            Live { tracer: tracer.clone(), context: context.with_span(span) }
        }))
    }

    /// A span of what is over, below this one.
    pub fn past(&self, name: &'static str, begin: SystemTime, end: SystemTime) {
        if let Some(Live { tracer, context }) = &self.0 {
            past(tracer, context, name, begin, end);
        }
    }

    /// Says something of the span: never a client's text.
    pub fn set(&self, key: &'static str, value: impl Into<Value>) {
        if let Some(live) = &self.0 {
            live.context.span().set_attribute(KeyValue::new(key, value));
        }
    }

    /// What was done went wrong.
    pub fn fail(&self) {
        if let Some(live) = &self.0 {
            live.context.span().set_status(Status::error(""));
        }
    }

    /// The span's name for children elsewhere.
    pub fn traceparent(&self) -> Option<String> {
        let live = self.0.as_ref()?;
        let mut carrier = HashMap::new();
        TraceContextPropagator::new().inject_context(&live.context, &mut carrier);
        carrier.remove(TRACEPARENT)
    }
}

#[cfg(test)]
mod tests {
    use opentelemetry::trace::TracerProvider;
    use opentelemetry_sdk::trace::SdkTracerProvider;

    use super::*;

    #[test]
    fn a_span_belongs_to_the_trace_that_the_client_named() {
        let provider = SdkTracerProvider::builder().build();
        let spans = Spans::to(BoxedTracer::new(Box::new(provider.tracer("test"))));
        let trace = "4bf92f3577b34da6a3ce929d0e0e4736";
        let given = format!("00-{trace}-00f067aa0ba902b7-01");
        let span = spans.begin("a", SpanKind::Server, Some(&given));
        let own = span.child("b").traceparent().unwrap();
        assert!(own.starts_with(&format!("00-{trace}-")) && own != given, "{own}");
        for broken in [None, Some(""), Some("doe jane"), Some("00-0-0-01")] {
            let own = spans.begin("a", SpanKind::Server, broken).traceparent().unwrap();
            assert!(own.len() == given.len() && !own.contains(trace), "{own}");
        }
    }

    #[test]
    fn where_spans_go_nowhere_there_are_none() {
        let span = Spans::default().begin("a", SpanKind::Server, None).child("b");
        assert_eq!(span.traceparent(), None);
    }
}
