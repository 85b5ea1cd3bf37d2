//! `rosaline phantom`.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::mesh::Units;
use crate::mesh::format::write_stl_binary;
use crate::output::{MethodRecord, ParameterValue, ResultDocument, Source, write_json};
use crate::phantom::{Kind, PhantomError, Settings, generate};

use super::numbers::{real, whole};
use super::{Failure, files};

/// A coarse phantom's voxel, in the voxels of its kind.
const COARSE: f64 = 3.0;

/// Writes PREFIX.stl, the surface in mm, and PREFIX.json, its known centerline.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// tube, bifurcation, tree, trifurcation, loop, aneurysm, stenosis, mixed, parallel or bigtree.
    #[arg(value_parser = parse_kind)]
    kind: Kind,
    /// The same seed gives the same curves.
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>)]
    seed: u64,
    /// Where the files go, without their extension.
    #[arg(short, long, value_name = "PREFIX")]
    output: PathBuf,
    /// Deviation of the Gaussian noise on every vertex, in voxels [default: 0, and 0.2 for --noise alone].
    #[arg(long, value_name = "VOXELS", num_args = 0..=1, require_equals = true, default_missing_value = "0.2", default_value_t = 0.0, hide_default_value = true, value_parser = real)]
    noise: f64,
    /// The surface of the binary voxels.
    #[arg(long)]
    stair: bool,
    /// Without the caps at the tips.
    #[arg(long)]
    open: bool,
    /// Voxels three times as large as the kind's own.
    #[arg(long, conflicts_with = "voxel")]
    coarse: bool,
    /// Side of a voxel in mm [default: 0.4; mixed 0.5, bigtree 0.35].
    #[arg(long, value_parser = real)]
    voxel: Option<f64>,
}

fn parse_kind(text: &str) -> Result<Kind, String> {
    text.parse().map_err(|error: PhantomError| error.to_string())
}

pub fn run(args: Args) -> Result<(), Failure> {
    let own = if args.coarse { COARSE * args.kind.voxel() } else { args.kind.voxel() };
    let settings =
        Settings { voxel: args.voxel.unwrap_or(own), noise: args.noise, stair: args.stair, open: args.open };
    let (surface, line) = (with_extension(&args.output, "stl"), with_extension(&args.output, "json"));
    files::check_folder(&surface)?;
    let phantom = generate(args.kind, args.seed, &settings).map_err(|error| blamed(error, args.coarse))?;
    let mut stl = Vec::new();
    write_stl_binary(&phantom.mesh, &mut stl)?;
    let name = surface.file_name().map(|name| name.to_string_lossy().into_owned());
    let sha256: String = Sha256::digest(&stl).iter().map(|byte| format!("{byte:02x}")).collect();
    let source = Source { name: name.as_deref(), format: "stl", sha256: &sha256, units: Units::Millimetres };
    let method = MethodRecord {
        preset: "phantom".to_owned(),
        parameters: parameters(args.seed, &settings),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    let document = ResultDocument::with_method(&phantom.extraction(), &source, method);
    files::write(&surface, &stl)?;
    files::write(&line, &write_json(&document)?)
}

/// The voxel that is too coarse comes from one of two flags.
fn blamed(error: PhantomError, is_coarse: bool) -> Failure {
    match error {
        PhantomError::TooCoarse { .. } if is_coarse => {
            Failure::new(format!("{error}: leave --coarse out, or give a --voxel"))
        }
        error => error.into(),
    }
}

fn parameters(seed: u64, settings: &Settings) -> BTreeMap<String, ParameterValue> {
    let number = ParameterValue::Number;
    let all = [
        ("seed", number(seed as f64)),
        ("voxel", number(settings.voxel)),
        ("noise", number(settings.noise)),
        ("stair", ParameterValue::Flag(settings.stair)),
        ("open", ParameterValue::Flag(settings.open)),
    ];
    all.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Not [`Path::with_extension`], which would cut a prefix such as `tree-0.4`.
fn with_extension(prefix: &Path, extension: &str) -> PathBuf {
    let mut name = OsString::from(prefix);
    name.push(".");
    name.push(extension);
    PathBuf::from(name)
}
