//! `rosaline extract`.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::json;
use sha2::{Digest, Sha256};

use crate::centerline::{self, CancelToken, Control, Extraction, Parameters};
use crate::http;
use crate::jobs::{BadName, FileName};
use crate::mesh::format::{self, Format, Hint, Limits};
use crate::mesh::{TriangleMesh, Units};
use crate::output::{self, OutputFormat, ResultDocument, Source};

use super::numbers::whole;
use super::parameters::ParameterArgs;
use super::progress::{self, Watch};
use super::{Failure, files};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// The surface: STL, OBJ, PLY, glTF, GLB, VTP, VTK or OFF.
    mesh: PathBuf,
    /// Where the centerline goes; .json, .glb, .gltf or .vtp says in which format.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Name that the result has as its source, without its folders [default: none, as a file's name may tell of a patient].
    #[arg(long, value_parser = name)]
    name: Option<String>,
    /// Unit of the mesh's coordinates, and so of the result's: mm, cm, m, um or in.
    #[arg(long, default_value = "mm")]
    units: Units,
    /// Threads to compute on; 0 takes every core. The result does not depend on it.
    #[arg(long, default_value_t = 0, value_parser = whole::<usize>)]
    threads: usize,
    /// Print the time of each stage, and what was found, to stderr.
    #[arg(short, long)]
    verbose: bool,
    /// How --verbose tells it: as text, or as one line of JSON for a program.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t, requires = "verbose")]
    timings: TimingsFormat,
    #[command(flatten)]
    parameters: ParameterArgs,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
enum TimingsFormat {
    #[default]
    Text,
    Json,
}

/// Reads, extracts and writes; `-o` is written whole or not at all.
pub fn run(args: Args) -> Result<(), Failure> {
    let output_format = output_format(&args.output)?;
    files::check_folder(&args.output)?;
    let parameters = args.parameters.parameters()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build()?;

    let start = Instant::now();
    let (mesh, format, sha256) = read(&args.mesh, &pool)?;
    let reading = start.elapsed();

    let (extraction, stages) = extract(&mesh, &parameters, &pool)?;

    let start = Instant::now();
    let source = Source {
        name: args.name.as_deref().filter(|name| !name.is_empty()),
        format: format.name(),
        sha256: &sha256,
        units: args.units,
    };
    let document = ResultDocument::new(&extraction, &source, &parameters);
    files::write(&args.output, &output::write(&document, output_format)?)?;
    let mut timings = vec![("reading", reading)];
    timings.extend(stages);
    timings.push(("writing", start.elapsed()));
    tell(&document, args.verbose.then_some((args.timings, &timings[..])));
    Ok(())
}

/// The mesh in a file, its format, and the digest of its bytes.
fn read(path: &Path, pool: &rayon::ThreadPool) -> Result<(TriangleMesh, Format, String), Failure> {
    let bytes = files::read(path)?;
    let hint = Hint { extension: path.extension().and_then(|text| text.to_str()), content_type: None };
    let read = || format::read(&bytes, hint, &Limits::default());
    let (read, digest) = pool.join(read, || Sha256::digest(&bytes));
    match read {
        Ok((mesh, format)) => Ok((mesh, format, hexadecimal(&digest))),
        // JSON is taken for glTF.
        Err(_) if output::is_result(&bytes) => Err(Failure::new(format!(
            "{} is a centerline, the result of an extraction, and not a mesh; give the mesh itself",
            path.display()
        ))),
        Err(error) => Err(Failure::new(error.to_string())),
    }
}

/// As the service takes its parameter `name`; empty where there are only folders.
fn name(text: &str) -> Result<String, BadName> {
    let name = FileName::of(text, http::Limits::default().name_chars)?;
    Ok(name.map(|name| name.expose().to_owned()).unwrap_or_default())
}

fn output_format(path: &Path) -> Result<OutputFormat, Failure> {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.and_then(OutputFormat::from_extension).ok_or_else(|| {
        Failure::new(format!("{} is not a name that ends in .json, .glb, .gltf or .vtp", path.display()))
    })
}

type Timings = Vec<(&'static str, Duration)>;

fn extract(
    mesh: &TriangleMesh,
    parameters: &Parameters,
    pool: &rayon::ThreadPool,
) -> Result<(Extraction, Timings), Failure> {
    let watch = Watch::start();
    let report = |progress| watch.report(progress);
    let control = Control::new(CancelToken::new(), &report);
    let extraction = pool.install(|| centerline::extract(mesh, parameters, &control));
    let timings = watch.finish();
    Ok((extraction?, timings))
}

/// Warnings always go to stderr, the rest only when it was asked for.
fn tell(document: &ResultDocument, timings: Option<(TimingsFormat, &[(&'static str, Duration)])>) {
    let mut text = String::new();
    for warning in &document.warnings {
        text += &format!("rosaline: warning: {}: {}\n", warning.code, warning.detail);
    }
    let ends = document.nodes.iter().filter(|node| node.degree == 1).count();
    let length: f64 = document.branches.iter().map(|branch| branch.length).sum();
    let (branches, units) = (document.branches.len(), &document.units);
    match timings {
        None => {}
        Some((TimingsFormat::Text, timings)) => {
            let table = progress::table(timings);
            text += &format!("{branches} branches, {ends} ends, {length:.3} {units}\n{table}");
        }
        Some((TimingsFormat::Json, timings)) => {
            let seconds = progress::seconds(timings);
            let line = json!({
                "branches": branches, "ends": ends, "length": length, "units": units, "seconds": seconds,
            });
            text += &format!("{line}\n");
        }
    }
    // A closed stderr leaves nobody to tell.
    let _ = std::io::stderr().write_all(text.as_bytes());
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
