"""What a run is set up from: scenario files, and the shipped ones beside them.

`scenario` is the format; one module a mission adds its own tables. A setup makes worlds, missions
and bodies.
"""
