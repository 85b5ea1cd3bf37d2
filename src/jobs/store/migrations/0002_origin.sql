-- What a client says of its request. A key belongs to one job for as long as the job's row is there; NULLs do not
-- collide in a unique index.
ALTER TABLE jobs ADD COLUMN request_id TEXT;
ALTER TABLE jobs ADD COLUMN client_reference TEXT;
ALTER TABLE jobs ADD COLUMN idempotency_key TEXT;
ALTER TABLE jobs ADD COLUMN idempotency_fingerprint TEXT;

CREATE UNIQUE INDEX jobs_idempotency_key ON jobs (idempotency_key);
