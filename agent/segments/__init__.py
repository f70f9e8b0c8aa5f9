"""Fleets on several bus segments, joined by gateways over a backbone.

`segment_parts` has the additional parts of a peer: `fleet_stops`, and `remote_segments`, which
tracks the other segments. `segment_area` says which sections neighbours share. `gateway` forwards;
its relays are `stop_relay`, `work_relay` and `map_relay`. `gateway_election` elects the gateway
that leads, and `segment_reachability` tracks the other gateways.
"""
