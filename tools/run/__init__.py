"""Commands that run: fields, errands, deliveries, explorations, coverage; `launch` with real
processes.
"""
