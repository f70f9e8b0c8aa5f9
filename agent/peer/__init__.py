"""The conductor of one robot: frames and observations in, effects out, each rule in its own
part.

Start with `peer`, then `inbound` (what a received frame means) and `control_cycle` (what happens
ten times a second). `network_join`, `membership` and `member_discovery` say who is there;
`section_claims` and `durable_records` what is ours; `announcements` what we send. It imports no
mission.
"""
