"""Every figure that a document of ours claims, measured again: one JSON line each.

`command` is `headland bench`, and `figure` is one line of it. Each other module measures one subject
and yields its lines. `kernels` steps whole fleets together, for comparisons.
"""
