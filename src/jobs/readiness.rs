//! Whether the service should get requests now.

use std::sync::atomic::Ordering;

use super::worker::Phase;
use super::{JobError, JobService, Unready};

impl JobService {
    /// Whether requests can be served: the stores can be written and no shutdown is under way.
    pub async fn ready(&self) -> Result<(), Unready> {
        let mut reasons = Vec::new();
        if self.phase() != Phase::Open {
            reasons.push(JobError::ShuttingDown.to_string());
        }
        if let Err(error) = self.shared.store.check().await {
            reasons.push(error.to_string());
        }
        // Of a folder that is not in its place, everything else is wrong too.
        if let Err(error) = self.shared.in_place().await {
            reasons.push(error.to_string());
        } else {
            reasons.extend(self.shared.blobs.check().await.err().map(|error| error.to_string()));
            reasons.extend(self.check_folder().await.err().map(|error| error.to_string()));
        }
        if self.shared.held.load(Ordering::Relaxed) >= self.shared.settings.workers.get() {
            reasons.push("every worker waits for a cancelled run that does not stop".to_owned());
        }
        if reasons.is_empty() { Ok(()) } else { Err(Unready { reasons }) }
    }

    async fn check_folder(&self) -> Result<(), JobError> {
        let shared = self.shared.clone();
        tokio::task::spawn_blocking(move || match &shared.folder {
            Some(folder) => folder.check(shared.settings.least_free),
            None => Ok(()),
        })
        .await??;
        Ok(())
    }
}
