"""What is kept of a run and what is streamed to people who watch.

`recording` is the film, `mcap_log` and `foxglove` its formats. `robot_intent` is what a robot
means to do, `intent_stream` brings it to a map. `remote_body` joins a robot process with its body.
"""
