"""Recordings of a run, and streams for people who watch it.

Read `recording` first: frames, intents and obstacles with their times. `live_recording` is one that
forgets. `mcap_log` writes and reads it as a file. `topics` lists what live viewers have as well.
`foxglove` makes those messages, `mcap_schema` their schemas; `mcap_chunks` reads some topics of a file.
`ros_bag` writes a ROS 2 bag. `robot_intent` is what a robot means to do, and `intent_stream` brings it
to a map. `remote_body` joins a robot process with its body over `local_link`.
"""
