"""The REST service: uploads, jobs, results and their records. Knows neither the method nor the worker's code."""
