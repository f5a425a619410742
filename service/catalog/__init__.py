"""The records: media, jobs, looks and results in SQL, and the job state machine that keeps them true."""
