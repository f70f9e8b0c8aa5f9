"""What peers send each other: frames, addresses, keys, and how replicas are made equal.

`frames` has the layouts, `links` the buses. `address` claims a source address (ISO 11783-5,
J1939-81), `transport` sends messages of more than eight bytes, `authentication` signs commands,
`sync` makes replicas equal. `state_machine` has the total tables that state machines of all layers
are written as. Nothing in here reads a clock.
"""
