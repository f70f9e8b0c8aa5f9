"""Recordings of a run, and streams for people who watch it.

Read `recording` first: frames, intents and obstacles with their times. `live_recording` is one that
forgets. `mcap_log` writes and reads it as a file, with the `topics` that live viewers have, too, their
messages in `foxglove`, and their schemas in `mcap_schema`;`mcap_chunks` cuts some topics out of one.
`robot_intent` is what a robot means to do, and `intent_stream` brings it to a map. `remote_body`
joins a robot process with its body over `local_link`.
"""
