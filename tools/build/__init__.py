"""Preparing and checking: kernels compiled ahead, the compiled core for campaigns, docstrings."""
