//! Whose turn it is, and who is given up: the rules for jobs that were running when the process died.
//!
//! A kill -9 and a job that takes the process down look the same afterwards. So a job is suspected first and
//! counted out only on proof: `attempts` counts its starts that were not put back, `crashes` those of them
//! that ended in the process's death while nothing else ran.
//!
//! * one attempt so far: it runs on trial, beside fresh jobs and beside no other suspect;
//! * two or more: it runs alone, and before all others; only that counts as a crash.

/// Claims the next job: `$1` is the lease, `$2` the time.
pub(super) const CLAIM: &str = "UPDATE jobs SET status = 'running', lease = $1, started = $2, updated = $2, \
    attempts = attempts + 1, progress = 0, stage = NULL \
    WHERE status = 'accepted' AND id = ( \
        SELECT id FROM jobs WHERE status = 'accepted' \
        AND NOT EXISTS (SELECT 1 FROM jobs AS lone WHERE lone.status = 'running' AND lone.attempts > 2) \
        AND CASE \
            WHEN attempts > 1 THEN NOT EXISTS (SELECT 1 FROM jobs AS other WHERE other.status = 'running') \
            WHEN EXISTS (SELECT 1 FROM jobs AS lone WHERE lone.status = 'accepted' AND lone.attempts > 1) THEN FALSE \
            WHEN attempts = 1 THEN NOT EXISTS ( \
                SELECT 1 FROM jobs AS trial WHERE trial.status = 'running' AND trial.attempts > 1) \
            ELSE TRUE END \
        ORDER BY turn, id LIMIT 1) \
    RETURNING *";

/// A failed job waits again: `$1` is its id, `$2` the time. One that was given up after crashes keeps its attempts,
/// so that it runs alone.
pub(super) const RETRY: &str = "UPDATE jobs SET status = 'accepted', updated = $2, finished = NULL, started = NULL, \
    error = NULL, progress = 0, stage = NULL, attempts = CASE WHEN crashes > 0 THEN attempts ELSE 0 END, crashes = 0 \
    WHERE id = $1 AND status = 'failed' AND purging IS NULL AND input_removed IS NULL";

/// After the process died: counts a crash for a job that ran alone.
pub(super) const COUNT: &str = "UPDATE jobs SET crashes = crashes + 1 WHERE status = 'running' \
    AND 1 = (SELECT COUNT(*) FROM jobs AS other WHERE other.status = 'running')";

/// Then: gives up a running job with `$3` crashes, for the reason `$1` at the time `$2`.
pub(super) const GIVE_UP: &str = "UPDATE jobs SET status = 'failed', error = $1, updated = $2, finished = $2, \
    lease = NULL WHERE status = 'running' AND crashes >= $3";

/// Then: puts the others back, at the time `$1`.
pub(super) const PUT_BACK: &str = "UPDATE jobs SET status = 'accepted', updated = $1, progress = 0, \
    stage = NULL, started = NULL, lease = NULL WHERE status = 'running'";
