"""The core of one robot: frames and observations in, effects out, each rule in its own part.

Start with `peer`, then `inbound` (what a received frame means) and `control_cycle` (what each
control period does). `network_join`, `membership` and `member_discovery` track the members,
`section_claims` and `durable_records` our own work, and `announcements` what we send. The package
imports no mission.
"""
