"""The worker: takes a job, calls the method, stores what it made, reports. Thin."""
