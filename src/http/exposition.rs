//! Prometheus' text format, version 0.0.4.

use std::fmt::Display;

use crate::jobs::Histogram;

/// The media type of the text.
pub const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// What every name begins with.
const PREFIX: &str = "rosaline_";

/// A text that grows by one family of samples after another.
#[derive(Default)]
pub struct Exposition {
    text: String,
    /// Of the family that is written.
    name: String,
}

impl Exposition {
    pub fn into_text(self) -> String {
        self.text
    }

    /// Begins the counter `rosaline_NAME`.
    pub fn counter(&mut self, name: &str, help: &str) {
        self.family(name, help, "counter");
    }

    /// Begins the gauge `rosaline_NAME`.
    pub fn gauge(&mut self, name: &str, help: &str) {
        self.family(name, help, "gauge");
    }

    /// Begins the histogram `rosaline_NAME`.
    pub fn histogram(&mut self, name: &str, help: &str) {
        self.family(name, help, "histogram");
    }

    fn family(&mut self, name: &str, help: &str, kind: &str) {
        self.name = format!("{PREFIX}{name}");
        self.text += &format!("# HELP {0} {help}\n# TYPE {0} {kind}\n", self.name);
    }

    /// A sample of the family.
    pub fn sample(&mut self, labels: &[(&str, &str)], value: impl Display) {
        self.named("", labels, value);
    }

    /// The samples of a histogram in the family.
    pub fn times(&mut self, labels: &[(&str, &str)], times: &Histogram) {
        let bounds = times.cumulative().map(|(bound, count)| (bound.to_string(), count));
        for (bound, count) in bounds.chain([("+Inf".to_owned(), times.count())]) {
            self.named("_bucket", &[labels, &[("le", &bound)]].concat(), count);
        }
        self.named("_sum", labels, times.seconds());
        self.named("_count", labels, times.count());
    }

    fn named(&mut self, suffix: &str, labels: &[(&str, &str)], value: impl Display) {
        let labels: Vec<String> =
            labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        self.text += &format!("{}{suffix}{labels} {value}\n", self.name);
    }
}

fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_family_has_its_kind_once_and_its_samples_behind() {
        let mut text = Exposition::default();
        text.gauge("jobs", "Jobs.");
        text.sample(&[("state", "a\"\\\nb")], 3);
        text.histogram("run_seconds", "Runs.");
        let mut times = Histogram::new(&[0.5, 2.0]);
        for millis in [100, 1000, 9000] {
            times.add(Duration::from_millis(millis));
        }
        text.times(&[("stage", "tips")], &times);
        let expected = "# HELP rosaline_jobs Jobs.\n# TYPE rosaline_jobs gauge\n\
                        rosaline_jobs{state=\"a\\\"\\\\\\nb\"} 3\n\
                        # HELP rosaline_run_seconds Runs.\n# TYPE rosaline_run_seconds histogram\n\
                        rosaline_run_seconds_bucket{stage=\"tips\",le=\"0.5\"} 1\n\
                        rosaline_run_seconds_bucket{stage=\"tips\",le=\"2\"} 2\n\
                        rosaline_run_seconds_bucket{stage=\"tips\",le=\"+Inf\"} 3\n\
                        rosaline_run_seconds_sum{stage=\"tips\"} 10.1\n\
                        rosaline_run_seconds_count{stage=\"tips\"} 3\n";
        assert_eq!(text.into_text(), expected);
    }
}
