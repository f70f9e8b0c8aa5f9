"""Implements of other makers on the bus: a task controller for them that knows what others have worked.

`as_applied_map` is the ground that is worked, shared as the progress of a fleet. `section_control`
decides which sections of an implement are on. `task_controller` is the device: it has an address, takes
places from a receiver, and talks with implements by `protocol/task_server.py`.
"""
