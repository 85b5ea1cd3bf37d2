-- A client finds its jobs again by its own word for them.
CREATE INDEX jobs_client_reference ON jobs (client_reference, id) WHERE client_reference IS NOT NULL;
