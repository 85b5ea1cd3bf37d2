//! `rosaline compare`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use crate::compare::{Count, Length, Line, Measures, measure};

use super::{Failure, files};

/// Each file is rosaline JSON, known polylines with `l_dia`, `tips` and `loops`, or VMTK's centerlines (VTP).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The known centerline.
    truth: PathBuf,
    /// The centerline to measure.
    result: PathBuf,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

/// Prints the measures; a bad figure is not a failure.
pub fn run(args: Args) -> Result<(), Failure> {
    let measures = measure(&read(&args.truth)?, &read(&args.result)?)?;
    let text = if args.json { serde_json::to_string(&measures)? + "\n" } else { table(&measures) };
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}

fn read(path: &Path) -> Result<Line, Failure> {
    let bytes = files::read(path)?;
    Line::read(&bytes).map_err(|error| Failure::new(format!("{}: {error}", path.display())))
}

fn table(measures: &Measures) -> String {
    let units = measures.units.as_deref().unwrap_or("mesh units");
    let mut text = format!("{:<8} {:>12} {:>16}\n", "", units, "% of diagonal");
    let lengths = [
        ("O_max", measures.o_max),
        ("O_mean", measures.o_mean),
        ("O_var", measures.o_var),
        ("missed", measures.missed),
    ];
    // Writing to a String cannot fail.
    for (name, Length { absolute, percent }) in lengths {
        let _ = writeln!(text, "{name:<8} {absolute:>12.6} {percent:>16.4}");
    }
    let shares = [
        ("cover", measures.cover, "of the known length is within half the local radius of the result"),
        ("excess", measures.excess, "of the result is farther than that from the known line"),
        ("radius", measures.radius, "mean relative error"),
    ];
    for (name, share, meaning) in shares {
        let _ = writeln!(text, "{name:<8} {share:>12.4}  {meaning}");
    }
    let counts = [("tips", measures.tips), ("loops", measures.loops), ("parts", measures.parts)];
    for (name, Count { truth, result }) in counts {
        let _ = writeln!(text, "{name:<8} {result:>12}  of {truth}");
    }
    let _ = writeln!(text, "diagonal {:>12.4} {units}", measures.diagonal);
    text
}
