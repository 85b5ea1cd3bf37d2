//! `rosaline openapi`: the document as it is committed in openapi.yaml.

use std::io::Write;

use super::Failure;
use crate::http::document;

#[derive(Debug, clap::Args)]
pub struct Args {}

pub fn run(_args: Args) -> Result<(), Failure> {
    Ok(std::io::stdout().write_all(document::yaml().as_bytes())?)
}
