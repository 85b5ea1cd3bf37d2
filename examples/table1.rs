//! The paper's Fig. 12 experiment: a known centerline, a surface made from it, and how far the line that is
//! extracted from the surface is from the known one. Prints the paper's Table 1, then ours, as Markdown.
//!
//!     cargo run --release --example table1
//!
//! The vessels are the project's own phantoms; nothing but this program is needed.

use std::error::Error;

use rosaline::centerline::{Control, Extraction, Parameters, Preset, extract};
use rosaline::compare::{Length, Line, measure};
use rosaline::mesh::Units;
use rosaline::output::{ResultDocument, Source};
use rosaline::phantom::{Kind, Phantom, Settings, generate};

/// A model of the paper's Table 1: name, diagonal, and O_max, O_mean, O_var each with the printed percentage.
type Printed = (&'static str, f64, [(f64, f64); 3]);

const PRINTED: [Printed; 7] = [
    ("Fig. 11 (1)", 3.1702, [(0.02765, 0.8722), (0.001717, 0.05419), (0.008808, 0.27785)]),
    ("Fig. 11 (2)", 9.8725, [(0.06552, 0.6637), (0.03214, 0.3256), (0.01769, 0.1792)]),
    ("Fig. 11 (3)", 8.2614, [(0.08473, 1.0256), (0.007658, 0.0927), (0.01914, 0.2317)]),
    ("Fig. 11 (4)", 6.6704, [(0.02287, 0.3428), (0.004322, 0.0648), (0.008784, 0.1317)]),
    ("Fig. 11 (5)", 5.2036, [(0.060996, 0.3174), (0.016952, 0.08821), (0.031238, 0.16255)]),
    ("Fig. 11 (6)", 10.3814, [(0.076367, 0.7928), (0.023288, 0.24176), (0.03009, 0.31235)]),
    ("Fig. 12", 8.3278, [(0.05609, 0.4731), (0.01155, 0.09618), (0.021922, 0.18256)]),
];

const SEEDS: [u64; 3] = [1, 2, 3];

fn main() -> Result<(), Box<dyn Error>> {
    paper_table();
    experiment()?;
    ablations()
}

/// The printed rows; where the percentage is not that of the absolute figure, the right one in bold beside it.
fn paper_table() {
    println!("| model of the paper | L_dia | O_max | O_mean | O_var |\n| --- | --- | --- | --- | --- |");
    for (name, diagonal, figures) in PRINTED {
        let cell = |(absolute, printed): (f64, f64)| {
            let percent = 100.0 * absolute / diagonal;
            let wrong = (percent / printed - 1.0).abs() > 0.01;
            let mended = if wrong { format!("; **{percent:.4} %**") } else { String::new() };
            format!("{absolute} ({printed} %{mended})")
        };
        println!("| {name} | {diagonal} | {} |", figures.map(cell).join(" | "));
    }
}

/// Our Fig. 12 for vessels without and with loops and sacs, both presets.
fn experiment() -> Result<(), Box<dyn Error>> {
    println!("\n| phantom | L_dia, mm | preset | O_max, mm | O_mean, mm | O_var, mm | tips |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for kind in [Kind::Bifurcation, Kind::Tree, Kind::Trifurcation, Kind::Loop, Kind::Aneurysm] {
        for seed in SEEDS {
            let phantom = generate(kind, seed, &Settings::of(kind))?;
            for preset in [Preset::Paper, Preset::Default] {
                println!("| {kind}, seed {seed} | {}", row(&phantom, preset, &Parameters::of(preset))?);
            }
        }
    }
    Ok(())
}

/// What one parameter changes.
fn ablations() -> Result<(), Box<dyn Error>> {
    let clean = Settings::of(Kind::Tree);
    let surfaces = [
        ("tree, seed 1", clean),
        ("tree, seed 1, stairs", Settings { stair: true, ..clean }),
        ("tree, seed 1, noise 0.2", Settings { noise: 0.2, ..clean }),
    ];
    let changes: [(Preset, &[(&str, &str)]); 6] = [
        (Preset::Default, &[("smoothing", "true")]),
        (Preset::Paper, &[("smoothing", "true")]),
        (Preset::Paper, &[("omega", "0.7"), ("omega", "0.8")]),
        (Preset::Paper, &[("delta_h", "0.0"), ("delta_h", "0.9")]),
        (Preset::Paper, &[("d_cut", "0.005"), ("d_cut", "0.05")]),
        (Preset::Paper, &[("m", "1.5"), ("m", "3.0")]),
    ];
    println!("\n| phantom | L_dia, mm | preset | O_max, mm | O_mean, mm | O_var, mm | tips | set |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for (name, settings) in surfaces {
        let phantom = generate(Kind::Tree, 1, &settings)?;
        for preset in [Preset::Default, Preset::Paper] {
            println!("| {name} | {} - |", row(&phantom, preset, &Parameters::of(preset))?);
        }
        for (preset, values) in changes {
            for &(parameter, value) in values {
                let mut parameters = Parameters::of(preset);
                parameters.set(parameter, value)?;
                let row = row(&phantom, preset, &parameters)?;
                println!("| {name} | {row} `{parameter}` = {value} |");
            }
        }
    }
    Ok(())
}

/// The rest of a row: diagonal, preset, and the figures of the extracted line.
fn row(phantom: &Phantom, preset: Preset, parameters: &Parameters) -> Result<String, Box<dyn Error>> {
    let found = extract(&phantom.mesh, parameters, &Control::silent())?;
    let measures = measure(&line(&phantom.extraction())?, &line(&found)?)?;
    let cell = |Length { absolute, percent }: Length| format!("{absolute:.4} ({percent:.4} %)");
    let lengths = [measures.o_max, measures.o_mean, measures.o_var].map(cell).join(" | ");
    let (tips, diagonal) = (measures.tips, measures.diagonal);
    Ok(format!("{diagonal:.4} | `{preset}` | {lengths} | {} of {} |", tips.result, tips.truth))
}

fn line(extraction: &Extraction) -> Result<Line, Box<dyn Error>> {
    let source = Source { name: None, format: "stl", sha256: "", units: Units::Millimetres };
    Ok(Line::of(&ResultDocument::new(extraction, &source, &Parameters::default()))?)
}
