-- Webhooks. Who is told of the ends of jobs, as the operator's file had it when it was last read.
CREATE TABLE webhook_targets (
    name   TEXT NOT NULL PRIMARY KEY,
    -- Only jobs of this principal; NULL: of everybody.
    owner  TEXT,
    -- The states that are told, each between commas: ',successful,failed,'.
    events TEXT NOT NULL
);

-- What is to be told to one target. It goes when the target has it.
CREATE TABLE webhook_deliveries (
    -- The same in every try, so that the target can tell a repetition.
    id               TEXT   NOT NULL PRIMARY KEY,
    target           TEXT   NOT NULL,
    -- The job as it ended: its row may go before it is told.
    job              TEXT   NOT NULL,
    status           TEXT   NOT NULL,
    created          BIGINT NOT NULL,
    started          BIGINT,
    finished         BIGINT NOT NULL,
    client_reference TEXT,
    error            TEXT,
    -- 'waiting', or 'dead': given up.
    state            TEXT   NOT NULL,
    attempts         BIGINT NOT NULL,
    -- When it is to be tried next; one that is under way, when it is given to another sender.
    due              BIGINT NOT NULL,
    lease            TEXT,
    -- Why the last try failed, and when it was given up.
    failure          TEXT,
    died             BIGINT
);
CREATE INDEX webhook_deliveries_due ON webhook_deliveries (target, state, due);
CREATE INDEX webhook_deliveries_job ON webhook_deliveries (job);

-- In the transaction that ends a job, whichever statement does, so that no end is missed and none is told that did not
-- happen. Triggers are SQLite's in form; another database has them in its own.
CREATE TRIGGER webhook_job_ended AFTER UPDATE OF status ON jobs
WHEN NEW.status IN ('successful', 'failed', 'dismissed') AND OLD.status IN ('accepted', 'running')
BEGIN
    INSERT INTO webhook_deliveries
        (id, target, job, status, created, started, finished, client_reference, error, state, attempts, due)
    SELECT 'msg_' || lower(hex(randomblob(16))), name, NEW.id, NEW.status, NEW.created, NEW.started,
        COALESCE(NEW.finished, NEW.updated), NEW.client_reference, NEW.error, 'waiting', 0, NEW.updated
    FROM webhook_targets
    WHERE (owner IS NULL OR owner = NEW.owner) AND instr(events, ',' || NEW.status || ',') > 0;
END;

-- A reference may be patient data: it is not kept for longer than its job.
CREATE TRIGGER webhook_job_purged AFTER DELETE ON jobs
BEGIN
    UPDATE webhook_deliveries SET client_reference = NULL WHERE job = OLD.id;
END;
