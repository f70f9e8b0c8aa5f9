"""A fleet of peers: scheduling in virtual time, disks, faults, and monitors.

`simulated_fleet` starts peers on a wire and a world; `scheduler`, `virtual_clock` and `event_loop`
move time. `fault_injector` plays faults, `outcome` is what a run came to.
"""
