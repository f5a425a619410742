"""Single pictures for people who wait: a worker of its own, which no long job holds up, with clips kept open.

Its messages are ids of `service.catalog.Preview`; one that is late or lost is not made up for.
"""
