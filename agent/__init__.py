"""One robot of the fleet: what it knows, what it decides, and the few modules that do I/O.

Read `interface` first (what goes in and out), then `peer` (the conductor), `safety`, and the
mission that you care about: `field`, `navigation`, `delivery`, `exploration` or `coverage`.
`runtime` runs a peer in real time. Which package may import which is the table in
`tests/test_architecture.py`.
"""
