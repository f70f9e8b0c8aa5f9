"""Transport tasks in a warehouse: which robot carries what, in which order, with which charge.

`delivery_mission` is the mission, and `task_registry` has the replicated tasks. `routing_problem`
and `cost_matrix` are the problem and its costs. `tour_auction` inserts tasks into tours, and
`plan_negotiation` lets peers adopt the cheapest plan of all. Kernels: `routing_kernels`,
`waiting_kernels`.
"""
