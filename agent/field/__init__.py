"""Field work: a field is divided into sections, robots claim them and drive their rows.

`field_map` is the field, `field_division` cuts it into rows and sections, with `headland_rings`
along the fences, whose corners `corner_cuts` cuts for tractors. `narrow_lanes` lead through necks,
and none leads from one of the `ground_parts` to another. `fleet_plan` plans which robot works which
of them in which order (`section_shares` where they are too many), `plan_schedule` tells its times,
`section_choice` decides for one robot. `field_mission` and `tractor_mission` drive a `work_leg`;
`parking` is where idle robots stand.
"""
