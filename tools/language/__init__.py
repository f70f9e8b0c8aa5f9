"""Commands in plain language: read, weighed, obeyed, answered.

`vocabulary` and `grammar` are the language, and `parse` reads a phrase into intents (`intent`).
`authorize` decides whether they are obeyed, given the fleet as it is (`fleet_state`, `view`). `alarm`
has the words that hold all robots first. `command_session` is the operator's device, `say` the
command with its `say_options`, `conversation` what it holds once a bus is there, and `endpoint` asks
a language model if one is named.
"""
