"""One run of each mission, from a setup to an outcome, and the records of the work done.

Read `run.py` first: it is the one loop. `field_run`, `navigation_run`, `delivery_run`, `exploration_run`,
`coverage_run` and `protocol_run` say what their mission adds. `work_record` is what was worked, and
`work_geojson`, `isoxml_writer` and `isoxml_time_log` write it. `work_plan` is a plan
without a run, and `work_plan_files` writes it.
"""
