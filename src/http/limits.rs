//! Every bound of the service, in one type.

use std::time::Duration;

use crate::jobs::RUN_LIMIT;
use crate::jobs::isolation::JOB_MEMORY;
use crate::mesh::format;

/// Bytes of an upload that must come within its idle time: a byte now and then does not keep it alive.
pub const UPLOAD_STEP: usize = 16 << 10;

/// Bytes of a small file.
pub(super) const SMALL_FILE: u64 = 1 << 20;
/// Triangles of a small mesh, and bytes that it may unpack to: few bytes may hold many of them.
pub(super) const SMALL_MESH: usize = 100_000;
const SMALL_DECODED: usize = 16 << 20;

/// Bytes that the check of an upload may take for each triangle of the largest mesh, beside its file: measured on the worst
/// meshes (docs/reliability.md, "What the check of an upload takes").
const CHECK_BYTES: u64 = 250;

/// Files for the database, logs, webhooks, connections past the limit, and the pipes of up to 30 runs.
const OTHER_FILES: u64 = 256;

/// What one request may use, and for how long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one upload's mesh.
    pub upload_bytes: u64,
    /// Bytes of the `parameters` part of a multipart upload.
    pub parameters_bytes: usize,
    /// An upload of which less than [`UPLOAD_STEP`] (or the rest) comes in this long is given up.
    pub upload_idle: Duration,
    /// A connection whose next request's head is not whole after this long is closed.
    pub head: Duration,
    /// Connections that may be open at the same time.
    pub connections: usize,
    /// Meshes that are checked at the same time, and as many small ones beside them; further uploads wait their turn on disk.
    /// Each takes one copy of its file in memory and the mesh that is read from it. A small file that turns out to hold a
    /// large mesh keeps its copy while it waits for the turn of such a one, as one of `uploads`: so these two bound the
    /// memory of any number of uploads, see [`Limits::checks`].
    pub validations: usize,
    /// Uploads that may come in at the same time.
    pub uploads: usize,
    /// Uploads of one principal, or where no key is needed of one address, that may come in at the same time.
    pub uploads_each: usize,
    /// Jobs that may wait.
    pub queue: u64,
    /// Jobs of one principal that may wait or run.
    pub jobs_per_principal: u64,
    /// How long one run of a job may take.
    pub run: Duration,
    /// Bytes of memory that one run of a job may have.
    pub job_memory: u64,
    /// The largest mesh that is read.
    pub mesh: format::Limits,
    /// The longest that `Prefer: wait` is honoured.
    pub wait: Duration,
    /// Jobs on one page of the list, where the client does not say.
    pub page_default: u32,
    /// The most jobs on one page of the list.
    pub page_most: u32,
    /// Characters of a source name.
    pub name_chars: usize,
    /// Characters of a client's reference and of its request id.
    pub reference_chars: usize,
}

impl Limits {
    /// The largest small mesh.
    pub(super) fn small_mesh(&self) -> format::Limits {
        let (mesh, small) = (self.mesh, format::Limits::of_triangles(SMALL_MESH));
        format::Limits {
            vertices: small.vertices.min(mesh.vertices),
            triangles: small.triangles.min(mesh.triangles),
            decoded_bytes: SMALL_DECODED.min(mesh.decoded_bytes),
            expansion: mesh.expansion,
        }
    }

    /// Files that the service may have open at once: a connection and the file that comes in or goes out on it, and
    /// [others](OTHER_FILES).
    pub fn files(&self) -> u64 {
        (self.connections as u64).saturating_mul(2).saturating_add(OTHER_FILES)
    }

    /// With as many connections as there are `files` for: at least a sixth of them, as a service so small has fewer others.
    pub fn within(self, files: u64) -> Self {
        let room = (files.saturating_sub(OTHER_FILES) / 2).max(files / 6).max(1);
        Self { connections: self.connections.min(usize::try_from(room).unwrap_or(usize::MAX)), ..self }
    }

    /// Bytes of memory that the checks of all uploads may take at once: large ones, small ones, and the small files that
    /// wait for the turn of a large one.
    pub fn checks(&self) -> u64 {
        let read = |mesh: format::Limits| CHECK_BYTES.saturating_mul(mesh.triangles as u64);
        let small = self.small_mesh();
        let file = SMALL_FILE.min(self.upload_bytes);
        let each = [self.upload_bytes, read(self.mesh), file, small.decoded_bytes as u64, read(small)];
        let each = each.into_iter().fold(0, u64::saturating_add);
        each.saturating_mul(self.validations as u64).saturating_add(file.saturating_mul(self.uploads as u64))
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            upload_bytes: 1 << 30,
            parameters_bytes: 64 << 10,
            upload_idle: Duration::from_secs(30),
            head: Duration::from_secs(30),
            connections: 1024,
            validations: 2,
            uploads: 256,
            uploads_each: 64,
            queue: 100_000,
            jobs_per_principal: 10_000,
            run: RUN_LIMIT,
            job_memory: JOB_MEMORY.get(),
            mesh: format::Limits::default(),
            wait: Duration::from_secs(60),
            page_default: 50,
            page_most: 500,
            name_chars: 255,
            reference_chars: 128,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_are_as_many_as_there_are_files_for() {
        let limits = Limits { connections: 4096, ..Limits::default() };
        assert_eq!(limits.files(), 2 * 4096 + 256);
        let of = |files| limits.within(files).connections;
        assert_eq!(
            [of(u64::MAX), of(8448), of(8447), of(1024), of(64), of(0)],
            [4096, 4096, 4095, 384, 10, 1]
        );
        assert_eq!(Limits { connections: usize::MAX, ..limits }.within(1024).connections, 384);
    }

    #[test]
    fn the_checks_are_large_ones_small_ones_and_small_files_that_wait() {
        const MIB: u64 = 1 << 20;
        let limits = Limits {
            upload_bytes: 100 * MIB,
            validations: 2,
            uploads: 7,
            mesh: format::Limits::of_triangles(1_000_000),
            ..Limits::default()
        };
        let (large, small) = (100 * MIB + 250_000_000, 17 * MIB + 25_000_000);
        assert_eq!(limits.checks(), 2 * (large + small) + 7 * MIB);
        // No file and no mesh is larger than the largest.
        let limits = Limits { upload_bytes: MIB / 2, mesh: format::Limits::of_triangles(1000), ..limits };
        let (large, small) = (MIB / 2 + 250_000, MIB / 2 + 16 * MIB + 250_000);
        assert_eq!(limits.checks(), 2 * (large + small) + 7 * (MIB / 2));
        assert_eq!(Limits { uploads: usize::MAX, ..Limits::default() }.checks(), u64::MAX);
    }
}
