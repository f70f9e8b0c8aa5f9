"""Runs peers in real time: the only modules of `agent/` that use clocks, sockets, threads or files.

`peer_factory` makes every peer; `mission_parts` makes what its mission brings, for a robot file by
`robot_work`. `robot_process` runs
one robot from a `robot_file`, with a `robot_body` of yours: begin there. `peer_runner` runs one peer
on a bus and a body; `gateway_runner` runs a gateway. `sqlite_journal` is the durable memory, and
`work_memory` what of it belongs to another field. `files` reads keys and fields. `engine` is the
interface for a program that has its own robot.
"""
