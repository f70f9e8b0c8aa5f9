"""Layouts of frames: what a message means in bytes, and back.

`frame` and `identifier` are CAN and J1939. There is one module per subject: `safety_frames`,
`work_frames`, `network_frames`, and so on. Each kind of frame is a `NamedTuple` and a declaration of
its layout; `layout` makes the codec, the DBC signals and the page of the documentation from it.
`messages` lists every kind; `codec` encodes and decodes frames.
"""
