"""Commands in plain language: read, weighed, obeyed, answered.

`vocabulary` and `grammar` are the language, `parse` reads a sentence into an `intent`, `authorize`
decides whether it is obeyed. `alarm` has the words that hold all robots. `say` is the command,
`command_session` a conversation, `endpoint` its web door.
"""
