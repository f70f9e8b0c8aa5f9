"""Scenario files and the setups that runs are made from; shipped scenarios are beside them.

`scenario` is the format; one module a mission adds its own tables. A setup makes worlds, missions
and bodies.
"""
