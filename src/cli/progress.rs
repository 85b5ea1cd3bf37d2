//! What a person sees of a running extraction: a bar, and the time of each stage.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Map;

use crate::centerline::{Part, Progress, Stage};

/// Steps of the bar in one stage.
const STEPS: f64 = 100.0;

/// Follows an extraction.
pub(super) struct Watch {
    bar: ProgressBar,
    clock: Mutex<Clock>,
}

/// Gives the time between two reports to the stage of the first.
struct Clock {
    stage: Option<usize>,
    since: Instant,
    spent: [Duration; Stage::ALL.len()],
}

impl Watch {
    /// A bar is drawn only where stderr is a terminal.
    pub fn start() -> Self {
        let bar = if std::io::stderr().is_terminal() {
            let steps = STEPS as u64 * Stage::ALL.len() as u64;
            let style = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg}");
            ProgressBar::new(steps).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        } else {
            ProgressBar::hidden()
        };
        let clock = Clock { stage: None, since: Instant::now(), spent: Default::default() };
        Self { bar, clock: Mutex::new(clock) }
    }

    /// Takes a report, from any thread.
    pub fn report(&self, progress: Progress) {
        let place = index(progress.stage);
        let fraction = progress.fraction.clamp(0.0, 1.0);
        let position = position(place, fraction, progress.part);
        // Reports of one stage may arrive out of order; the bar never goes back.
        if position > self.bar.position() {
            self.bar.set_position(position);
        }
        // A panic elsewhere leaves the clock readable.
        let mut clock = self.clock.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if clock.stage != Some(place) {
            clock.switch(Some(place));
            self.bar.set_message(progress.stage.name());
        }
    }

    /// Removes the bar and answers the time of each stage.
    pub fn finish(self) -> Vec<(&'static str, Duration)> {
        self.bar.finish_and_clear();
        let mut clock = self.clock.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        clock.switch(None);
        Stage::ALL.iter().zip(clock.spent).map(|(stage, spent)| (stage.name(), spent)).collect()
    }
}

impl Clock {
    fn switch(&mut self, to: Option<usize>) {
        let now = Instant::now();
        if let Some(stage) = self.stage {
            self.spent[stage] += now - self.since;
        }
        self.stage = to;
        self.since = now;
    }
}

/// Steps of the bar: those of the stages after preparation are shared out over the components.
fn position(place: usize, fraction: f64, part: Part) -> u64 {
    let (all, first) = (Stage::ALL.len() as f64, 1.0);
    let mut done = place as f64 + fraction;
    if done >= first {
        done = first + (all - first) * part.overall((done - first) / (all - first));
    }
    (STEPS * done) as u64
}

fn index(stage: Stage) -> usize {
    Stage::ALL.iter().position(|&other| other == stage).unwrap_or_default()
}

/// One line a stage, and their sum.
pub(super) fn table(timings: &[(&'static str, Duration)]) -> String {
    let mut text = String::new();
    let total: Duration = timings.iter().map(|(_, spent)| *spent).sum();
    for (name, spent) in timings.iter().chain([&("total", total)]) {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{name:<20} {:>9.3} s", spent.as_secs_f64());
    }
    text
}

/// The seconds of each stage, and their sum.
pub(super) fn seconds(timings: &[(&'static str, Duration)]) -> serde_json::Value {
    let total: Duration = timings.iter().map(|(_, spent)| *spent).sum();
    let all = timings.iter().copied().chain([("total", total)]);
    all.map(|(name, spent)| (name.to_owned(), spent.as_secs_f64().into())).collect::<Map<_, _>>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stage_gets_the_time_until_the_next_one_reports() {
        let watch = Watch::start();
        let report = |stage, fraction| watch.report(Progress { stage, fraction, part: Part::WHOLE });
        report(Stage::Preparation, 0.0);
        std::thread::sleep(Duration::from_millis(20));
        report(Stage::Preparation, 1.0);
        report(Stage::Tips, 0.0);
        report(Stage::CutPlanes, 0.5);
        std::thread::sleep(Duration::from_millis(10));
        let timings = watch.finish();
        assert_eq!(timings.len(), Stage::ALL.len());
        let of = |name| timings.iter().find(|(other, _)| *other == name).unwrap().1;
        assert!(of("preparation") >= Duration::from_millis(20));
        assert!(of("cut_planes") >= Duration::from_millis(10));
        assert_eq!(of("segmentation"), Duration::ZERO);
    }

    #[test]
    fn the_bar_goes_on_over_the_components() {
        let half = |before| Part { before, share: 0.5 };
        let last = Stage::ALL.len() - 1;
        assert_eq!(position(0, 1.0, Part::WHOLE), 100);
        assert_eq!(position(1, 0.0, half(0.0)), 100);
        assert_eq!(position(last, 1.0, half(0.0)), 500);
        assert_eq!(position(1, 0.0, half(0.5)), 500);
        assert_eq!(position(last, 1.0, half(0.5)), 900);
    }

    #[test]
    fn the_table_ends_with_the_sum() {
        let text = table(&[("reading", Duration::from_millis(250)), ("tips", Duration::from_millis(1500))]);
        assert_eq!(text.lines().count(), 3);
        assert!(text.ends_with("total                    1.750 s\n"), "{text}");
    }
}
