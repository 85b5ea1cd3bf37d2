//! The preset `default` on the shared phantoms is as good as it was: no figure is more than a tenth worse than in
//! tests/data/phantom_figures.json. Better ones pass. The table is made, never typed, by
//!
//! ```sh
//! ROSALINE_RENEW_FIGURES=1 cargo test --test phantom_figures
//! ```
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rosaline::centerline::{Control, Parameters, extract};
use rosaline::compare::{Count, Line, Measures, measure};
use rosaline::mesh::Units;
use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::output::{ResultDocument, Source};
use serde::{Deserialize, Serialize};

/// What a figure may be worse by where a tenth of it is less: distances in % of the diagonal, shares, radii.
const FLOORS: [(&str, f64); 6] = [
    ("O_mean", 0.002),
    ("O_max", 0.02),
    ("missed", 0.02),
    ("not covered", 0.002),
    ("excess", 0.002),
    ("radius", 0.002),
];
const TOLERANCE: f64 = 1.1;

/// The figures of one phantom, in the order of [`FLOORS`], and how far its counts are from the known ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Figures {
    errors: BTreeMap<String, f64>,
    /// Tips, loops and parts more or fewer than known.
    miscounted: BTreeMap<String, usize>,
}

impl Figures {
    fn of(measures: &Measures) -> Self {
        let Measures { o_mean, o_max, missed, cover, excess, radius, .. } = measures;
        let values = [o_mean.percent, o_max.percent, missed.percent, 1.0 - cover, *excess, *radius];
        // Six digits: what is below comes from another compiler or processor.
        let error = |((name, _), value): ((&str, f64), f64)| (name.to_owned(), (value * 1e6).round() / 1e6);
        let wrong = |(name, count): (&str, Count)| (name.to_owned(), count.truth.abs_diff(count.result));
        let counts = [("tips", measures.tips), ("loops", measures.loops), ("parts", measures.parts)];
        Self {
            errors: FLOORS.into_iter().zip(values).map(error).collect(),
            miscounted: counts.into_iter().map(wrong).collect(),
        }
    }

    /// What is worse than in `before`, a line each.
    fn worse(&self, before: &Self) -> Vec<String> {
        let mut worse = Vec::new();
        for (name, floor) in FLOORS {
            let (was, is) = (before.errors[name], self.errors[name]);
            if is > (TOLERANCE * was).max(was + floor) {
                worse.push(format!("{name} {is} (was {was})"));
            }
        }
        for (name, is) in &self.miscounted {
            if is > &before.miscounted[name] {
                worse.push(format!("{name} off by {is} (was {})", before.miscounted[name]));
            }
        }
        worse
    }
}

type Table = BTreeMap<String, Figures>;

fn table_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/phantom_figures.json")
}

/// The phantoms' surfaces, by name, where their known line lies beside them.
fn phantoms(folder: &Path) -> BTreeMap<String, PathBuf> {
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let surfaces = paths.filter(|path| path.extension().is_some_and(|extension| extension == "stl"));
    let known = surfaces.filter(|path| path.with_extension("gt.json").is_file());
    known.map(|path| (path.file_stem().unwrap().to_string_lossy().into_owned(), path)).collect()
}

fn figures(surface: &Path) -> Figures {
    let truth = Line::read(&std::fs::read(surface.with_extension("gt.json")).unwrap()).unwrap();
    let (mesh, format) = read(&std::fs::read(surface).unwrap(), Hint::default(), &Limits::default()).unwrap();
    let parameters = Parameters::default();
    let found = extract(&mesh, &parameters, &Control::silent()).unwrap();
    let source = Source { name: None, format: format.name(), sha256: "", units: Units::Millimetres };
    let line = Line::of(&ResultDocument::new(&found, &source, &parameters)).unwrap();
    Figures::of(&measure(&truth, &line).unwrap())
}

#[test]
fn no_figure_of_the_phantoms_is_a_tenth_worse() {
    let Some(folder) = common::shared().map(|shared| shared.join("phantoms")) else { return };
    let found: Table = phantoms(&folder).into_iter().map(|(name, path)| (name, figures(&path))).collect();
    if std::env::var_os("ROSALINE_RENEW_FIGURES").is_some() {
        std::fs::write(table_path(), serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
        println!("renewed {}", table_path().display());
        return;
    }
    let before: Table = serde_json::from_slice(&std::fs::read(table_path()).unwrap()).unwrap();
    for name in before.keys().filter(|name| !found.contains_key(*name)) {
        println!("skipped: {name} is not in {}", folder.display());
    }
    let mut worse = Vec::new();
    for (name, figures) in &found {
        match before.get(name) {
            Some(before) => worse.extend(figures.worse(before).iter().map(|line| format!("{name}: {line}"))),
            None => worse.push(format!("{name}: not in the table; renew it")),
        }
    }
    assert!(worse.is_empty(), "worse than tests/data/phantom_figures.json:\n{}", worse.join("\n"));
}

fn table_row(value: f64, tips: usize) -> Figures {
    Figures {
        errors: FLOORS.iter().map(|(name, _)| ((*name).to_owned(), value)).collect(),
        miscounted: BTreeMap::from([("tips".to_owned(), tips)]),
    }
}

#[test]
fn a_tenth_and_a_little_may_go_and_better_is_never_worse() {
    let before = table_row(1.0, 1);
    assert_eq!(table_row(1.09, 1).worse(&before), Vec::<String>::new());
    assert_eq!(table_row(0.5, 0).worse(&before), Vec::<String>::new());
    assert_eq!(table_row(1.11, 1).worse(&before).len(), FLOORS.len());
    assert_eq!(table_row(1.0, 2).worse(&before), ["tips off by 2 (was 1)"]);
    // Next to nothing may double.
    assert_eq!(table_row(0.0019, 0).worse(&table_row(0.0, 0)), Vec::<String>::new());
    let far = table_row(0.0021, 0).worse(&table_row(0.0, 0));
    assert_eq!(far.len(), 4, "all but the two largest distances: {far:?}");
}
