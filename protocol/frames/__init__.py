"""Layouts of frames: what a message means in bytes, and back.

`frame` and `identifier` are CAN and J1939; `messages` lists every message; `codec` packs and
unpacks. There is one module per subject: `safety_frames`, `work_frames`, `network_frames`, and so
on. `dbc_signals` describes the signals for tools.
"""
