"""Runs with random faults, and the judges that decide whether a rule was broken.

`fault_profiles` and `fault_generators` draw faults, `scenario_judge` runs and judges a scenario,
`protocol_rules` and `durability_rules` judge what robots send and store. `planted_bugs` checks the
judges, `shrink` reduces failing scenarios.
"""
