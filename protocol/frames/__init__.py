"""Layouts of frames: what a message means in bytes, and back.

`frame` and `identifier` are CAN and J1939; `messages` lists every message; `codec` packs and
unpacks. One module a subject: `safety_frames`, `work_frames`, `network_frames`, and so on.
`dbc_signals` prints them for tools.
"""
