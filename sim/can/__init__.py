"""The CAN wire: arbitration, error frames and time of each frame, and servers that offer it.

`can_wire` is the wire, `frame_timing` the length of a frame in bits, `simulated_bus` a
python-can bus on it, `socketcand_server` the server for processes and tools.
"""
