"""Scenario files and the setups that runs are made from; shipped scenarios are beside them.

`scenario` is the format; one module a mission adds its own tables. `fleet_setup` is what the setups
of all missions have alike; a setup makes worlds, missions and bodies.
"""
