-- When the purge of a job was begun: its files go first, its row last, so that no row is missing for a file.
ALTER TABLE jobs ADD COLUMN purging BIGINT;
