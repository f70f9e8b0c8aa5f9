"""Commands: everything that people run. `cli.headland` is the door.

`operate` acts on a live fleet, `inspect` only listens, `run` runs and launches, `livemap` is the
page, `chaos` the campaigns, `bench` the figures.
"""
