"""Commands that act on a live fleet: stop, reset, orders, transport tasks.

Read `operator_device` first: the operator's device on the bus, with a claimed address
(`tool_address`). `device_keys` follows the key file of a tool that is open for hours. `estop`, `reset`,
`order` and `transport_order` are the commands. `task_numbers` learns which numbers transports have.
`shown_stops` says what a reset may clear, and `pgn_client` asks robots for texts.
"""
