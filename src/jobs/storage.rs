//! The stores of a service, and the folder that holds them.

use std::path::Path;
use std::sync::Arc;

use super::blob::{BlobError, BlobStore, LocalBlobs};
use super::faults::{self, Operation, Side};
use super::store::{DeliveryStore, JobStore, SqlStore};
use super::{DataFolder, JobError};

/// Where jobs and their files are kept.
pub struct Storage {
    pub store: Arc<dyn JobStore>,
    pub deliveries: Arc<dyn DeliveryStore>,
    pub blobs: Arc<dyn BlobStore>,
    /// Kept locked while the service or one of its workers lives.
    pub folder: Option<DataFolder>,
}

impl Storage {
    /// SQLite and files in one folder, which is created if it is missing.
    pub async fn local(data: &Path) -> Result<Self, JobError> {
        let data = data.to_owned();
        let (folder, blobs) = tokio::task::spawn_blocking(move || {
            let mut folder = DataFolder::open(&data)?;
            folder.check_database()?;
            // Until the service has started: a full disk must not keep it from that.
            folder.release_reserve();
            folder.keep_database_private()?;
            let blobs = LocalBlobs::open(&folder.blobs())?;
            folder.anchor()?;
            Ok::<_, JobError>((folder, blobs))
        })
        .await??;
        faults::pass(Operation::StoreOpen, Side::Before).map_err(BlobError::Folder)?;
        let sql = Arc::new(SqlStore::open(&folder.database_url()).await?);
        faults::pass(Operation::StoreOpen, Side::After).map_err(BlobError::Folder)?;
        let (deliveries, store): (Arc<dyn DeliveryStore>, Arc<dyn JobStore>) = (sql.clone(), sql);
        #[cfg(debug_assertions)]
        let store: Arc<dyn JobStore> = Arc::new(faults::FaultyStore(store));
        #[cfg(debug_assertions)]
        let deliveries: Arc<dyn DeliveryStore> = Arc::new(faults::FaultyDeliveries(deliveries));
        Ok(Self { deliveries, store, blobs: Arc::new(blobs), folder: Some(folder) })
    }
}
