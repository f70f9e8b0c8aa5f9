"""Fleets on several bus segments, joined by gateways over a backbone.

`segment_parts` is what a peer has in addition, `remote_segments` what it knows about them.
`gateway` forwards; its relays are `stop_relay`, `work_relay` and `map_relay`. `gateway_election`
elects the gateway that leads.
"""
