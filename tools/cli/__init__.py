"""The command line: `headland` and its groups of commands.

`headland` has the commands that run something and starts the others, which are in `bus_commands`,
`test_commands`, `tasks` and `keys`. `hub`, `bridge`, `dbc` and `fields` are commands of their own.
`doc_pages` prints the pages of the documents that come from the code: frames, routes, states, API.
"""
