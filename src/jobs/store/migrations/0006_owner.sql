-- The principal that a job belongs to; NULL where it was submitted without authentication.
ALTER TABLE jobs ADD COLUMN owner TEXT;

CREATE INDEX jobs_owner ON jobs (owner, status);
