"""Recordings of a run, and streams for people who watch it.

`recording` is the film, `mcap_log` and `foxglove` its formats. `robot_intent` is what a robot
means to do, `intent_stream` brings it to a map. `remote_body` joins a robot process with its body.
"""
