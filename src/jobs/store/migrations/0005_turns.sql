-- The waiting job with the lowest turn is next: the time at which it came, in milliseconds, earlier for urgent ones.
ALTER TABLE jobs ADD COLUMN priority TEXT NOT NULL DEFAULT 'normal';
ALTER TABLE jobs ADD COLUMN turn BIGINT NOT NULL DEFAULT 0;
UPDATE jobs SET turn = created;

CREATE INDEX jobs_status_turn ON jobs (status, turn, id);
