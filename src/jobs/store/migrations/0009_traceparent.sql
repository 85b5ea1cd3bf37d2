-- The trace that the job's submission belongs to (W3C Trace Context), so that its run does too.
ALTER TABLE jobs ADD COLUMN traceparent TEXT;
