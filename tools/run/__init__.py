"""Commands that run: fields, errands, deliveries, explorations, coverage; `launch` with real
processes. `run_recorder` keeps what they leave for replays and viewers.
"""
