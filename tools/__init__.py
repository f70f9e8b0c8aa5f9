"""Commands: everything that people run. Read `cli.headland` first: it lists them.

`operate` acts on a live fleet, `inspect` only listens, `language` reads phrases, `run` runs and launches,
`livemap` is the page, `report` one run as a page. `ros2` and `vda5050` connect other systems. `chaos` has
the campaigns, `bench` the figures, `build` what is made before a run, `common` what commands share.
"""
