-- Ids and words are TEXT, times BIGINT milliseconds since the epoch, structures JSON as TEXT: the same
-- statements run on SQLite and PostgreSQL.
CREATE TABLE jobs (
    id                TEXT   NOT NULL PRIMARY KEY,
    status            TEXT   NOT NULL,
    progress          BIGINT NOT NULL,
    stage             TEXT,
    created           BIGINT NOT NULL,
    started           BIGINT,
    updated           BIGINT NOT NULL,
    finished          BIGINT,
    error             TEXT,
    input_key         TEXT   NOT NULL,
    input_size        BIGINT NOT NULL,
    input_sha256      TEXT   NOT NULL,
    hint_extension    TEXT,
    hint_content_type TEXT,
    name              TEXT,
    units             TEXT   NOT NULL,
    parameters        TEXT   NOT NULL,
    artifacts         TEXT   NOT NULL,
    attempts          BIGINT NOT NULL,
    lease             TEXT
);

CREATE INDEX jobs_status_id ON jobs (status, id);
