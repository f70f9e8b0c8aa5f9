"""Inputs and outputs of a peer: observations, effects, the mission interface, identity, limits.

Start with `effects` (what comes out), `ports` (what a body senses) and `mission` (what a mission
answers each control period). `lifecycle` is the total table of a robot's states, on the machine in
`protocol/state_machine.py`. `config` holds every limit of the core with its unit and its reason.
"""
