//! `rosaline work`: the process of one job's run, which the service starts.

use super::Failure;
use crate::jobs::isolation::work_off;

#[derive(Debug, clap::Args)]
pub struct Args {}

/// Works off the job that stdin tells of.
pub fn run(_: Args) -> Result<(), Failure> {
    Ok(work_off()?)
}
