"""Commands that act on a live fleet: stop, reset, orders, transport tasks.

`operator_device` is the operator's device on the bus, with a claimed address (`tool_address`).
"""
