"""Runs peers in real time: the only modules of `agent/` that use clocks, sockets, threads or files.

`peer_runner` runs one peer on a bus and a body; `gateway_runner` runs a gateway. `sqlite_journal`
is the durable memory. `engine` is `FleetCoordinationEngine`, the interface for a program that has
its own robot.
"""
