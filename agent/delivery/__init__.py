"""Transport tasks in a warehouse: which robot carries what, in which order, with which charge.

`delivery_mission` is the mission, `task_registry` the replicated tasks, `routing_problem` and
`cost_matrix` what is to be optimised. `auction` inserts tasks into tours, `plan_negotiation` lets
peers adopt the cheapest plan of all. Kernels: `routing_kernels`, `waiting_kernels`.
"""
