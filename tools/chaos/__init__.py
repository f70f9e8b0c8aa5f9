"""Campaigns of runs with faults, and what came of them.

`chaos` plays seeds and makes the first failure small. `planted_bug_hunt` looks for bugs that are
planted on purpose. `fuzz` feeds decoders with any bytes, `fuzz_atheris` with those that reach new
code. `chaos_report` writes the report of all results.
"""
