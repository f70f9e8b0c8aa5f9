"""Why a robot stands still, and what may release it.

`stop_cause` is the table of causes, each with the condition that clears it. `stop_controller`
holds the causes of one robot and has the last word on each drive command. `command_authentication`
authenticates stops and resets. `standard_stop` is the stop of ISO 11783-7 that other makers'
buttons send.
"""
