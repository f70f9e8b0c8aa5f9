"""Joint plans of many robots on one lattice, and how peers agree on one of them.

`lattice` is the graph. `pibt` plans the next step of all, `lacam` searches whole plans, `lns`
improves them, `plan_schedule` says when each robot may enter a place. `sum_of_costs` makes the plans
of the public benchmarks. `joint_plan_agreement` is
the protocol by which peers adopt one plan; its phases are in `agreement_phase`.
`linear_assignment` is a solver.
"""
