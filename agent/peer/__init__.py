"""The core of one robot: facts with their time in, effects out, each rule in a part of its own.

Start with `peer`, which has one entrance (`inputs`), then `part` (what a part is),
`peer_parts` (all of them, in order), `routing` (which part handles a message) and `notices` (what
parts tell each other). `control_cycle` is what each control period does; `network_join`, `membership`
and `slot_discovery` track the members, `section_work` and `durable_records` our own work, and
`announcements` what we send. The package imports no mission.
"""
