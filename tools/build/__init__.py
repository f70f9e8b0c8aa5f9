"""What is prepared and checked before a run.

`warmup` compiles all kernels ahead. `compile` makes a compiled core for campaigns, which
`compiled_core` finds and loads. `docstring_checker` checks docstrings by rules.
"""
