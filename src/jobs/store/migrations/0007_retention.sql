-- When a job's input was removed before the job itself: the row says so only once the file is gone.
ALTER TABLE jobs ADD COLUMN input_removed BIGINT;
CREATE INDEX jobs_finished ON jobs (finished);

-- Jobs whose time was up: their ids answer that they are gone, not that there never was such a job.
CREATE TABLE expired (
    id    TEXT   NOT NULL PRIMARY KEY,
    owner TEXT,
    at    BIGINT NOT NULL
);
