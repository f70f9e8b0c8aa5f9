"""A simulated world, a simulated wire, and fleets of real peers in them, in virtual time.

`files` reads and writes, `can` is the wire, `world` the bodies, `scenarios` what is set up,
`fleet` the peers together, `record` what is kept, `runs` one run of each mission, `chaos` runs
with faults and judges. `rigs` are single parts for benches and tests, `machines` are processes that
drivers connect to.
"""
