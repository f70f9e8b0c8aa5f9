"""A fleet of peers in one process: scheduling, disks, faults, and monitors.

Read `simulated_fleet` first: it starts peers on a wire and in a world. `scheduler` is what drives
them, by `virtual_clock` under asyncio or by `event_loop` without it. `fault_injector` plays faults,
`stop_monitor` tells judges which robots must stand, and `outcome` has the figures of a run.
"""
